"""Cartoon mouth shapes from the motion itself, so that a cartoon shows what the robot's lips do."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, FaceWithAnimPhos
from lipsync.arrays import Array, in_blocks
from lipsync.export.arkit import GAP, MEASURES, LipMeasures
from lipsync.export.mouth_cues import CENTISECOND_S, MouthCue, Shape, centiseconds, merge_cues
from lipsync.motion.finishing import BILABIAL_GAP_MM
from lipsync.phonemes import stand_in

#: The phones whose recorded mouths are the drawing of a shape, as Rhubarb's README names them.
#: Not H: no marker lies on the tongue. A and X are recognised by the lip gap.
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

    measures: the distances of the face model's mouth. places: (7, n_measures), measures of A and of
    the shapes that phones draw (`_NAMES`), in standard deviations of the recorded faces.
    """

    measures: LipMeasures
    places: Array


def shape_prototypes(model: FaceWithAnimPhos, measures: LipMeasures) -> ShapePrototypes:
    """Return each shape's prototype: the median recorded mouth in the middle of its phones.

    The recorded mouths are those of the model's AnimPhos, pieces of motion of one phone each. A is
    the mouth at rest, whose lips touch. measures: must be those of `model`.
    """
    units = model.animphos
    middle = SAMPLES_PER_ANIMPHO // 2
    places = [np.zeros(len(MEASURES))]
    for phones in _DRAWN_BY.values():
        known = {p for phone in phones for p in stand_in(phone, units.known_phonemes)}
        chosen = np.concatenate([units.of_phoneme(phone) for phone in sorted(known)])
        places.append(np.median(measures.of(units.samples[chosen, middle]), axis=0))
    return ShapePrototypes(measures, np.stack(places) / _deviations_mm(measures))


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
    n_cs = centiseconds(duration_s)
    if len(coefficients) < n_cs:
        raise ValueError(f"{len(coefficients)} frames of motion; this sound needs {n_cs}")
    if n_cs == 0:
        return []
    deviations_mm = _deviations_mm(prototypes.measures)

    def costs_of(rows: slice) -> Array:
        measured = prototypes.measures.of(coefficients[:n_cs][rows]) / deviations_mm
        return np.asarray(((measured[:, None, :] - prototypes.places[None]) ** 2).sum(axis=2))

    costs = in_blocks(costs_of, n_cs)
    # Where the lips touch, any shape but A costs more than the worst likeness.
    costs[shut[:n_cs], 1:] += _CLOSURE_PRICE
    cues = merge_cues(
        MouthCue(_NAMES[shape], start, end) for shape, start, end in _stretches(costs, SHORTEST_CS)
    )
    return [replace(cue, shape="X") if _is_pause(cue, n_cs) else cue for cue in cues]


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


def _deviations_mm(measures: LipMeasures) -> Array:
    """Return the standard deviations (n_measures,) of the measures, with 1 in place of any 0."""
    scale: Array = np.where(measures.spread_mm > 0.0, measures.spread_mm, 1.0)
    return scale


def _stretches(costs: Array, shortest: int) -> Sequence[tuple[int, int, int]]:
    """Return the cheapest stretches (shape, start, end) that cover the rows of costs (n, n_shapes).

    Every stretch has at least `shortest` rows, where there are as many, and its cost is the sum of
    its shape's costs. Dynamic programming over stretches, as of a hidden semi-Markov model with a
    shortest duration.
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
        # A stretch that begins as late as it may: after the cheapest way to cover all before it.
        start = t - shortest
        new_costs = totals[-1] - totals[0]
        if start:
            before = bests[-shortest]
            cheapest = int(before.argmin())
            new_costs = new_costs + before[cheapest]
            came_from[t] = cheapest
        # Or the stretch that covers row t - 1 already goes on, if that is no dearer.
        continued_costs = bests[-1] + costs[t - 1]
        goes_on = continued_costs <= new_costs
        bests.append(np.where(goes_on, continued_costs, new_costs))
        begins[t] = np.where(goes_on, begins[t - 1], start)
        came_from[t] = np.where(goes_on, came_from[t - 1], came_from[t])
    found: list[tuple[int, int, int]] = []
    # Back from the cheapest shape at the end, stretch by stretch.
    end, shape = n, int(bests[-1].argmin())
    while end > 0:
        start = int(begins[end, shape])
        found.append((shape, start, end))
        end, shape = start, int(came_from[end, shape])
    return found[::-1]


def _is_pause(cue: MouthCue, n_cs: int) -> bool:
    """Return whether a cue A is a pause: over 0.35 s long, or at 0, or until `n_cs` cs."""
    is_long = cue.end_cs - cue.start_cs > _PAUSE_CS
    return cue.shape == "A" and (is_long or cue.start_cs == 0 or cue.end_cs == n_cs)
