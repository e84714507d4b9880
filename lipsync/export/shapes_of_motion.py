"""Cartoon mouth shapes from the motion itself, so that a cartoon shows what the robot's lips do."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, FaceWithAnimPhos
from lipsync.arrays import Array, in_blocks
from lipsync.export.arkit import GAP, MEASURES, LipMeasures
from lipsync.export.mouth_cues import CENTISECOND_S, MouthCue, Shape, centiseconds, joined
from lipsync.motion.finishing import BILABIAL_GAP_MM
from lipsync.phonemes import stand_in

#: The phones whose recorded mouths are the drawing of a shape, as Rhubarb's README names them.
#: Not H: no marker lies on the tongue. A and X are told by the gap.
_DRAWN_BY: Mapping[Shape, tuple[str, ...]] = {
    "B": ("K", "S", "T", "IY"),
    "C": ("EH", "AE"),
    "D": ("AA",),
    "E": ("AO", "ER"),
    "F": ("UW", "OW", "W"),
    "G": ("F", "V"),
}
_NAMES: tuple[Shape, ...] = ("A", *_DRAWN_BY)
#: Two frames of cartoons at 25 a second: nothing is shown for less.
SHORTEST_CS = 8
#: Lips that touch are drawn touching, at the price of any other shape: more than 0.08 s of the
#: worst likeness, in squared standard deviations.
_CLOSURE_PRICE = 1e3
#: As in Rhubarb's rules, a pause longer than this shows the mouth at rest.
_PAUSE_CS = 35


@dataclass(frozen=True, slots=True)
class ShapePrototypes:
    """Recorded mouths, one for each shape, with which a mouth is compared.

    measures: of the face model. places: (7, n_measures), measures of A and of the shapes that
    phones draw, in standard deviations of the recorded faces.
    """

    measures: LipMeasures
    places: Array


def shape_prototypes(model: FaceWithAnimPhos, measures: LipMeasures) -> ShapePrototypes:
    """Return each shape's prototype: the median recorded mouth in the middle of its phones.

    A is the mouth at rest, whose lips touch. measures: must be those of `model`.
    """
    units = model.animphos
    middle = SAMPLES_PER_ANIMPHO // 2
    places = [np.zeros(len(MEASURES))]
    for phones in _DRAWN_BY.values():
        known = {p for phone in phones for p in stand_in(phone, units.known_phonemes)}
        chosen = np.concatenate([units.of_phoneme(phone) for phone in sorted(known)])
        places.append(np.median(measures.of(units.samples[chosen, middle]), axis=0))
    return ShapePrototypes(measures, np.stack(places) / _scale(measures))


def motion_cues(
    prototypes: ShapePrototypes, coefficients: Array, shut: NDArray[np.bool_], duration_s: float
) -> list[MouthCue]:
    """Return the sequence of mouth shapes nearest to a motion, none shorter than 80 ms.

    A sound shorter than that gets one shape.

    Parameters
    ----------
    prototypes : ShapePrototypes
        A mouth for each shape.
    coefficients : Array
        (n, n_components), every 10 ms from 0 s on.
    shut : NDArray[np.bool_]
        (n,), where the lips touch (`lips_shut`): drawn as A, as X in pauses.
    duration_s : float
        Length of the sound.

    Returns
    -------
    list[MouthCue]
        Cues without gaps from 0 s to the end.

    Raises
    ------
    ValueError
        The motion is shorter than the sound.
    """
    n = centiseconds(duration_s)
    if len(coefficients) < n:
        raise ValueError(f"{len(coefficients)} frames of motion; this sound needs {n}")
    if n == 0:
        return []
    scale = _scale(prototypes.measures)

    def costs_of(some: slice) -> Array:
        at = prototypes.measures.of(coefficients[:n][some]) / scale
        return np.asarray(((at[:, None, :] - prototypes.places[None]) ** 2).sum(axis=2))

    costs = in_blocks(costs_of, n)
    costs[shut[:n], 1:] += _CLOSURE_PRICE
    cues = joined(
        MouthCue(_NAMES[shape], start, end) for shape, start, end in _segments(costs, SHORTEST_CS)
    )
    return [replace(cue, shape="X") if _is_pause(cue, n) else cue for cue in cues]


def lips_shut(measures: LipMeasures, coefficients: Array) -> NDArray[np.bool_]:
    """Return whether the lips touch in each face.

    Parameters
    ----------
    measures : LipMeasures
        Measures of the face model.
    coefficients : Array
        (n, n_components) face coefficients.

    Returns
    -------
    NDArray[np.bool_]
        (n,), True where the lip gap is at most 0.7 mm, `BILABIAL_GAP_MM`.
    """
    gap_mm = measures.of(coefficients)[:, MEASURES.index(GAP)] + measures.rest_gap_mm
    return np.asarray(gap_mm <= BILABIAL_GAP_MM)


def sampling_times_s(duration_s: float) -> Array:
    """Return the times at which `motion_cues` needs its motion, every 10 ms.

    Parameters
    ----------
    duration_s : float
        Length of the sound.

    Returns
    -------
    Array
        (n,) s from 0 on.
    """
    return np.asarray(np.arange(centiseconds(duration_s)) * CENTISECOND_S, dtype=np.float64)


def _scale(measures: LipMeasures) -> Array:
    """Return the standard deviations (n_measures,) of the measures, with 1 in place of any 0."""
    scale: Array = np.where(measures.spread_mm > 0.0, measures.spread_mm, 1.0)
    return scale


def _segments(costs: Array, shortest: int) -> Sequence[tuple[int, int, int]]:
    """Return the cheapest stretches (shape, start, end) that cover the rows of costs (n, n_shapes).

    Every stretch has at least `shortest` rows, where there are as many. Dynamic programming over
    stretches, as of a hidden semi-Markov model with a shortest duration.
    """
    n, n_shapes = costs.shape
    shortest = min(shortest, n)
    # Of the last rows: the sum of all costs before row t; and the cost of rows before t when the
    # last stretch is a shape and as long as it must be.
    totals = deque([np.zeros(n_shapes)], shortest + 1)
    bests = deque([np.full(n_shapes, np.inf)], shortest + 1)
    begins = np.zeros((n + 1, n_shapes), dtype=np.int32)
    came_from = np.full((n + 1, n_shapes), -1, dtype=np.int8)
    for t in range(1, n + 1):
        totals.append(totals[-1] + costs[t - 1])
        if t < shortest:
            bests.append(bests[-1])
            continue
        start = t - shortest
        new = totals[-1] - totals[0]
        if start:
            before = bests[-shortest]
            cheapest = int(before.argmin())
            new = new + before[cheapest]
            came_from[t] = cheapest
        longer = bests[-1] + costs[t - 1]
        goes_on = longer <= new
        bests.append(np.where(goes_on, longer, new))
        begins[t] = np.where(goes_on, begins[t - 1], start)
        came_from[t] = np.where(goes_on, came_from[t - 1], came_from[t])
    found: list[tuple[int, int, int]] = []
    end, shape = n, int(bests[-1].argmin())
    while end > 0:
        start = int(begins[end, shape])
        found.append((shape, start, end))
        end, shape = start, int(came_from[end, shape])
    return found[::-1]


def _is_pause(cue: MouthCue, n: int) -> bool:
    """Return whether a cue A is a pause: over 0.35 s long, or at 0, or until `n` centiseconds."""
    is_long = cue.end_cs - cue.start_cs > _PAUSE_CS
    return cue.shape == "A" and (is_long or cue.start_cs == 0 or cue.end_cs == n)
