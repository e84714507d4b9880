"""The parts of a twin (a head for displays) beside the skin: eyeballs, jaw, teeth, tongue and neck.

Simple shapes that are generated, not measured. The tongue's tip goes between the teeth or behind
the upper ones (Ladefoged and Maddieson, "The Sounds of the World's Languages", 1996, chapter 2).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.interpolate import PchipInterpolator

from lipsync.arrays import Array, Indices
from lipsync.twin.head_surface import LEFT_EYE, RIGHT_EYE, HeadSurface


@dataclass(frozen=True, slots=True)
class Part:
    """One mesh of a twin.

    places_mm (n, 3), triangles (n_triangles, 3), counter-clockwise seen from outside; colours
    (n, 3), 0 to 1, sRGB. morphs: displacements in mm (n, 3) of the morph targets that move the
    part, by name. stays: whether the part keeps its place when the head turns, as the neck does.
    """

    name: str
    places_mm: Array
    triangles: Indices
    colours: Array
    morphs: Mapping[str, Array] = field(default_factory=dict)
    stays: bool = False


@dataclass(frozen=True, slots=True)
class Eyeball:
    """An eyeball, a sphere that turns about `centre_mm` (3,); at rest its gaze is along z."""

    side: Literal["left", "right"]
    centre_mm: Array
    radius_mm: float
    iris_radius_mm: float


#: Larger than an eyeball (12 mm): a tracked lid has no thickness, and at 12 mm the corners of the
#: eye would show what is behind it.
_RADIUS_MM = 16.5
#: The lid stands so far off the eyeball.
_CLEARANCE_MM = 0.5
#: How far the lining of the lids reaches back, mm, and towards the eye's middle, as a share of the
#: distance.
_LINING_MM, _LINING_SHARE = 7.0, 0.10
_LINING, _LASHES = (0.80, 0.55, 0.50), (0.22, 0.15, 0.12)


def eyeballs(surface: HeadSurface, irises_mm: Array) -> tuple[Eyeball, Eyeball]:
    """Return the left and the right eyeball of a head.

    Parameters
    ----------
    surface : HeadSurface
        Surface of the head.
    irises_mm : Array
        (2, 5, 3), right first: centre and four points of the edge of each iris.

    Returns
    -------
    tuple[Eyeball, Eyeball]
        Radii and centres in mm.
    """
    edges = irises_mm[:, 1:] - irises_mm[:, :1]
    iris_mm = float(np.linalg.norm(edges[:, :, :2], axis=2).mean())
    left = _eyeball("left", surface.places_mm[list(LEFT_EYE)], iris_mm)
    right = _eyeball("right", surface.places_mm[list(RIGHT_EYE)], iris_mm)
    return left, right


def _eyeball(side: Literal["left", "right"], rim_mm: Array, iris_mm: float) -> Eyeball:
    """Return an eye's eyeball: between its corners, just behind the middle third of both lids.

    rim_mm: (n, 3), the edge of both lids, once round from a corner; iris_mm: radius of the iris.
    """
    corners = rim_mm[[0, len(rim_mm) // 2]]
    x = corners[:, 0].mean()
    y = (rim_mm[:, 1].max() + rim_mm[:, 1].min()) / 2
    third = rim_mm[np.abs(rim_mm[:, 0] - x) < np.ptp(corners[:, 0]) / 3]
    depth_sq = (_RADIUS_MM + _CLEARANCE_MM) ** 2 - ((third[:, :2] - (x, y)) ** 2).sum(axis=1)
    # So far back that every point of the lids is at least 0.5 mm outside the sphere.
    z = float((third[:, 2] - np.sqrt(depth_sq)).min())
    return Eyeball(side, np.array([x, y, z]), _RADIUS_MM, iris_mm)


def lid_lining(surface: HeadSurface, morphs: dict[str, Array], eye: Eyeball) -> Part:
    """Return the lining of one eye's lids: a strip from their edge backwards, dark at the lashes.

    Parameters
    ----------
    surface : HeadSurface
        Surface of the head.
    morphs : dict[str, Array]
        Displacements of the head's vertices by morph target, (n_vertices, 3) mm each.
    eye : Eyeball
        Eyeball of that eye.

    Returns
    -------
    Part
        The strip, with the morph targets that move the lids' edge.
    """
    rim = np.array(surface.loop_from(*(LEFT_EYE if eye.side == "left" else RIGHT_EYE)[:2]))
    n = len(rim)
    front = surface.places_mm[rim]
    inwards = (eye.centre_mm - front) * (1.0, 1.0, 0.0) * _LINING_SHARE
    back = front + inwards - (0.0, 0.0, _LINING_MM)
    is_upper = np.arange(n) <= n // 2
    colours = np.vstack(
        [np.where(is_upper[:, None], _LASHES, _LINING), np.broadcast_to(_LINING, (n, 3))]
    )
    rim_morphs = {
        name: np.vstack([morph[rim], morph[rim]])
        for name, morph in morphs.items()
        if np.abs(morph[rim]).max() > 0.0
    }
    places = np.vstack([front, back])
    return Part(f"lids_{eye.side}", places, _ring_mesh(2, n), colours, rim_morphs)


def jaw_motion(chin_mm: Array, joint_mm: Array, chin_moves_mm: Array) -> Array:
    """Return the jaw's opening, forward and sideways motion that fit the chin's best.

    Parameters
    ----------
    chin_mm : Array
        (n, 3), points of the chin.
    joint_mm : Array
        (3,), the joint of the jaw.
    chin_moves_mm : Array
        (n_morphs, n, 3), displacements of the points by morph target.

    Returns
    -------
    Array
        (n_morphs, 3): radians about the joint (positive opens), mm forward, mm to +x.
    """
    columns = jaw_modes(chin_mm, joint_mm).transpose(1, 2, 0).reshape(-1, 3)
    motion, *_ = np.linalg.lstsq(columns, chin_moves_mm.reshape(len(chin_moves_mm), -1).T)
    return np.asarray(motion.T, dtype=np.float64)


def jaw_modes(places_mm: Array, joint_mm: Array) -> Array:
    """Return how points of the jaw move with 1 rad of opening, 1 mm forward and 1 mm sideways.

    Parameters
    ----------
    places_mm : Array
        (n, 3), the points.
    joint_mm : Array
        (3,), the joint of the jaw.

    Returns
    -------
    Array
        (3, n, 3) mm.
    """
    from_joint = places_mm - joint_mm
    modes = np.zeros((3, *places_mm.shape))
    # Linear in the angle: a small rotation about +x moves (y, z) by (-z, y) for 1 rad.
    modes[0, :, 1] = -from_joint[:, 2]
    modes[0, :, 2] = from_joint[:, 1]
    modes[1, :, 2] = 1.0
    modes[2, :, 0] = 1.0
    return modes


def jaw_displacements(places_mm: Array, joint_mm: Array, motion: Array) -> Array:
    """Return the displacements of points on the jaw for given motions of the jaw.

    Parameters
    ----------
    places_mm : Array
        (n, 3), the points.
    joint_mm : Array
        (3,), the joint of the jaw.
    motion : Array
        (n_morphs, 3), as `jaw_motion` returns it.

    Returns
    -------
    Array
        (n_morphs, n, 3) mm.
    """
    return np.asarray(np.einsum("kj,jni->kni", motion, jaw_modes(places_mm, joint_mm)))


_ENAMEL, _GUMS, _TONGUE = (0.93, 0.91, 0.86), (0.62, 0.30, 0.30), (0.80, 0.42, 0.42)
_INSIDE_FRONT, _INSIDE_BACK = np.array([0.42, 0.15, 0.15]), np.array([0.07, 0.02, 0.02])
#: Width of the teeth of one side from the middle on, and their height, mm: usual sizes.
_UPPER_WIDTHS_MM, _UPPER_HEIGHT_MM = (8.4, 6.6, 7.6, 7.0, 6.8, 9.8), 9.5
_LOWER_WIDTHS_MM, _LOWER_HEIGHT_MM = (5.4, 5.9, 6.8, 7.0, 7.1, 10.0), 8.5
_THICKNESS_MM = 5.0
#: Edges of the front teeth, and middle of the tongue, relative to the point between the lips.
_UPPER_EDGE_MM, _LOWER_EDGE_MM = np.array([0.0, -1.6, -5.0]), np.array([0.0, -1.4, -7.4])
_TONGUE_MIDDLE_MM = np.array([0.0, -8.5, -32.0])
#: Half axes of the tongue. How far its tip goes up and forward, by the target.
_TONGUE_MM = (16.0, 6.0, 23.0)
_TIP_MM = {"tongue_dental": (0.0, 7.8, 12.0), "tongue_alveolar": (0.0, 13.0, 2.0)}
#: The tip begins at 1 / 1.6 of the way to it. Raised it is narrower and thinner by these shares.
_TIP, _THINNER = 1.6, np.array([0.1, 0.5, 0.0])
#: The arch of the teeth is a parabola: so deep at so far from the middle.
_ARCH_HALF_WIDTH_MM, _ARCH_DEPTH_MM = 25.0, 33.0
#: Rows of the inside of the mouth, and its half axes at its widest.
_ROWS, _INSIDE_MM = 9, (24.0, 15.0)


@dataclass(frozen=True, slots=True)
class MouthFrame:
    """The position of the mouth, and its displacements by morph target.

    places_mm (n, 3): the inner rim of the lips, in order; morphs: its displacements (n, 3).
    middle_mm: between both lips. joint_mm: the jaw's joint. jaw: the jaw's motion (3,) by morph
    target, as `jaw_motion` returns it.
    """

    places_mm: Array
    morphs: Mapping[str, Array]
    middle_mm: Array
    joint_mm: Array
    jaw: Mapping[str, Array]

    def displacements_with_jaw(self, places_mm: Array) -> dict[str, Array]:
        """Return the displacements of points on the lower jaw, by morph target.

        Parameters
        ----------
        places_mm : Array
            (n, 3), the points.

        Returns
        -------
        dict[str, Array]
            (n, 3) mm each.
        """
        return {
            name: jaw_displacements(places_mm, self.joint_mm, motion[None])[0]
            for name, motion in self.jaw.items()
        }


def mouth_parts(frame: MouthFrame) -> tuple[Part, ...]:
    """Return the upper teeth, the lower teeth, the tongue, and the inside of the mouth."""
    lower_edge = frame.middle_mm + _LOWER_EDGE_MM
    upper = _dental_arch(frame.middle_mm + _UPPER_EDGE_MM, _UPPER_WIDTHS_MM, _UPPER_HEIGHT_MM, 1.0)
    lower = _dental_arch(lower_edge, _LOWER_WIDTHS_MM, _LOWER_HEIGHT_MM, -1.0)
    return (
        Part("teeth_upper", *upper),
        Part("teeth_lower", *lower, frame.displacements_with_jaw(lower[0])),
        _tongue(frame),
        _mouth_inside(frame),
    )


def _tongue(frame: MouthFrame) -> Part:
    """Return the tongue, moved by the jaw and by the targets of its tip."""
    middle = frame.middle_mm + _TONGUE_MIDDLE_MM
    tongue = _ellipsoid(middle, _TONGUE_MM, _TONGUE, around=32)
    from_middle = tongue[0] - middle
    # From the tongue's middle, 0, to its tip, 1, which moves as a whole.
    along = np.clip(_TIP * from_middle[:, 2:] / _TONGUE_MM[2], 0.0, 1.0)
    share = along * along * (3.0 - 2.0 * along)
    tips = {name: share * (tip - _THINNER * from_middle) for name, tip in _TIP_MM.items()}
    return Part("tongue", *tongue, frame.displacements_with_jaw(tongue[0]) | tips)


#: A mesh: places (n, 3) in mm, triangles (n_triangles, 3), colours (n, 3).
Piece = tuple[Array, Indices, Array]


def _dental_arch(edge: Array, widths_mm: tuple[float, ...], height_mm: float, up: float) -> Piece:
    """Return the mesh of the teeth and gum of both sides.

    edge: (3,) mm, the front teeth's edge in the middle. widths_mm: of the teeth of one side,
    from the middle on. up: 1 for upper teeth, -1 for lower.
    """
    pieces = []
    starts_mm = np.concatenate([[0.0], np.cumsum(widths_mm)])
    for side in (-1.0, 1.0):
        for start, width in zip(starts_mm, widths_mm, strict=False):
            x, z, turn = _arch_position(side * (start + width / 2))
            height_share = 1.0 - 0.03 * start / 8.0
            half_mm = (width * 0.49, height_mm * height_share / 2, _THICKNESS_MM / 2)
            tooth, triangles, colours = _ellipsoid(np.zeros(3), half_mm, _ENAMEL, roundness=0.45)
            # Turned about y, to stand along the arch.
            tooth = tooth @ np.array(
                [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
            )
            middle = edge + np.array([x, up * height_mm / 2, z])
            pieces.append((tooth + middle, triangles, colours))
    pieces.append(_gum(edge + np.array([0.0, up * (height_mm + 1.0), 0.0]), float(starts_mm[-1])))
    return _join_pieces(pieces)


def _arch_position(along_mm: float) -> tuple[float, float, float]:
    """Return x, z (mm) and heading (rad) on the dental parabola, `along_mm` from its middle."""
    bend = _ARCH_DEPTH_MM / _ARCH_HALF_WIDTH_MM**2
    # Arc length along half of the parabola z = -bend x^2, inverted by interpolation.
    x = np.linspace(0.0, 2 * _ARCH_HALF_WIDTH_MM, 400)
    arc_mm = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(bend * x**2)))])
    x_there = float(np.interp(abs(along_mm), arc_mm, x)) * np.sign(along_mm)
    return x_there, -bend * x_there**2, float(np.arctan(2 * bend * x_there))


def _gum(through: Array, half_length_mm: float) -> Piece:
    """Return the mesh of the gum of both sides: a bar along the dental arch from side to side.

    through: (3,) mm, the bar's axis in the middle. half_length_mm: arc length of one side.
    """
    stations = np.linspace(-half_length_mm, half_length_mm, 25)
    angles = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    rows = []
    for along_mm in stations:
        x, z, heading = _arch_position(float(along_mm))
        across = np.array([np.sin(heading), 0.0, np.cos(heading)])
        rows.append(
            through + np.array([x, 0.0, z]) + 2.9 * np.outer(np.cos(angles), across)
            + 3.2 * np.outer(np.sin(angles), (0.0, 1.0, 0.0))
        )  # fmt: skip
    places = np.concatenate(rows)
    triangles = _ring_mesh(len(stations), len(angles))
    return places, triangles, np.broadcast_to(_GUMS, places.shape)


def _ellipsoid(
    middle: Array,
    half_mm: tuple[float, float, float],
    colour: tuple[float, ...],
    roundness: float = 1.0,
    around: int = 16,
) -> Piece:
    """Return the mesh of a superellipsoid about `middle` with half axes `half_mm`.

    The mesh is an ellipsoid at roundness 1, a box with round edges below. around: vertices a row.
    """
    up = np.linspace(-np.pi / 2, np.pi / 2, 9)
    angles = np.linspace(0, 2 * np.pi, around, endpoint=False)

    def rounded(values: Array) -> Array:
        return np.asarray(np.sign(values) * np.abs(values) ** roundness, dtype=np.float64)

    ring = rounded(np.cos(up))[:, None]
    unit = np.stack(
        [
            ring * rounded(np.sin(angles)),
            np.broadcast_to(rounded(np.sin(up))[:, None], (len(up), around)),
            ring * rounded(np.cos(angles)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    places = middle + unit * half_mm
    return places, _ring_mesh(len(up), around), np.broadcast_to(colour, places.shape)


def _mouth_inside(frame: MouthFrame) -> Part:
    """Return the mesh of the inside of the mouth: rings from the lips' inner rim to a dark end.

    Behind the lips the rings widen to an oval, and narrow to a point at the end. The front moves
    with the lips, the lower back with the jaw, the upper back not at all.
    """
    n = len(frame.places_mm)
    lips = frame.places_mm
    angle = np.arctan2((lips[:, 1] - frame.middle_mm[1]) * 8.0, lips[:, 0] - frame.middle_mm[0])
    oval = np.column_stack([np.cos(angle) * _INSIDE_MM[0], np.sin(angle) * _INSIDE_MM[1]])
    back = np.column_stack([oval, np.full(n, -48.0)]) + frame.middle_mm
    # Ring by ring from the front (along = 0): place, share of the lips' motion, colour.
    places, lip_shares, colours = [], [], []
    for row in range(_ROWS):
        along = row / (_ROWS - 1)
        widened = min(1.0, along * 2.5)
        ring = (1 - widened) * lips + widened * back
        ring[:, 2] = (1 - along) * lips[:, 2] + along * back[:, 2]
        narrow = 1.0 if along < 0.75 else 4.0 * (1.0 - along)
        ring[:, :2] = frame.middle_mm[:2] + narrow * (ring[:, :2] - frame.middle_mm[:2])
        places.append(ring)
        lip_shares.append(np.full(n, max(0.0, 1.0 - along * 2.5)))
        fade = min(1.0, along * 1.6)
        colours.append(np.broadcast_to((1 - fade) * _INSIDE_FRONT + fade * _INSIDE_BACK, (n, 3)))
    all_places = np.concatenate(places)
    of_lips = np.concatenate(lip_shares)[:, None]
    # Share of the jaw's motion: 1 in the lower half of a ring, 0 in the upper.
    lower = np.clip(0.5 - 2.0 * np.sin(np.tile(angle, _ROWS)), 0.0, 1.0)[:, None]
    jaw = frame.displacements_with_jaw(all_places)
    still = np.zeros_like(all_places)
    morphs = {
        name: of_lips * np.tile(moves, (_ROWS, 1)) + (1 - of_lips) * lower * jaw.get(name, still)
        for name, moves in frame.morphs.items()
    }
    return Part("mouth", all_places, _ring_mesh(_ROWS, n)[:, ::-1], np.concatenate(colours), morphs)


def _ring_mesh(n_rows: int, n_round: int) -> Indices:
    """Return the triangles between `n_rows` rows of vertices, each a closed ring of `n_round`."""
    vertex = np.arange(n_rows * n_round).reshape(n_rows, n_round)
    here, above = vertex[:-1], vertex[1:]
    ahead, above_ahead = np.roll(here, -1, axis=1), np.roll(above, -1, axis=1)
    bands = [np.stack([here, ahead, above], -1), np.stack([ahead, above_ahead, above], -1)]
    return np.concatenate([band.reshape(-1, 3) for band in bands])


def _join_pieces(pieces: list[Piece]) -> Piece:
    """Return meshes as one mesh; each one's triangles are renumbered by the vertices before it."""
    first = np.cumsum([0, *(len(places) for places, _, _ in pieces)])
    return (
        np.vstack([places for places, _, _ in pieces]),
        np.vstack([triangles + at for (_, triangles, _), at in zip(pieces, first, strict=False)]),
        np.vstack([colours for _, _, colours in pieces]),
    )


#: The point that the head turns about: the top of the spine.
PIVOT_MM = (0.0, -70.0, -88.0)
#: Height below the pivot, radius and grey; the neck is wider than deep.
_PROFILE = (
    (0.0, 44.0, 0.32),
    (-45.0, 46.0, 0.38),
    (-68.0, 50.0, 0.41),
    (-82.0, 62.0, 0.50),
    (-100.0, 90.0, 0.53),
    (-124.0, 126.0, 0.53),
    (-165.0, 156.0, 0.51),
    (-250.0, 172.0, 0.48),
)
_TINT = (0.92, 1.0, 1.10)
_DEPTH_SHARE = 0.72
_SIDES = 64
_NECK_ROWS = 40


def neck() -> Part:
    """Return the neck's mesh, from inside the head downwards; it does not turn with the head."""
    profile = np.array(_PROFILE)
    steps = np.linspace(0, len(profile) - 1, _NECK_ROWS)
    height, radius, grey = PchipInterpolator(np.arange(len(profile)), profile)(steps).T
    around = np.linspace(0, 2 * np.pi, _SIDES, endpoint=False)
    places = np.stack(
        [
            np.outer(radius, np.sin(around)),
            np.repeat(height[:, None], _SIDES, axis=1),
            np.outer(radius, np.cos(around)) * _DEPTH_SHARE,
        ],
        axis=-1,
    ).reshape(-1, 3) + np.array(PIVOT_MM)
    # Its rows go downwards, so that its triangles turn the other way.
    triangles = np.roll(_ring_mesh(_NECK_ROWS, _SIDES)[:, ::-1], 1, axis=1)
    return Part(
        "neck", places, triangles, np.repeat(np.outer(grey, _TINT), _SIDES, axis=0), stays=True
    )
