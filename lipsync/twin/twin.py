"""The twin of a face model, a head for displays: the model's mouth on a head, as morph targets.

The skin is a shell, linear like the face model, so both together are: with markers m = mu + c P the
skin is V + W (m - V_markers) = (V + T_0) + sum_k c_k T_k. One target a component, one number a
component a frame, and nothing is solved after the start.

Lids, brows and smile are morph targets of the same shell, with handles of their own. Their amounts
are chosen to look right; nothing is learned here.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Indices
from lipsync.errors import UserError
from lipsync.face.head_motion import apply_similarity, fit_similarity
from lipsync.face.model import FaceModel
from lipsync.markers import INNER_LIP, MARKERS_47, OUTER_LIP
from lipsync.twin.head_surface import (
    CHIN,
    FACE_RIM,
    JAW_JOINT,
    LEFT_BROW,
    LEFT_EYE,
    N_SKIN,
    RIGHT_BROW,
    RIGHT_EYE,
    HeadSurface,
    MeanFace,
    head_surface,
    influence,
    load_mean_face,
    spread,
)
from lipsync.twin.parts import (
    PIVOT_MM,
    Eyeball,
    MouthFrame,
    Part,
    eyeballs,
    jaw_motion,
    lid_lining,
    mouth_parts,
    neck,
)

#: Share of the way to the upper lid that the lower one goes; clearance of a lid over the eyeball.
_LOWER_SHARE, _CLEARANCE_MM = 0.12, 0.7
#: Skin behind this depth follows no expression.
_TEMPLE_MM = -50.0
#: A raised brow, from its outer end inwards.
_BROW_UP_MM = np.array([3.5, 6.0, 7.0, 6.5, 5.0])
#: A broad smile of the face's left half: out, up, forward in mm by landmark; the right mirrors it.
_SMILE_LEFT_MM = {
    291: (6.5, 4.5, -3.5), 308: (6.0, 3.8, -3.2), 269: (2.6, 1.6, -1.2), 405: (3.0, 1.6, -1.2),
    267: (0.9, 0.4, -0.9), 314: (1.1, 0.5, -0.9), 312: (1.4, 0.4, -1.0), 317: (1.5, 0.6, -1.0),
    436: (3.0, 3.6, 0.6), 432: (4.8, 3.0, -0.8), 425: (1.0, 3.2, 2.4), 427: (1.8, 2.8, 0.8),
    411: (1.0, 1.4, 0.4), 280: (0.2, 1.6, 1.4), 327: (0.7, 0.3, 0.0), 365: (0.5, 0.4, 0.0),
    397: (0.6, 0.5, 0.0),
}  # fmt: skip
_SMILE_MIDDLE_MM = {0: (0.0, 0.0, -0.9), 17: (0.0, 0.2, -0.9), 13: (0.0, 0.1, -1.0),
                    14: (0.0, 0.3, -1.0)}  # fmt: skip
_MIRRORED = {
    291: 61, 308: 78, 269: 39, 405: 181, 267: 37, 314: 84, 312: 82, 317: 87, 436: 216, 432: 212,
    425: 205, 427: 207, 411: 187, 280: 50, 327: 98, 365: 136, 397: 172,
}  # fmt: skip
_SMILE_RIGHT_MM = {_MIRRORED[n]: (-out, up, z) for n, (out, up, z) in _SMILE_LEFT_MM.items()}
_SMILE_MM = _SMILE_LEFT_MM | _SMILE_MIDDLE_MM | _SMILE_RIGHT_MM
#: Motions of the lips' outer edge, and of their inner rim, in mm (sideways, up, forward) of upper
#: and lower lip. F and V: the lower lip rolls in: its outer edge goes up, its inner rim back under
#: the teeth, which the lifted upper lip shows. TH: lips part where the tongue would be hidden.
_LIPS_MM = {
    "lip_tuck": (((0.0, 2.4, 0.5), (0.0, 5.2, -1.0)), ((0.0, 4.2, 0.3), (0.0, 1.2, -5.0))),
    "tongue_dental": (((0.0, 0.4, 0.0), (0.0, -2.2, 0.3)), ((0.0, 0.6, 0.0), (0.0, -3.2, 0.3))),
}
_LipsMm = tuple[tuple[float, float, float], tuple[float, float, float]]
_NOSTRILS = (2, 97, 326, 98, 327)
#: A smile of the eyes: the lower lids rise.
_SMILING_LID_MM = 0.9


def expression_morphs(surface: HeadSurface, eyes: tuple[Eyeball, ...]) -> dict[str, Array]:
    """Return the skin's displacements at full lid_left, lid_right, brow, smile and `_LIPS_MM`.

    lid_left_over and lid_right_over are further targets, to be applied by lid (1 - lid), where lid
    is 0 to 1: a straight path would lead a half shut lid through the eyeball.

    Parameters
    ----------
    surface : HeadSurface
        Surface of the head.
    eyes : tuple[Eyeball, ...]
        Left and right.

    Returns
    -------
    dict[str, Array]
        (n, 3) mm each.
    """
    places = surface.places_mm
    rims = [np.array(surface.loop_from(*eye_rim[:2])) for eye_rim in (LEFT_EYE, RIGHT_EYE)]
    brows = np.array([*LEFT_BROW[0], *LEFT_BROW[1], *RIGHT_BROW[0], *RIGHT_BROW[1]])
    # Four columns of displacements (left lid, right lid, brow, smile), given at some vertices and
    # spread over the skin between them; other marked vertices stay where they are.
    given_mm = np.zeros((len(places), 4, 3))
    for eye_index, rim in enumerate(rims):
        given_mm[rim, eye_index] = _lid_shutting(places[rim])
        # Round an eye: 0 on the upper lid, up to 1 and back on the lower one.
        lower_lid = np.maximum(0.0, -np.sin(2 * np.pi * (np.arange(len(rim)) / len(rim))))
        given_mm[rim, 3, 1] = _SMILING_LID_MM * lower_lid
    given_mm[brows, 2, 1] = np.tile(_BROW_UP_MM, 4)
    for landmark in MARKERS_47.landmarks:
        given_mm[landmark, 3] = _SMILE_MM.get(landmark, 0.0)
    is_given = (places[:, 2] < _TEMPLE_MM) | (places[:, 1] > places[FACE_RIM[0], 1])
    is_given[[*rims[0], *rims[1], *brows, *MARKERS_47.landmarks]] = True
    given_rows = given_mm[is_given].reshape(is_given.sum(), -1)
    spread_mm = spread(surface.stiffness, np.flatnonzero(is_given), given_rows)
    lid_left, lid_right, brow, smile = spread_mm.reshape(len(places), 4, 3).transpose(1, 0, 2)
    lips = {name: _lip_motion(surface, *motions_mm) for name, motions_mm in _LIPS_MM.items()}
    morphs = {"brow": brow, "smile": smile, **lips}
    for lid, eye in ((lid_left, eyes[0]), (lid_right, eyes[1])):
        morphs |= _outside_eyeball(f"lid_{eye.side}", places, lid, eye)
    return morphs


def _lip_motion(surface: HeadSurface, outer_mm: _LipsMm, inner_mm: _LipsMm) -> Array:
    """Return displacements (n, 3) of the skin, mm, that move the lips as an entry of `_LIPS_MM`.

    Full in the middle of the lips, nothing at their corners.
    """
    places = surface.places_mm
    given_mm = np.zeros_like(places)
    for landmarks, (upper_mm, lower_mm) in ((OUTER_LIP, outer_mm), (INNER_LIP, inner_mm)):
        rim = places[list(landmarks)]
        half = len(landmarks) // 2
        middle_mm, reach_mm = rim[[0, half], 0].mean(), np.ptp(rim[[0, half], 0]) / 2.0
        share = np.clip(1.0 - ((rim[:, 0] - middle_mm) / reach_mm) ** 2, 0.0, 1.0)[:, None]
        is_upper = (np.arange(len(landmarks)) < half)[:, None]
        given_mm[list(landmarks)] = share * np.where(is_upper, upper_mm, lower_mm)
    is_given = np.zeros(len(places), dtype=bool)
    is_given[surface.anchors] = is_given[[*OUTER_LIP, *INNER_LIP, *CHIN, *_NOSTRILS]] = True
    return spread(surface.stiffness, np.flatnonzero(is_given), given_mm[is_given])


def _lid_shutting(rim_mm: Array) -> Array:
    """Return displacements (n, 3) of the lids' edge `rim_mm` (n, 3) that shut the eye.

    The first half of the edge is the upper lid; both lids go to a line near the lower one.
    """
    half = len(rim_mm) // 2
    upper, lower = rim_mm[: half + 1], np.vstack([rim_mm[half:], rim_mm[:1]])[::-1]
    # Both from the same corner of the eye to the other.
    meeting_line = (1 - _LOWER_SHARE) * lower + _LOWER_SHARE * upper
    displacements = np.zeros_like(rim_mm)
    displacements[: half + 1] = meeting_line - upper
    displacements[half:] = meeting_line[::-1][:-1] - rim_mm[half:]
    displacements[[0, half]] = 0.0
    return displacements


def _outside_eyeball(name: str, places: Array, lid: Array, eye: Eyeball) -> dict[str, Array]:
    """Return a lid's targets `name` and `name`_over, which keep it outside the eyeball.

    lid: displacements (n, 3) of the skin `places` that shut it in a straight line. The first target
    shuts it; the second, times lid (1 - lid), corrects half shut lids.
    """
    on_lid = np.linalg.norm(lid, axis=1) > 0.05

    def pushed_out(points: Array) -> Array:
        """Return the points, those of the lid moved from inside the eyeball to just outside it."""
        ray = points - eye.centre_mm
        length = np.linalg.norm(ray, axis=1, keepdims=True)
        least = np.where(on_lid & (ray[:, 2] > 0), eye.radius_mm + _CLEARANCE_MM, 0.0)[:, None]
        return np.asarray(eye.centre_mm + ray * np.maximum(1.0, least / length), dtype=np.float64)

    shut = pushed_out(places + lid) - places
    half = pushed_out(places + 0.5 * shut) - places
    return {name: shut, f"{name}_over": 4.0 * (half - 0.5 * shut)}


class TwinError(UserError):
    """Error for a face model that cannot be shown on a head; the message says why."""


@dataclass(frozen=True, slots=True)
class Twin:
    """A head to draw, with morph targets of mouth and expression.

    parts: the first is the skin. components: names of the targets of the mouth, in the order of the
    model's coefficients; rest: (n_components,), the closed mouth; deviations: (n_components,),
    standard deviation of each coefficient in speech. The other targets are lid_left, lid_right,
    brow, smile, lip_tuck, tongue_dental, tongue_alveolar as in `Expression`, and lid_left_over,
    lid_right_over for lid (1 - lid).
    pivot_mm: the point that the head turns about. face_vertices (n,): whether a vertex of the skin
    is face, not back of the head.
    """

    parts: tuple[Part, ...]
    eyes: tuple[Eyeball, ...]
    components: tuple[str, ...]
    rest: Array
    deviations: Array
    pivot_mm: Array
    face_vertices: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class SkinMorphs:
    """The skin of a head as a linear function of a face model's coefficients.

    places_mm (n, 3): V + T_0, at coefficients 0. targets_mm (n_components, n, 3): T_k. weights
    (n, n_points): how far each vertex moves with each of the model's points that lie on skin;
    `points`: their numbers in the model.
    """

    places_mm: Array
    targets_mm: Array
    weights: Array
    points: tuple[int, ...]


def make_twin(face: FaceModel, mean: MeanFace | None = None, mouth: Array | None = None) -> Twin:
    """Return the twin of a face model, on the shipped head or a given head. Raises TwinError.

    Parameters
    ----------
    face : FaceModel
        The face model.
    mean : MeanFace | None
        A head; None: the shipped one.
    mouth : Array | None
        (n_components,), the model's coefficients for the given head's mouth as it is: the head
        keeps its own lips, and moves by a frame's difference from them. None: the lips of the
        model's mean face are laid on the head.

    Returns
    -------
    Twin
        The head to draw, in mm.
    """
    mean = mean or load_mean_face()
    surface = head_surface(mean)
    skin = skin_morphs(face, surface)
    if mouth is not None:
        at_zero_mm = surface.places_mm - np.tensordot(mouth, skin.targets_mm, 1)
        skin = replace(skin, places_mm=at_zero_mm)
    eyes = eyeballs(surface, mean.irises_mm)
    components = tuple(f"c{k}" for k in range(face.n_components))
    morphs = dict(zip(components, skin.targets_mm, strict=True)) | expression_morphs(surface, eyes)
    lips = np.array(surface.loop_from(*INNER_LIP[:2]))
    parts = (
        Part("skin", skin.places_mm, surface.triangles, surface.colours, morphs),
        *(lid_lining(surface, morphs, eye) for eye in eyes),
        *mouth_parts(_mouth_frame(skin.places_mm, lips, morphs, components)),
        neck(),
    )
    deviations = np.sqrt(np.diag(face.covariance))
    pivot_mm = np.array(PIVOT_MM)
    is_face = mean.behind <= mean.behind[list(FACE_RIM)].max() + 0.05
    return Twin(parts, eyes, components, face.rest, deviations, pivot_mm, is_face)


def skin_morphs(face: FaceModel, surface: HeadSurface) -> SkinMorphs:
    """Return the skin V + T_0 and the targets T_k, in mm, of a face model on a head's surface.

    V: the surface's vertices; T_0, T_k: their displacements by the mean face and by coefficient k.
    Raises TwinError if the model has fewer than three points on the 478-point face mesh.
    """
    landmarks = face.layout.landmarks
    points = tuple(i for i, landmark in enumerate(landmarks) if landmark < N_SKIN)
    handles = [landmarks[i] for i in points]
    if len(points) < 3:
        raise TwinError(
            f"layout {face.layout.name}: its points have other numbers than those of the 478-point "
            "face mesh, so the twin's head cannot show them"
        )
    weights = influence(surface.stiffness, handles, surface.anchors.tolist())
    at_mean, basis = worn_face(face, surface.places_mm[handles], points)
    offsets = weights @ (at_mean - surface.places_mm[handles])
    return SkinMorphs(
        surface.places_mm + offsets, np.stack([weights @ each for each in basis]), weights, points
    )


def worn_face(face: FaceModel, on_head_mm: Array, points: tuple[int, ...]) -> tuple[Array, Array]:
    """Return mean and basis of a face model, laid on a head by a similarity.

    The model's head is turned as its speaker sat, and another speaker's has another size; the
    similarity that lays the closed mouth on the head's own removes both.

    Parameters
    ----------
    face : FaceModel
        The face model.
    on_head_mm : Array
        (n_points, 3) mm: the points on the head.
    points : tuple[int, ...]
        The points' numbers in the model.

    Returns
    -------
    tuple[Array, Array]
        Mean (n_points, 3) mm and basis (n_components, n_points, 3).
    """
    numbers = list(points)
    at_rest = face.markers_mm(face.rest[None])[:, numbers]
    scale, rotation, translation = fit_similarity(at_rest, on_head_mm)
    at_mean = apply_similarity(face.mean_mm[None, numbers], scale, rotation, translation)[0]
    basis = face.basis.reshape(face.n_components, -1, 3)[:, numbers]
    return at_mean, scale[0] * basis @ rotation[0].T


def _mouth_frame(
    places: Array, lips: Indices, morphs: dict[str, Array], components: tuple[str, ...]
) -> MouthFrame:
    """Return the frame by which teeth, tongue and inside of the mouth are placed and moved.

    places: (n, 3) mm, the skin's vertices; lips: the vertices of the lips' inner rim, in order;
    morphs: displacements (n, 3) in mm by morph target; components: the targets of the face model.
    """
    chin = list(CHIN)
    joint = places[list(JAW_JOINT)].mean(axis=0)
    chin_moves = np.stack([morphs[name][chin] for name in components])
    motion = jaw_motion(places[chin], joint, chin_moves)
    return MouthFrame(
        places[lips],
        {name: morphs[name][lips] for name in (*components, "smile", *_LIPS_MM)},
        places[[INNER_LIP[5], INNER_LIP[15]]].mean(axis=0),
        joint,
        dict(zip(components, motion, strict=True)),
    )
