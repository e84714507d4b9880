"""A small made-up speaker for tests: symmetric, exact, built in a millisecond.

The face is mirrored at x = 0. Its five components have a meaning each: opening, width, protrusion,
upper lip, lower lip. Five phonemes; every order of them without repetition has its own AnimPho.
"""

from itertools import product

import numpy as np
from lipservo_lab.baselines.baselines import Baselines, PlainRegression, fixed_reference
from lipservo_lab.learning.motion.trained_model import TrainedModel
from numpy.typing import NDArray

from lipsync.animpho.units import AnimPhoUnits, IndexLists
from lipsync.expectation.expectation import N_TIMING, constant_expectation
from lipsync.markers import MARKERS_47
from lipsync.phonemes import PHONEMES, stand_in

Array = NDArray[np.float64]

#: Landmarks in the middle of the closed mouth: x = 0; y, z in millimetres.
_MIDDLE: dict[int, tuple[float, float]] = {
    0: (-89, 19), 17: (-108, 14), 13: (-96, 12), 14: (-96, 12), 2: (-71, 21),
    152: (-140, -5), 18: (-113, 9), 200: (-121, 8), 199: (-130, 6),
}  # fmt: skip
#: (landmark on the speaker's right, its mirror image on the left): x of the left one, y, z.
SIDES: dict[tuple[int, int], tuple[float, float, float]] = {
    (61, 291): (26, -95, 0), (39, 269): (15, -90, 15), (37, 267): (8, -88, 18),
    (181, 405): (15, -105, 11), (84, 314): (8, -108, 13),
    (78, 308): (24, -95, 1), (82, 312): (6, -96, 12), (87, 317): (6, -96, 12),
    (98, 327): (18, -69, 13),
    (172, 397): (56, -102, -46), (136, 365): (49, -114, -36), (149, 378): (31, -130, -19),
    (176, 400): (23, -136, -12),
    (50, 280): (49, -55, 0), (205, 425): (41, -65, 5), (207, 427): (46, -76, -1),
    (187, 411): (54, -70, -8), (216, 436): (37, -82, 2), (212, 432): (39, -95, -4),
}  # fmt: skip

_UPPER_LIP = (39, 37, 0, 267, 269, 82, 13, 312)
_LOWER_LIP = (405, 314, 17, 84, 181, 317, 14, 87)
_CORNERS = (61, 291, 78, 308)

#: Where each phoneme goes: coefficients of opening, width, protrusion, upper lip, lower lip.
_TARGETS: dict[str, tuple[float, float, float, float, float]] = {
    "SIL": (-18.0, 0.0, 0.0, 0.0, 0.0),
    "M": (-18.0, 0.0, 1.0, 0.0, 0.0),
    "AA": (30.0, 1.0, 0.0, 2.0, 2.0),
    "IY": (0.0, 6.0, -3.0, 2.0, 4.0),
    "UW": (-5.0, -6.0, 6.0, 0.0, 0.0),
}


def small_model() -> TrainedModel:
    """47 markers, 5 components, 80 AnimPhos, 4 successors each.

    `rest` is the target of SIL: a closed mouth, 18 below the mean on the opening component.
    """
    neutral_mm = _neutral_mm()
    basis = _basis(neutral_mm)
    rest = np.array(_TARGETS["SIL"])
    centres = np.array([_TARGETS[stand_in(p, frozenset(_TARGETS))[0]] for p in PHONEMES])
    contexts = [c for c in product(_TARGETS, repeat=3) if c[0] != c[1] != c[2]]
    follows = [(i, j) for i, a in enumerate(contexts) for j, b in enumerate(contexts)
               if a[1:] == b[:2]]  # fmt: skip
    rows, columns = np.array(follows).T
    successors = IndexLists.from_pairs(rows, columns, len(contexts))
    phonemes = np.array([PHONEMES.index(phoneme) for _, phoneme, _ in contexts])
    return TrainedModel(
        layout=MARKERS_47,
        mean_mm=neutral_mm - (rest @ basis).reshape(-1, 3),
        basis=basis,
        head_reference_mm=np.array(
            [[-45.0, 0, 0], [45.0, 0, 0], [0, 30.0, 15.0], [0, -20.0, 25.0]]
        ),
        rest=rest,
        covariance=np.diag([100.0, 4.0, 4.0, 1.0, 4.0]),
        labiodental_gap_mm=1.5,
        tightest_s=np.zeros(len(PHONEMES)),
        animphos=AnimPhoUnits(
            rest=rest,
            samples=np.array([_animpho(*context) for context in contexts]),
            successors=successors,
            predecessors=successors.transposed(len(contexts)),
            phoneme_table=IndexLists.from_pairs(phonemes, np.arange(len(contexts)), len(PHONEMES)),
        ),
        expectation=constant_expectation(centres),
        baselines=Baselines(
            centres=centres,
            counts=np.array([16.0 * (p in _TARGETS) for p in PHONEMES]),
            dominance=fixed_reference(),
            regression=PlainRegression(np.zeros((5 * (len(PHONEMES) + 1) + N_TIMING + 1, 5))),
        ),
        training_sentences=("made_up",),
        provenance={"corpus": "small_model", "seed": 0, "frames": 0},
    )


def _neutral_mm() -> Array:
    """(47, 3): the closed mouth."""
    points = {n: (0.0, y, z) for n, (y, z) in _MIDDLE.items()}
    for (right, left), (x, y, z) in SIDES.items():
        points[left], points[right] = (x, y, z), (-x, y, z)
    return np.array([points[n] for n in MARKERS_47.landmarks], dtype=np.float64)


def _basis(neutral_mm: Array) -> Array:
    """(5, 141), orthonormal: the five movements by Gram-Schmidt, in their order and direction."""
    upper, lower, corners = (
        np.isin(MARKERS_47.landmarks, s) for s in (_UPPER_LIP, _LOWER_LIP, _CORNERS)
    )
    jaw = np.array([name.startswith(("jaw", "chin")) for name in MARKERS_47.names])
    moves = np.zeros((5, *neutral_mm.shape))
    moves[0, lower] = moves[0, jaw] = (0.0, -1.0, -0.7)
    moves[0, corners] = (0.0, -0.4, -0.3)
    moves[1, corners, 0] = np.sign(neutral_mm[corners, 0])
    moves[2, upper | lower, 2] = 1.0
    moves[3, upper, 1] = 1.0
    moves[4, lower, 1] = -1.0
    q, r = np.linalg.qr(moves.reshape(5, -1).T)
    return np.asarray((q * np.sign(np.diag(r))).T)


def _animpho(before: str, phoneme: str, after: str) -> Array:
    """(5, 5): from half-way out of `before`, through the target, to half-way into `after`."""
    start, target, end = (np.array(_TARGETS[p]) for p in (before, phoneme, after))
    first, last = (start + target) / 2, (target + end) / 2
    return np.array([first, (first + 3 * target) / 4, target, (3 * target + last) / 4, last])
