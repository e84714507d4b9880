"""How far synthesised motion is from the recorded one: sums of one sentence, figures of many.

Definitions: docs/motion.md. A sentence yields sums, so that figures of any set of sentences, and of
any bootstrap sample of them, are cheap.

`lip_shapes_mm`: what everybody sees of lips, and a robot can show: how far apart, how wide, how far
forward.

`lip_speed`: how fast lips move from one tick of 10 ms to the next, to find jumps that 25 frames a
second hide. Of recorded lips (grid_s1, 25 Hz) 99 % of frames are below 200 mm/s and none is above
310.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.utterance import Utterance
from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.markers import CLOSED_GAP_MM
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import SILENCE, PhonemeEvent

#: Columns of `lip_shapes_mm`.
LIP_SHAPE = ("gap", "width", "protrusion")


def lip_shapes_mm(face: FaceModel, markers_mm: NDArray[np.floating]) -> Array:
    """Return gap, width and protrusion of the lips, in the order of LIP_SHAPE.

    gap: as `FaceModel.lip_gaps_mm`. width: from the outermost point of the lips on the one side to
    that on the other, sideways; NaN for a layout without points of the lips. protrusion: how far
    forward, in the head's pose, the middle of the two points of the lip gap stands.

    Parameters
    ----------
    face : FaceModel
        The face, with its layout of points.
    markers_mm : NDArray[np.floating]
        (n_frames, n_points, 3).

    Returns
    -------
    Array
        (n_frames, 3) mm.
    """
    layout = face.layout
    gap_mm = face.lip_gaps_mm(markers_mm)
    middle_mm = (markers_mm[:, layout.upper_lip] + markers_mm[:, layout.lower_lip]) / 2.0
    if layout.lips:
        width_mm = np.ptp(markers_mm[:, list(layout.lips), 0], axis=1)
    else:
        width_mm = np.full(len(gap_mm), np.nan)
    return np.stack([gap_mm, width_mm, middle_mm[:, 2]], axis=1).astype(np.float64)


Mask = NDArray[np.bool_]

#: Largest lip gap of a closed F or V: 95 % of the recorded ones reach it (measured on grid_s1).
LABIODENTAL_GAP_MM = 4.6
#: A closure counts when it comes at most this long before or after the phone.
_CLOSURE_WINDOW_S = 0.04
_BILABIALS = ("P", "B", "M")
#: The phones for which the mouth closes: lips, or lower lip and teeth.
CLOSING = (*_BILABIALS, "F", "V")
#: A closed mouth farther than this from any P, B, M and silence is a false closure.
_FALSE_WINDOW_S = 0.08
_ROUNDING_S = 1e-9
#: The finer components, 5 to 8: a mean over contexts loses these first.
_FINE = slice(4, 8)
_FINE_NUMBERS = range(_FINE.start + 1, _FINE.stop + 1)

#: Names of a sentence's sums, in their order. free: errors less the sentence's mean error. fine: of
#: each of the finer components its sum and sum of squares, synthesised (made) and recorded.
SUMS = (
    "frames", "squared_mm2", "squared_lips_mm2", "reference_mm2",
    "gap", "gap_recorded", "gap2", "gap_recorded2", "gap_product",
    "closures", "closure_hits", "labiodentals", "labiodental_hits",
    "open_frames", "false_closures", "recorded_false_closures",
    "acceleration2", "recorded_acceleration2",
    "free_mm2", "free_lips_mm2",
    *(f"{name}_error_mm2" for name in LIP_SHAPE[1:]),
    *(f"{name}_free_mm2" for name in LIP_SHAPE),
    *(f"fine_{whose}{power}_{n}" for whose in ("made", "recorded") for power in ("", "2")
      for n in _FINE_NUMBERS),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Motion:
    """A mouth in motion: markers_mm (n, n_points, 3) and face coefficients (n, n_components)."""

    markers_mm: NDArray[np.floating]
    coefficients: Array


def sentence_sums(
    face: FaceModel,
    utterance: Utterance,
    scored: Mask,
    recorded: Motion,
    made: Motion,
    reference: Motion,
) -> Array:
    """Return the sums named in SUMS for one sentence.

    Parameters
    ----------
    face : FaceModel
        The face of all three motions.
    utterance : Utterance
        The sentence.
    scored : Mask
        (n,), whether a frame counts.
    recorded, made, reference : Motion
        n frames each: as recorded, of the method that is scored, of the reference method.

    Returns
    -------
    Array
        (len(SUMS),).
    """
    lips = list(face.layout.lips)
    # Names with 2 are squared distances in mm2. is_far: frames far from any closure.
    n_points, n_lips = face.layout.n_points, len(lips)
    error_mm = (made.markers_mm - recorded.markers_mm)[scored].astype(np.float64)
    error2 = (error_mm**2).sum(axis=2)
    free2 = (_without_mean(error_mm) ** 2).sum(axis=2)
    shape_mm = lip_shapes_mm(face, made.markers_mm) - lip_shapes_mm(face, recorded.markers_mm)
    shape_mm = shape_mm[scored]
    reference_error = ((reference.markers_mm - recorded.markers_mm)[scored] ** 2).sum()
    gap, gap_recorded = face.lip_gaps_mm(made.markers_mm), face.lip_gaps_mm(recorded.markers_mm)
    g, r = gap[scored], gap_recorded[scored]
    times_s = np.arange(len(gap)) / utterance.frame_rate_hz
    is_far = _far_from_closure(utterance, times_s)
    lip_error = error2[:, lips].sum() / n_lips
    return np.array(
        [
            scored.sum(), error2.sum() / n_points, lip_error, reference_error / n_points,
            g.sum(), r.sum(), (g * g).sum(), (r * r).sum(), (g * r).sum(),
            *_closure_hits(utterance, times_s, scored, gap),
            is_far.sum(),
            (is_far & (gap <= CLOSED_GAP_MM)).sum(),
            (is_far & (gap_recorded <= CLOSED_GAP_MM)).sum(),
            _acceleration2(made.coefficients, scored),
            _acceleration2(recorded.coefficients, scored),
            free2.sum() / n_points, free2[:, lips].sum() / n_lips,
            *(shape_mm[:, 1:] ** 2).sum(axis=0),
            *(_without_mean(shape_mm) ** 2).sum(axis=0),
            *_fine_sums(made.coefficients[scored]), *_fine_sums(recorded.coefficients[scored]),
        ],
        dtype=np.float64,
    )  # fmt: skip


def _closure_hits(
    utterance: Utterance, times_s: Array, scored: Mask, gap_mm: Array
) -> tuple[int, int, int, int]:
    """Return how many P B M there are and how many of them close, then the same for F V.

    Only phones with a scored frame count. gap_mm: (n,), the lip gap at times_s (n,).
    """
    counts = [0, 0, 0, 0]
    for phone in utterance.phones:
        is_lips = is_bilabial(phone.phoneme)
        if phone.end_s is None or phone.phoneme not in CLOSING:
            continue
        if not scored[(times_s >= phone.start_s) & (times_s < phone.end_s)].any():
            continue
        counts[0 if is_lips else 2] += 1
        counts[1 if is_lips else 3] += closes(phone, times_s, gap_mm)
    return counts[0], counts[1], counts[2], counts[3]


def is_bilabial(phoneme: str) -> bool:
    """Return whether the lips must touch for a phoneme: P, B, M."""
    return phoneme in _BILABIALS


def closes(phone: PhonemeEvent, times_s: Array, gap_mm: Array) -> bool:
    """Return whether the lips close for a phone of `CLOSING`, at most 40 ms before or after it.

    Parameters
    ----------
    phone : PhonemeEvent
        The phone.
    times_s, gap_mm : Array
        (n,): times, and the lip gap at each.

    Returns
    -------
    bool
        Whether the smallest gap in that window is within the phone's limit.
    """
    end_s = phone.start_s if phone.end_s is None else phone.end_s
    window = times_s >= phone.start_s - _CLOSURE_WINDOW_S - _ROUNDING_S
    window &= times_s <= end_s + _CLOSURE_WINDOW_S + _ROUNDING_S
    limit_mm = CLOSED_GAP_MM if is_bilabial(phone.phoneme) else LABIODENTAL_GAP_MM
    return bool(window.any() and gap_mm[window].min() <= limit_mm)


def _far_from_closure(utterance: Utterance, times_s: Array) -> Mask:
    """Return which frames are farther than `_FALSE_WINDOW_S` from any P, B, M or silence, (n,).

    False after the last label.
    """
    is_far = np.ones(len(times_s), dtype=bool)
    for phone in utterance.phones:
        if phone.phoneme in (*_BILABIALS, SILENCE) and phone.end_s is not None:
            after_start = times_s >= phone.start_s - _FALSE_WINDOW_S
            is_far &= ~(after_start & (times_s <= phone.end_s + _FALSE_WINDOW_S))
    labelled_until_s = max((p.end_s or 0.0 for p in utterance.phones), default=0.0)
    return is_far & (times_s < labelled_until_s)


def _acceleration2(coefficients: Array, scored: Mask) -> float:
    """Return squared second differences, summed over runs of three scored frames.

    coefficients: (n, n_components); scored: (n,).
    """
    second = coefficients[2:] - 2.0 * coefficients[1:-1] + coefficients[:-2]
    return float((second[scored[2:] & scored[1:-1] & scored[:-2]] ** 2).sum())


def _without_mean(values: Array) -> Array:
    """Return values, (n, ...), less their mean over n."""
    return np.asarray(values - values.mean(axis=0)) if len(values) else values


def _fine_sums(coefficients: Array) -> Array:
    """Return sums of the finer components, then sums of their squares, (8,).

    coefficients: (n, n_components). 0 for components that the model does not have.
    """
    fine = coefficients[:, _FINE]
    sums = np.zeros((2, len(_FINE_NUMBERS)))
    sums[0, : fine.shape[1]] = fine.sum(axis=0)
    sums[1, : fine.shape[1]] = (fine**2).sum(axis=0)
    return sums.ravel()


def figures(sums: Array) -> dict[str, float]:
    """Return the figures of many sentences from the total of their sums.

    Parameters
    ----------
    sums : Array
        (len(SUMS),), in the order of SUMS.

    Returns
    -------
    dict[str, float]
        By name (docs/motion.md); those in `_mm` in mm, the others shares, ratios and a correlation;
        NaN where there is nothing to divide by.
    """
    s = dict(zip(SUMS, (float(x) for x in sums), strict=True))
    n = s["frames"]
    covariance = n * s["gap_product"] - s["gap"] * s["gap_recorded"]
    variance = n * s["gap2"] - s["gap"] ** 2
    recorded_variance = n * s["gap_recorded2"] - s["gap_recorded"] ** 2
    product = max(variance, 0.0) * max(recorded_variance, 0.0)
    # A gap that does not move has no correlation; below this its variance is only rounding.
    correlated = product > 1e-12 * max(1.0, s["gap2"] * n) ** 2
    gap_squares = s["gap2"] - 2.0 * s["gap_product"] + s["gap_recorded2"]
    return {
        "rmse_mm": _root_of(s["squared_mm2"], n),
        "rmse_lips_mm": _root_of(s["squared_lips_mm2"], n),
        "ratio": _root_of(s["squared_mm2"], s["reference_mm2"]),
        "gap_r": covariance / product**0.5 if correlated else 0.0,
        "gap_rmse_mm": _root_of(max(gap_squares, 0.0), n),
        "closure_hits": _share(s["closure_hits"], s["closures"]),
        "labiodental_hits": _share(s["labiodental_hits"], s["labiodentals"]),
        "false_closures": _share(s["false_closures"], s["open_frames"]),
        "false_closures_ratio": _share(s["false_closures"], s["recorded_false_closures"]),
        "acceleration_ratio": _root_of(s["acceleration2"], s["recorded_acceleration2"]),
        "rmse_free_mm": _root_of(s["free_mm2"], n),
        "rmse_lips_free_mm": _root_of(s["free_lips_mm2"], n),
        "gap_free_rmse_mm": _root_of(s["gap_free_mm2"], n),
        "width_rmse_mm": _root_of(s["width_error_mm2"], n),
        "width_free_rmse_mm": _root_of(s["width_free_mm2"], n),
        "protrusion_rmse_mm": _root_of(s["protrusion_error_mm2"], n),
        "protrusion_free_rmse_mm": _root_of(s["protrusion_free_mm2"], n),
        "fine_deviation": _root_of(_fine_variance(s, "made"), _fine_variance(s, "recorded")),
    }


def _fine_variance(s: dict[str, float], whose: str) -> float:
    """Return the summed variances of the finer components, times the squared number of frames.

    s: sums by name. whose: "made" or "recorded".
    """
    squares = [s[f"fine_{whose}2_{n}"] * s["frames"] for n in _FINE_NUMBERS]
    return max(0.0, sum(squares) - sum(s[f"fine_{whose}_{n}"] ** 2 for n in _FINE_NUMBERS))


def confidence_intervals(
    sums: Array, names: Sequence[str], *, seed: int = 0, n_samples: int = 1000
) -> dict[str, tuple[float, float]]:
    """Return 95 % intervals of figures, by percentile bootstrap over sentences (Efron 1979).

    Parameters
    ----------
    sums : Array
        (n_sentences, len(SUMS)), sums of each sentence.
    names : Sequence[str]
        Names of figures.
    seed : int
        Of the bootstrap samples.
    n_samples : int
        Number of bootstrap samples.

    Returns
    -------
    dict[str, tuple[float, float]]
        Lower and upper end by name; NaN for a figure that is NaN in all samples.
    """
    samples = _bootstrap(sums, seed, n_samples)
    return {name: _interval(np.array([sample[name] for sample in samples])) for name in names}


def paired_differences(
    ours: Array, theirs: Array, names: Sequence[str]
) -> dict[str, tuple[float, tuple[float, float]]]:
    """Return how much larger figures of one method are than another's, with 95 % intervals.

    Both are computed on the same bootstrap samples of sentences.

    Parameters
    ----------
    ours, theirs : Array
        (n_sentences, len(SUMS)), the same sentences in the same order.
    names : Sequence[str]
        Names of figures.

    Returns
    -------
    dict[str, tuple[float, tuple[float, float]]]
        Difference, ours less theirs, and the ends of its interval, by name.
    """
    mine, other = figures(ours.sum(axis=0)), figures(theirs.sum(axis=0))
    pairs = list(zip(_bootstrap(ours), _bootstrap(theirs), strict=True))
    return {
        name: (mine[name] - other[name], _interval(np.array([a[name] - b[name] for a, b in pairs])))
        for name in names
    }


def _bootstrap(sums: Array, seed: int = 0, n_samples: int = 1000) -> list[dict[str, float]]:
    """Return the figures of bootstrap samples of sentences.

    sums: (n_sentences, len(SUMS)). The same number of sentences and seed give the same samples.
    """
    rng = np.random.default_rng(seed)
    draws = rng.multinomial(len(sums), np.full(len(sums), 1.0 / len(sums)), size=n_samples)
    return [figures(total) for total in draws @ sums]


def _interval(values: Array) -> tuple[float, float]:
    """Return the 2.5 and 97.5 percentiles of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, [2.5, 97.5]) if len(finite) else (np.nan, np.nan)
    return float(low), float(high)


def _share(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")


def _root_of(part: float, whole: float) -> float:
    return float((part / whole) ** 0.5) if whole else float("nan")


#: Speed above which a step counts as a jump; no recorded lip moves so fast.
STEP_MM_S = 400.0


@dataclass(frozen=True, slots=True)
class LipSpeed:
    """Speed of the lips in one piece of motion.

    fastest_mm_s: of any lip point. n_steps: ticks in which a lip point is faster than STEP_MM_S.
    n_gap_steps: ticks in which the lip gap changes faster; widest_gap_step_mm: its largest change
    in one tick. spoken_s: seconds of speech.
    """

    fastest_mm_s: float
    n_steps: int
    widest_gap_step_mm: float
    n_gap_steps: int
    spoken_s: float


def lip_speed(model: FaceModel, faces: Array, spoken_s: float) -> LipSpeed:
    """Return the speed of the fastest lip point, and the number of jumps.

    Parameters
    ----------
    model : FaceModel
        The face.
    faces : Array
        Face coefficients (n, n_components), one a tick of 10 ms.
    spoken_s : float
        Seconds of speech, to which the number of jumps is related.

    Returns
    -------
    LipSpeed
        mm/s, and steps in mm.
    """
    markers_mm = model.markers_mm(faces)
    lips_mm = markers_mm[:, list(model.layout.lips)]
    fastest = np.linalg.norm(np.diff(lips_mm, axis=0), axis=2).max(axis=1, initial=0.0) / TICK_S
    gap_steps_mm = np.abs(np.diff(model.lip_gaps_mm(markers_mm)))
    return LipSpeed(
        float(fastest.max(initial=0.0)),
        int(np.count_nonzero(fastest > STEP_MM_S)),
        float(gap_steps_mm.max(initial=0.0)),
        int(np.count_nonzero(gap_steps_mm > STEP_MM_S * TICK_S)),
        spoken_s,
    )


def lip_speed_figures(speeds: Iterable[LipSpeed]) -> dict[str, float | None]:
    """Return lip speed figures of many pieces together; rates are None without speech."""
    found = list(speeds)
    spoken_s = sum(s.spoken_s for s in found)
    n_steps, n_gap_steps = sum(s.n_steps for s in found), sum(s.n_gap_steps for s in found)
    return {
        "fastest_lip_mm_s": max((s.fastest_mm_s for s in found), default=0.0),
        "fast_steps_per_s": n_steps / spoken_s if spoken_s else None,
        "widest_gap_step_mm": max((s.widest_gap_step_mm for s in found), default=0.0),
        "gap_steps_per_s": n_gap_steps / spoken_s if spoken_s else None,
        "spoken_s": spoken_s,
    }
