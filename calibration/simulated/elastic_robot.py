"""A simulated robot unlike our fits' models: an elastic skin, lips in contact, a linked jaw.

The second family of simulated robots, made from physics: horns that turn pull the skin by rods that
yield, the jaw hangs on a four-bar linkage and sags, lips meet without friction (complementarity of
gap and force, Cottle, Pang and Stone, 1992, solved by active sets), the left side is
weak, dots lie beside the lips' edges, zeros drift as the servos warm up, gears have backlash.

The skin is a small finite-element model, solved once for each robot: in the plane of the face
constant-strain triangles in plane stress, out of it a membrane under tension (Zienkiewicz and
Taylor, The Finite Element Method, 2000, chapters 4 and 7); both lie on a soft foundation, part
skull and part jaw. Rods pull at patches of it. Displacements are small against the face, so one
stiffness matrix serves all poses; only the horns, the jaw and the lips that meet are not linear.
Not simulated: friction, creep of the skin, loads that move a servo's encoder.
Loads SciPy; the live path never does.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import Delaunay

from lipsync.arrays import Array
from lipsync.markers import MARKERS_47


@dataclass(frozen=True, slots=True)
class FourBar:
    """A four-bar linkage, in mm: crank (servo's horn), rod, rocker (jaw's lever) and ground.

    start_deg: the crank's angle to the ground with the servo at 0.
    """

    crank_mm: float
    rod_mm: float
    rocker_mm: float
    ground_mm: float
    start_deg: float

    def jaw_deg(self, servo_deg: Array) -> Array:
        """Return the jaw's angle; it is 0 with the servo at 0 (Freudenstein 1955, equation 1).

        Parameters
        ----------
        servo_deg : Array
            (n,) degrees.

        Returns
        -------
        Array
            (n,) degrees.
        """
        return np.asarray(self._rocker_deg(servo_deg) - self._rocker_deg(np.zeros(1)))

    def can_turn(self, servo_deg: Array) -> bool:
        """Return whether rod and rocker reach the crank's end at these angles and all between.

        Parameters
        ----------
        servo_deg : Array
            (n,) degrees.

        Returns
        -------
        bool
            True where they do, and the rocker turns steadily.
        """
        most, least = float(servo_deg.max()), float(servo_deg.min())
        angles_deg = np.linspace(least, most, max(2, round(most - least)))
        reach = self._reach_mm(angles_deg)[2]
        longest, shortest = self.rocker_mm + self.rod_mm, abs(self.rocker_mm - self.rod_mm)
        steps = np.diff(self._rocker_deg(angles_deg))
        return bool((reach < longest).all() and (reach > shortest).all() and (steps > 0.0).all())

    def _rocker_deg(self, servo_deg: Array) -> Array:
        """Return the rocker's angle to the ground, (n,) degrees, by the law of cosines."""
        x, y, reach = self._reach_mm(servo_deg)
        # The triangle of rod, rocker and the line from the crank's end to the rocker's axis.
        cosine = (self.rocker_mm**2 + reach**2 - self.rod_mm**2) / (2 * self.rocker_mm * reach)
        inner_rad = np.arccos(np.clip(cosine, -1.0, 1.0))
        return np.asarray(np.rad2deg(np.arctan2(-y, -x) - inner_rad))

    def _reach_mm(self, servo_deg: Array) -> tuple[Array, Array, Array]:
        """Return x, y and length in mm of the vector from the crank's end to the rocker's axis."""
        crank = np.deg2rad(self.start_deg + servo_deg)
        x, y = self.ground_mm - self.crank_mm * np.cos(crank), -self.crank_mm * np.sin(crank)
        return x, y, np.hypot(x, y)


#: Silicone of 2 mm and 0.2 MPa (about Shore A 10): stiffness in the plane, and Poisson's ratio.
SHEET_N_PER_MM, POISSON = 0.4, 0.45
#: Tension out of the plane, of the same order; foam behind: with the sheet it lets a pull fade
#: over sqrt(0.4 / 0.001) = 20 mm.
TENSION_N_PER_MM, FOAM_N_PER_MM3 = 0.3, 0.001
#: Lips hang free: less foam behind them, fading in over so many millimetres from the slit.
_LIP_FOAM, _LIP_MM = 0.3, 9.0
_GRID_MM, _CLEAR_MM = 9.0, 4.5
#: Lips are thicker than the skin around them, fading out over the same millimetres.
_LIP_THICKNESS = 6.0
#: The slit is this wide in the mesh alone, so that triangles know their lip.
_SLIT_MM = 0.75
#: Pairs of opposite points along the lips' edges, without the corners.
N_PAIRS = 9
_ROD_PATCH_MM = 7.0
_UPPER_INNER, _LOWER_INNER, _CORNERS = (82, 13, 312), (87, 14, 317), (78, 308)
_LANDMARKS = MARKERS_47.landmarks


def _row(landmark: int) -> int:
    return _LANDMARKS.index(landmark)


@dataclass(frozen=True, slots=True)
class ElasticSkin:
    """A skin of n nodes, with its stiffness and the dots on it.

    places_mm: (n, 3), at rest; the first N_PAIRS nodes are the upper lip's edge, the next N_PAIRS
    the lower's, from the robot's right to its left.
    stiffness: (3 n, 3 n), x of all nodes, then y, then z, without rods; foam: (n,), N/mm;
    jaw_share: (n,), share of the foam that lies on the jaw. dots: (47, n), weights of the nodes in
    each marker; dots_mm: (47, 3), markers at rest; off_edge_mm: (6,), the inner lips' dots from the
    edge.
    """

    places_mm: Array
    stiffness: Array
    foam: Array
    jaw_share: Array
    dots: Array
    dots_mm: Array
    off_edge_mm: Array

    def patch(self, place_mm: Array, below_slit: bool | None) -> Array:
        """Return the weights of the nodes at which a rod pulls.

        Parameters
        ----------
        place_mm : Array
            (3,) mm, the middle of the patch.
        below_slit : bool | None
            True: nodes of the lower lip alone; False: of the upper alone; None: of both.

        Returns
        -------
        Array
            (n,), with sum 1.
        """
        apart_mm = np.linalg.norm(self.places_mm[:, :2] - place_mm[:2], axis=1)
        weight = np.exp(-0.5 * (apart_mm / _ROD_PATCH_MM) ** 2)
        if below_slit is not None:
            weight[self.jaw_share < 0.5 if below_slit else self.jaw_share > 0.5] = 0.0
        return np.asarray(weight / weight.sum())


def elastic_skin(rest_mm: Array, gaps_mm: Array, off_edge_mm: Array) -> ElasticSkin:
    """Return the elastic skin of a closed mouth.

    Parameters
    ----------
    rest_mm : Array
        (47, 3) mm.
    gaps_mm : Array
        (N_PAIRS,) mm: gaps between the lips' edges.
    off_edge_mm : Array
        (6,) mm: distance of each inner-lip dot from the edge, upper lip first.

    Returns
    -------
    ElasticSkin
        Skin with nodes in mm and stiffness.
    """
    # The line where the lips meet, from corner to corner, and N_PAIRS points along it: the lips'
    # edges.
    seam = rest_mm[[_row(_CORNERS[0]), *map(_row, _UPPER_INNER), _row(_CORNERS[1])]].copy()
    seam[1:4] = (seam[1:4] + rest_mm[[_row(n) for n in _LOWER_INNER]]) / 2
    edge_shares = np.linspace(0.0, 1.0, N_PAIRS + 2)[1:-1]
    seam_shares = (seam[:, 0] - seam[0, 0]) / (seam[-1, 0] - seam[0, 0])
    edge_mm = np.stack([np.interp(edge_shares, seam_shares, seam[:, k]) for k in range(3)], axis=1)
    half_gap_mm = np.zeros((N_PAIRS, 3))
    half_gap_mm[:, 1] = gaps_mm / 2
    other_rows = [i for i, n in enumerate(_LANDMARKS) if n not in (*_UPPER_INNER, *_LOWER_INNER)]
    # Nodes in space: both edges, all dots but the inner lips', then a grid around them. In the
    # plane of the mesh the edges lie apart, so that triangles know their lip.
    fixed_mm = np.concatenate([edge_mm + half_gap_mm, edge_mm - half_gap_mm, rest_mm[other_rows]])
    plane_mm = np.concatenate([edge_mm, edge_mm, rest_mm[other_rows]])[:, :2].copy()
    plane_mm[:N_PAIRS, 1] += _SLIT_MM
    plane_mm[N_PAIRS : 2 * N_PAIRS, 1] -= _SLIT_MM
    grid_mm = _background_nodes(plane_mm)
    places_mm = np.concatenate([fixed_mm, _with_depth(grid_mm, fixed_mm)])
    plane_mm = np.concatenate([plane_mm, grid_mm])
    mesh = Delaunay(plane_mm)
    is_in_slit = _across_slit(mesh.simplices)
    triangles = mesh.simplices[~is_in_slit]
    # Lips are thicker than the skin around them, with less foam behind; the mesh's rim is held
    # stiffly.
    from_slit_mm = np.linalg.norm(plane_mm[:, None] - edge_mm[None, :, :2], axis=2).min(axis=1)
    thickness = 1.0 + (_LIP_THICKNESS - 1.0) * np.exp(-0.5 * (2.0 * from_slit_mm / _LIP_MM) ** 2)
    area_mm2, stiffness = _assemble(plane_mm, triangles, thickness)
    foam = FOAM_N_PER_MM3 * area_mm2 * np.clip(from_slit_mm / _LIP_MM, _LIP_FOAM, 1.0)
    foam[np.unique(mesh.convex_hull)] *= 50.0
    dots_2d, dots_mm = _place_dots(rest_mm, edge_mm, edge_shares, seam_shares, gaps_mm, off_edge_mm)
    return ElasticSkin(
        places_mm=places_mm,
        stiffness=stiffness + np.diag(np.tile(foam, 3)),
        foam=foam,
        jaw_share=_jaw_share(plane_mm, edge_mm),
        dots=_interpolation(mesh, is_in_slit, plane_mm, dots_2d),
        dots_mm=dots_mm,
        off_edge_mm=off_edge_mm,
    )


def _background_nodes(flat: Array) -> Array:
    """Return points of a grid, (m, 2), over the extent of the points `flat` but not near any."""
    low, high = flat.min(axis=0) - _GRID_MM, flat.max(axis=0) + _GRID_MM
    x, y = (np.arange(low[k], high[k] + _GRID_MM, _GRID_MM) for k in (0, 1))
    grid = np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2)
    apart = np.linalg.norm(grid[:, None] - flat[None], axis=2).min(axis=1)
    return np.asarray(grid[apart > _CLEAR_MM])


def _with_depth(flat: Array, known_mm: Array) -> Array:
    """Return the points `flat` (m, 2) with a depth interpolated between points known_mm (k, 3)."""
    interpolated = LinearNDInterpolator(known_mm[:, :2], known_mm[:, 2])(flat)
    nearest = NearestNDInterpolator(known_mm[:, :2], known_mm[:, 2])(flat)
    return np.column_stack([flat, np.where(np.isnan(interpolated), nearest, interpolated)])


def _across_slit(simplices: NDArray[np.int_]) -> NDArray[np.bool_]:
    """Return which triangles span the slit of the mouth: those with nodes of both lips' edges.

    simplices: (m, 3), node numbers of each triangle.
    """
    upper = (simplices < N_PAIRS).any(axis=1)
    lower = ((simplices >= N_PAIRS) & (simplices < 2 * N_PAIRS)).any(axis=1)
    return np.asarray(upper & lower)


def _assemble(flat: Array, triangles: NDArray[np.int_], thick: Array) -> tuple[Array, Array]:
    """Return the area of each node, (n,) mm^2, and the stiffness (3 n, 3 n) of sheet and membrane.

    flat: (n, 2) mm, the nodes; triangles: (m, 3), their numbers; thick: (n,), relative.
    Constant-strain triangles in plane stress, and a membrane under tension out of the plane
    (Zienkiewicz and Taylor, The Finite Element Method, 2000, chapters 4 and 7).
    """
    n = len(flat)
    node_area, stiffness = np.zeros(n), np.zeros((3 * n, 3 * n))
    plane = np.array([[1, POISSON, 0], [POISSON, 1, 0], [0, 0, (1 - POISSON) / 2]])
    plane *= SHEET_N_PER_MM / (1 - POISSON**2)
    for nodes in triangles:
        (x1, y1), (x2, y2), (x3, y3) = flat[nodes]
        dy, dx = np.array([y2 - y3, y3 - y1, y1 - y2]), np.array([x3 - x2, x1 - x3, x2 - x1])
        # Twice the area of the triangle.
        twice = abs((x2 - x1) * (y3 - y1) - (x3 - x1) * (y2 - y1))
        if twice < 1e-6:
            continue
        # Strains xx, yy and xy by the nodes' displacements along x, then along y.
        strain = np.zeros((3, 6))
        strain[0, :3], strain[1, 3:] = dy, dx
        strain[2, :3], strain[2, 3:] = dx, dy
        strain /= twice
        xy = np.concatenate([nodes, nodes + n])
        stiffness[np.ix_(xy, xy)] += strain.T @ plane @ strain * twice / 2 * thick[nodes].mean()
        # Slopes of the displacement along z by the nodes' displacements.
        slopes = np.stack([dy, dx]) / twice
        z = nodes + 2 * n
        stiffness[np.ix_(z, z)] += (
            TENSION_N_PER_MM * slopes.T @ slopes * twice / 2 * thick[nodes].mean()
        )
        node_area[nodes] += twice / 6
    return node_area, stiffness


def _jaw_share(flat: Array, edge_mm: Array) -> Array:
    """Return each node's share of the jaw's motion, (n,), 0 to 1.

    It changes sharply at the lips and broadly at the ears. flat: (n, 2) mm, the nodes; edge_mm:
    (N_PAIRS, 3), where the lips meet.
    """
    middle_xy = edge_mm[:, :2].mean(axis=0)
    # The blend from head to jaw widens from the middle, as `JAW_BLEND_WIDTH_PER_MM` in face.py.
    width_mm = np.maximum(0.45 * np.abs(flat[:, 0] - middle_xy[0]), 1.0)
    height_mm = flat[:, 1] - np.interp(flat[:, 0], edge_mm[:, 0], edge_mm[:, 1])
    share = 1.0 / (1.0 + np.exp(np.clip(height_mm / width_mm, -50.0, 50.0)))
    share[:N_PAIRS], share[N_PAIRS : 2 * N_PAIRS] = 0.0, 1.0
    return np.asarray(share)


def _place_dots(
    rest_mm: Array, edge_mm: Array, edge_at: Array, seam_at: Array, gaps_mm: Array, off_mm: Array
) -> tuple[Array, Array]:
    """Return the 47 dots in the mesh's plane, (47, 2), and in space, (47, 3), in mm.

    Inner-lip dots lie off_mm, (6,), beside the lips' edges. edge_at: position of each point of
    edge_mm from corner to corner, 0 to 1; seam_at: positions of the inner-lip landmarks,
    likewise.
    """
    flat, places_mm = rest_mm[:, :2].copy(), rest_mm.copy()
    for side, landmarks in ((1.0, _UPPER_INNER), (-1.0, _LOWER_INNER)):
        for k, landmark in enumerate(landmarks):
            row = _row(landmark)
            centre = np.array([np.interp(seam_at[k + 1], edge_at, edge_mm[:, i]) for i in range(3)])
            off = side * off_mm[k if side > 0 else 3 + k]
            flat[row] = centre[:2] + np.array([0.0, side * _SLIT_MM + off])
            places_mm[row] = centre
            places_mm[row, 1] += side * np.interp(seam_at[k + 1], edge_at, gaps_mm) / 2 + off
    return flat, places_mm


def _interpolation(mesh: Delaunay, across: NDArray[np.bool_], flat: Array, points: Array) -> Array:
    """Return each point's barycentric node weights, (n_points, n).

    flat: (n, 2), nodes of the mesh; across: which triangles lie in the slit of the mouth. Points in
    these, or outside the mesh, get the motion of the nearest node.
    """
    weights = np.zeros((len(points), len(flat)))
    for row, (point, triangle) in enumerate(zip(points, mesh.find_simplex(points), strict=True)):
        if triangle < 0 or across[triangle]:
            weights[row, np.linalg.norm(flat - point, axis=1).argmin()] = 1.0
            continue
        transform = mesh.transform[triangle]
        # SciPy's transform of a triangle gives two of the three barycentric weights.
        first_two = transform[:2] @ (point - transform[2])
        weights[row, mesh.simplices[triangle]] = [*first_two, 1.0 - first_two.sum()]
    return weights


#: Lips are soft themselves: a pair gives way by so much.
_LIP_MM_PER_N = 0.1
#: Robots of seeds 2000 to 2011 need 4.
_ACTIVE_SET_ROUNDS = 30
#: Poses, of two moves each, after which two thirds of the warming is done.
_WARMING_POSES = 30.0


@dataclass(frozen=True, slots=True)
class Rod:
    """A rod from a horn to a patch of skin; the horn turns from `along` towards `over`.

    along, over: (3,), unit vectors; rides: the share of the jaw's turn that the rod's servo
    follows.
    """

    joint: int
    patch: Array
    place_mm: Array
    along: Array
    over: Array
    arm_mm: float
    n_per_mm: float
    rides: float


@dataclass(frozen=True, slots=True)
class ElasticDraw:
    """A drawn elastic robot. signs, zero_deg, play_deg, drift_deg: (n_servos,).

    jaw: number of the jaw's joint, or -1 without one; axis_mm: (3,), on the jaw's hinge. signs: -1
    for a servo that turns its horn oppositely; zero_deg: the horn's angle at 0; play_deg: backlash;
    drift_deg: shift of the zero once warm. jaw_rad_per_nmm: compliance of the jaw; sag_deg: its sag
    under its own weight.
    """

    servo_names: tuple[str, ...]
    skin: ElasticSkin
    rods: tuple[Rod, ...]
    jaw: int
    four_bar: FourBar
    axis_mm: Array
    sag_deg: float
    jaw_rad_per_nmm: float
    signs: Array
    zero_deg: Array
    play_deg: Array
    drift_deg: Array


@dataclass(frozen=True, slots=True)
class LipState:
    """The true state of n poses. markers_mm: (n, 47, 3).

    gaps_mm: (n, N_PAIRS), between the lips' edges; force_n: (n,), between the lips in all.
    """

    markers_mm: Array
    gaps_mm: Array
    force_n: Array


class ElasticFace:
    """A drawn robot with its skin solved, for markers, lip gaps and forces by servo angles."""

    def __init__(self, draw: ElasticDraw) -> None:
        """Solve the skin for the pull of each rod, the jaw's turn and the forces between the lips.

        The outputs of each are the motions of all dots (x of all, then y, then z) and of the gaps
        between the lips' edges.
        """
        self.draw = draw
        self.backlash_deg = draw.play_deg
        self.noise_stream: tuple[int, ...] = (7,)
        skin = draw.skin
        n = len(skin.places_mm)
        stiffness = skin.stiffness.copy()
        for rod in draw.rods:
            rod_stiffness = rod.n_per_mm * np.outer(rod.patch, rod.patch)
            for k in range(3):
                stiffness[k * n : (k + 1) * n, k * n : (k + 1) * n] += rod_stiffness
        inverse = np.linalg.inv(stiffness)
        upper, lower = np.arange(N_PAIRS) + n, np.arange(N_PAIRS, 2 * N_PAIRS) + n
        pushed = inverse[:, upper] - inverse[:, lower]
        dots = np.kron(np.eye(3), skin.dots)
        self._outputs = np.concatenate([dots, _unit_rows(3 * n, upper) - _unit_rows(3 * n, lower)])
        self._by_rod_pull = [
            self._outputs @ (inverse @ np.kron(np.eye(3), (rod.n_per_mm * rod.patch)[:, None]))
            for rod in draw.rods
        ]
        # What hangs on the jaw goes by (cos - 1) and sin of its turn, each times a constant.
        by_foam = self._outputs @ (inverse * np.tile(skin.foam, 3))
        carried = (
            _moved_by_turn(skin.places_mm - draw.axis_mm, np.array([np.pi, np.pi / 2]))
            * (skin.jaw_share[:, None])
        )
        by_pi, by_half_pi = carried.transpose(0, 2, 1).reshape(2, -1) @ by_foam.T
        self._by_jaw_turn = np.stack([-by_pi / 2, by_half_pi - by_pi / 2])
        self._gap_mm = skin.places_mm[:N_PAIRS, 1] - skin.places_mm[N_PAIRS : 2 * N_PAIRS, 1]
        self._by_lip_force = self._outputs @ pushed + self._jaw_compliance()
        self._compliance = self._by_lip_force[-N_PAIRS:] + _LIP_MM_PER_N * np.eye(N_PAIRS)

    def state(self, output_deg: Array, warmth: float = 1.0) -> LipState:
        """Return markers, lip gaps and closing force of poses.

        Parameters
        ----------
        output_deg : Array
            (n, n_servos) degrees of the horns, backlash included.
        warmth : float
            0 cold to 1 warm.

        Returns
        -------
        LipState
            Markers (n, 47, 3) mm, gaps (n, N_PAIRS) mm, force (n,) N.
        """
        draw = self.draw
        horns_deg = draw.signs * output_deg + draw.zero_deg + warmth * draw.drift_deg
        outputs = self._free_displacements(horns_deg, self._jaw_rad(horns_deg))
        free_gaps_mm = self._gap_mm + outputs[:, -N_PAIRS:]
        force_n = self._lip_forces_n(free_gaps_mm)
        outputs = outputs + force_n @ self._by_lip_force.T
        moved_mm = outputs[:, :-N_PAIRS].reshape(len(outputs), 3, -1).transpose(0, 2, 1)
        gaps_mm = free_gaps_mm + force_n @ (self._compliance - _LIP_MM_PER_N * np.eye(N_PAIRS)).T
        return LipState(draw.skin.dots_mm + moved_mm, np.maximum(gaps_mm, 0.0), force_n.sum(axis=1))

    def markers_mm(self, output_deg: Array) -> Array:
        """Return the markers of the warm robot in poses.

        Parameters
        ----------
        output_deg : Array
            (n, n_servos) degrees of the horns, backlash included.

        Returns
        -------
        Array
            (n, 47, 3) mm.
        """
        return self.state(output_deg).markers_mm

    def seen_mm(self, output_deg: Array, n_moves: int) -> Array:
        """Return the markers of a pose after `n_moves` moves, by which the robot has warmed up.

        Parameters
        ----------
        output_deg : Array
            (n_servos,) degrees of the horns, backlash included.
        n_moves : int
            Number of moves since the robot was cold.

        Returns
        -------
        Array
            (47, 3) mm.
        """
        # A pose takes two moves: one to its start, one to its goal.
        warmth = 1.0 - np.exp(-n_moves / (2 * _WARMING_POSES))
        return np.asarray(self.state(output_deg[None], warmth).markers_mm[0])

    def closing_force_n(self, overlap_mm: float) -> float:
        """Return the force, in N, between lips that would overlap by `overlap_mm` if free."""
        return float(self._lip_forces_n(np.full((1, N_PAIRS), -float(overlap_mm))).sum())

    def _jaw_rad(self, horns_deg: Array) -> Array:
        draw = self.draw
        if draw.jaw < 0:
            return np.zeros(len(horns_deg))
        turned_deg = draw.four_bar.jaw_deg(horns_deg[:, draw.jaw])
        return np.deg2rad(turned_deg + draw.sag_deg * np.cos(np.deg2rad(turned_deg)))

    def _free_displacements(self, horns_deg: Array, jaw_rad: Array) -> Array:
        """Return motions of dots and gaps, (n, n_outputs) mm, with lips not stopping each other.

        horns_deg: (n, n_servos); jaw_rad: (n,), the jaw's angle.
        """
        rotations = np.stack([np.cos(jaw_rad) - 1.0, np.sin(jaw_rad)], axis=1)
        outputs = rotations @ self._by_jaw_turn
        for rod, by_pull in zip(self.draw.rods, self._by_rod_pull, strict=True):
            angle = np.deg2rad(horns_deg[:, rod.joint])[:, None]
            # Motion of the horn's end; part of the jaw's turn is added where its servo rides on the
            # jaw.
            horn_mm = rod.arm_mm * (np.sin(angle) * rod.along + (1.0 - np.cos(angle)) * rod.over)
            if rod.rides:
                from_axis = rod.place_mm + horn_mm - self.draw.axis_mm
                horn_mm = horn_mm + rod.rides * _moved_by_turn(from_axis[:, None], jaw_rad)[:, 0]
            outputs = outputs + horn_mm @ by_pull.T
        return np.asarray(outputs)

    def _jaw_compliance(self) -> Array:
        """Return motions of dots and gaps as lip forces turn the jaw, (n_outputs, N_PAIRS) mm/N."""
        zero_deg = np.zeros((2, len(self.draw.signs)))
        outputs = self._free_displacements(zero_deg, np.array([0.0, 0.01]))
        per_rad = (outputs[1] - outputs[0]) / 0.01
        return np.asarray(self.draw.jaw_rad_per_nmm * np.outer(per_rad, per_rad[-N_PAIRS:]))

    def _lip_forces_n(self, free_gaps_mm: Array) -> Array:
        """Return forces (n, N_PAIRS) >= 0 such that no gap is below 0 and only lips that meet push.

        free_gaps_mm: (n, N_PAIRS), gaps of lips that do not stop each other. By active sets: pairs
        that pull are released, pairs that overlap are pushed, until neither is.
        """
        force_n = np.zeros_like(free_gaps_mm)
        rows = np.flatnonzero((free_gaps_mm < 0.0).any(axis=1))
        free_mm = free_gaps_mm[rows]
        meet = free_mm < 0.0
        for _ in range(_ACTIVE_SET_ROUNDS):
            both_meet = meet[:, :, None] & meet[:, None]
            # Linear equations of the pairs that meet; all others get force 0.
            matrix = np.where(both_meet, self._compliance, np.eye(N_PAIRS))
            force_n[rows] = np.linalg.solve(matrix, np.where(meet, -free_mm, 0.0)[..., None])[
                ..., 0
            ]
            gaps_mm = free_mm + force_n[rows] @ self._compliance
            meet_before, meet = meet, np.where(meet, force_n[rows] > 0.0, gaps_mm < 0.0)
            if (meet == meet_before).all():
                break
        return np.maximum(force_n, 0.0)


def _unit_rows(n: int, at: NDArray[np.int_]) -> Array:
    return np.asarray(np.eye(n)[at])


def _moved_by_turn(from_axis_mm: Array, angle_rad: Array) -> Array:
    """Return the displacement, (n, m, 3), of points by n turns of angle_rad about x.

    from_axis_mm: (m, 3) or (n, m, 3), the points less a point of the axis.
    """
    cos, sin = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    y, z = from_axis_mm[..., 1], from_axis_mm[..., 2]
    moved = np.stack(
        [np.zeros_like(cos * y), (cos - 1) * y - sin * z, sin * y + (cos - 1) * z], axis=-1
    )
    return np.asarray(moved)
