"""Robots that our fits know nothing of: an elastic skin, lips that stop each other, a linked jaw.

The second family of simulated robots, made from physics: horns that turn pull the skin by rods
that give way, the jaw hangs on a four-bar linkage and sags, lips meet without friction
(complementarity of gap and force, Cottle, Pang and Stone, 1992, solved by projected
Gauss-Seidel), the left side is weak, dots lie beside the lips' edges, zeros drift as the
servos warm up, gears have play.
Not simulated: friction, creep of the skin, loads that move a servo's encoder.
Loads SciPy; the live path never does.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.simulated.elastic_skin import N_PAIRS, ElasticSkin
from calibration.simulated.four_bar import FourBar
from lipsync.arrays import Array

SENSOR_NOISE_MM = 0.5
#: Lips are soft themselves: a pair gives way by so much.
_LIP_MM_PER_N = 0.1
_SWEEPS = 120
#: Moves after which two thirds of the warming is done.
_WARMING_MOVES = 30.0


@dataclass(frozen=True, slots=True)
class Rod:
    """What one horn does to the skin: it turns from `along` towards `over`, and holds at a patch.

    along, over: (3,), unit vectors; rides: how much of the jaw's turn its servo follows.
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
    """A robot. signs, zero_deg, play_deg, drift_deg: (n_servos,). jaw: its joint, or -1.

    signs: -1 for a servo that turns its horn the other way; zero and drift are the horn's own.

    jaw_rad_per_nmm: how far the jaw gives way to a newton-millimetre; sag_deg: how far it hangs.
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
    """What the bench knows. gaps_mm: (n, N_PAIRS), of the lips' own edges; force_n: (n,)."""

    markers_mm: Array
    gaps_mm: Array
    force_n: Array


class ElasticFace:
    """A drawn robot with its skin solved: markers, lips and forces by the angles of its horns."""

    def __init__(self, draw: ElasticDraw) -> None:
        self.draw = draw
        skin = draw.skin
        n = len(skin.places_mm)
        stiffness = skin.stiffness.copy()
        for rod in draw.rods:
            held = rod.n_per_mm * np.outer(rod.patch, rod.patch)
            for k in range(3):
                stiffness[k * n : (k + 1) * n, k * n : (k + 1) * n] += held
        inverse = np.linalg.inv(stiffness)
        upper, lower = np.arange(N_PAIRS) + n, np.arange(N_PAIRS, 2 * N_PAIRS) + n
        pushes = inverse[:, upper] - inverse[:, lower]
        seen = np.kron(np.eye(3), skin.dots)
        self._seen = np.concatenate([seen, _rows(3 * n, upper) - _rows(3 * n, lower)])
        self._rod_answers = [
            self._seen @ (inverse @ np.kron(np.eye(3), (rod.n_per_mm * rod.patch)[:, None]))
            for rod in draw.rods
        ]
        self._foam_answer = self._seen @ (inverse * np.tile(skin.foam, 3))
        self._gap_mm = skin.places_mm[:N_PAIRS, 1] - skin.places_mm[N_PAIRS : 2 * N_PAIRS, 1]
        self._push_answer = self._seen @ pushes + self._jaw_yields()
        self._compliance = self._push_answer[-N_PAIRS:] + _LIP_MM_PER_N * np.eye(N_PAIRS)

    def state(self, output_deg: Array, warmth: float = 1.0) -> LipState:
        """(n, n_servos), behind the play -> markers (n, 47, 3), gaps and closing force."""
        draw = self.draw
        horns_deg = draw.signs * output_deg + draw.zero_deg + warmth * draw.drift_deg
        values = self._free(horns_deg, self._jaw_rad(horns_deg))
        free_gaps_mm = self._gap_mm + values[:, -N_PAIRS:]
        force_n = self._lip_forces_n(free_gaps_mm)
        values = values + force_n @ self._push_answer.T
        moved = values[:, :-N_PAIRS].reshape(len(values), 3, -1).transpose(0, 2, 1)
        gaps_mm = free_gaps_mm + force_n @ (self._compliance - _LIP_MM_PER_N * np.eye(N_PAIRS)).T
        return LipState(draw.skin.dots_mm + moved, np.maximum(gaps_mm, 0.0), force_n.sum(axis=1))

    def markers_mm(self, output_deg: Array) -> Array:
        """(n, n_servos) -> (n, 47, 3), warm."""
        return self.state(output_deg).markers_mm

    def closing_force_n(self, overlap_mm: float) -> float:
        """What presses lips together that would overlap by so much all along, if they could."""
        return float(self._lip_forces_n(np.full((1, N_PAIRS), -float(overlap_mm))).sum())

    def _jaw_rad(self, horns_deg: Array) -> Array:
        draw = self.draw
        if draw.jaw < 0:
            return np.zeros(len(horns_deg))
        turned_deg = draw.four_bar.jaw_deg(horns_deg[:, draw.jaw])
        return np.deg2rad(turned_deg + draw.sag_deg * np.cos(np.deg2rad(turned_deg)))

    def _free(self, horns_deg: Array, jaw_rad: Array) -> Array:
        """(n, n_seen): dots and gaps, the lips not stopping each other."""
        skin = self.draw.skin
        carried = _turned(skin.places_mm - self.draw.axis_mm, jaw_rad) * skin.jaw_share[:, None]
        flat = carried.transpose(0, 2, 1).reshape(len(jaw_rad), -1)
        values = flat @ self._foam_answer.T
        for rod, answer in zip(self.draw.rods, self._rod_answers, strict=True):
            angle = np.deg2rad(horns_deg[:, rod.joint])[:, None]
            pulled = rod.arm_mm * (np.sin(angle) * rod.along + (1.0 - np.cos(angle)) * rod.over)
            if rod.rides:
                from_axis = rod.place_mm + pulled - self.draw.axis_mm
                pulled = pulled + rod.rides * _turned(from_axis[:, None], jaw_rad)[:, 0]
            values = values + pulled @ answer.T
        return np.asarray(values)

    def _jaw_yields(self) -> Array:
        """(n_seen, N_PAIRS): lips that are pushed push the jaw open, and all that hangs on it."""
        rest = np.zeros((2, len(self.draw.signs)))
        seen = self._free(rest, np.array([0.0, 0.01]))
        by_rad = (seen[1] - seen[0]) / 0.01
        return np.asarray(self.draw.jaw_rad_per_nmm * np.outer(by_rad, by_rad[-N_PAIRS:]))

    def _lip_forces_n(self, free_gaps_mm: Array) -> Array:
        """(n, N_PAIRS) >= 0, such that no gap is below 0 and only lips that meet push."""
        force_n = np.zeros_like(free_gaps_mm)
        gaps_mm = free_gaps_mm.copy()
        meet = np.flatnonzero((free_gaps_mm < 0.0).any(axis=1))
        force, gaps = force_n[meet], gaps_mm[meet]
        for _ in range(_SWEEPS):
            for i in range(N_PAIRS):
                new = np.maximum(0.0, force[:, i] - gaps[:, i] / self._compliance[i, i])
                gaps += (new - force[:, i])[:, None] * self._compliance[i]
                force[:, i] = new
        force_n[meet] = force
        return force_n


class ElasticRobot:
    """Servos with play behind the skin, and a noisy tracker before it: move and measure."""

    def __init__(
        self, face: ElasticFace, *, noise_seed: int = 0, noise_mm: float = SENSOR_NOISE_MM
    ) -> None:
        """Cold, all servos at 0, in the middle of their play."""
        self._face = face
        self._noise = np.random.default_rng([noise_seed, 7])
        self._noise_mm = noise_mm
        self._output_deg = np.zeros(len(face.draw.signs))
        self._moves = 0

    def move(self, positions_deg: Array) -> Array:
        """Go there and settle; the encoders then, (n_servos,)."""
        half_deg = self._face.draw.play_deg / 2
        self._output_deg = np.clip(
            self._output_deg, positions_deg - half_deg, positions_deg + half_deg
        )
        self._moves += 1
        return np.asarray(positions_deg, dtype=np.float64).copy()

    @property
    def output_deg(self) -> Array:
        """(n_servos,): where the horns stand, for the bench."""
        return self._output_deg.copy()

    def measure(self) -> Array:
        """(47, 3): one look of the tracker."""
        warmth = 1.0 - np.exp(-self._moves / (2 * _WARMING_MOVES))
        exact_mm = self._face.state(self._output_deg[None], warmth).markers_mm[0]
        return np.asarray(exact_mm + self._noise.normal(0.0, self._noise_mm, exact_mm.shape))


def _rows(n: int, at: NDArray[np.int_]) -> Array:
    return np.asarray(np.eye(n)[at])


def _turned(from_axis_mm: Array, angle_rad: Array) -> Array:
    """(m, 3) or (n, m, 3) about x by (n,) -> (n, m, 3), how far each point goes."""
    cos, sin = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    y, z = from_axis_mm[..., 1], from_axis_mm[..., 2]
    moved = np.stack(
        [np.zeros_like(cos * y), (cos - 1) * y - sin * z, sin * y + (cos - 1) * z], axis=-1
    )
    return np.asarray(moved)
