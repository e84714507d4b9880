"""The difference in motion between two traces: degrees of servos, mm of lips, ms; and a picture.

Traces are aligned by sound time, so that two runs which differ in delay alone are equal. The
picture needs matplotlib, the extra `plots`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lipservo.terminal.pictures import is_picture
from lipservo.traces.trace_file import Trace
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.face.model import FaceModel
from lipsync.markers import CLOSED_GAP_MM
from lipsync.output_file import check_output, written_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: A lag is looked for from minus to plus this, in steps of a millisecond.
_MOST_LAG_S, _LAG_STEP_S = 0.25, 0.001
#: Below this standard deviation of the lip gap a trace is still: no lag can be found, mm.
_STILL_MM = 0.05
#: Closures of two traces are the same one if their beginnings differ by this at most.
_SAME_CLOSURE_S = 0.25
#: The worst moments in a `Difference` are at least so far apart.
_WORST_APART_S = 0.3
#: Servos in the picture, those that differ most, one panel each.
_N_SERVOS_DRAWN = 3
_SUFFIXES = (".png", ".svg")


class IncomparableError(UserError):
    """Two traces that cannot be compared."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A time at which two traces, a and b, differ much. lips_mm: rms distance of lip markers.

    phonemes, gaps_mm: of a and b. off_deg: b less a, of `servo`, which differs most.
    """

    sound_s: float
    phonemes: tuple[str, str]
    lips_mm: float
    gaps_mm: tuple[float, float]
    servo: str
    off_deg: float


@dataclass(frozen=True, slots=True)
class Difference:
    """How the motion of a trace b differs from that of a, over the sound time in both.

    lips_mm: rms over the lip markers; gap_mm: of the inner lips' distance; servo_most_deg,
    servo_rms_deg: (n_servos,); all are the largest of any tick (step of the motion loop) unless
    their names contain rms. lag_s: how much later b moves as a whole; None if one hardly moves or
    they hardly overlap. closure_shifts_s: of closures (lips that touch) in both, how much later
    each begins in b; lost_closures_s, new_closures_s: sound times at which those begin that only a,
    only b has. ends_apart_s: how much of the sound only one trace contains, beyond a tick.
    """

    overlap_s: tuple[float, float]
    lips_mm: float
    lips_rms_mm: float
    gap_mm: float
    servo_most_deg: tuple[float, ...]
    servo_rms_deg: tuple[float, ...]
    lag_s: float | None
    closure_shifts_s: tuple[float, ...]
    lost_closures_s: tuple[float, ...]
    new_closures_s: tuple[float, ...]
    ends_apart_s: float
    worst: tuple[Moment, ...]


@dataclass(frozen=True, slots=True)
class Tolerance:
    """The allowed difference. mm: of lips and gap; deg: of servos; s: of lag and closures."""

    mm: float
    deg: float
    s: float


@dataclass(frozen=True, slots=True)
class Overlay:
    """Two traces sampled at the n ticks (steps) of the first within the sound time in both.

    gaps_mm: the lip gap of each, two (n,); lips_mm: (n,), rms over the lip markers of their
    distance; sent_deg: goals of the servos, two (n, n_servos). own: sound times and lip gaps of
    each trace at its own ticks, (n_own,).
    """

    sound_s: Array
    phonemes: tuple[tuple[str, str], ...]
    gaps_mm: tuple[Array, Array]
    lips_mm: Array
    sent_deg: tuple[Array, Array]
    own: tuple[tuple[Array, Array], tuple[Array, Array]]


def overlay(a: Trace, b: Trace, models: tuple[FaceModel, FaceModel]) -> Overlay:
    """Return traces `a` and `b` at the ticks of `a` that lie in the sound time of both.

    b's frames and goals are interpolated linearly. models: the face model of each. Raises
    IncomparableError, one line, if servos, face or number of lip points differ, or if fewer than
    two ticks of `a` lie in both.
    """
    if a.servos != b.servos:
        unshared = sorted(set(a.servos) ^ set(b.servos))
        difference = f"only one of them has {unshared[0]}" if unshared else "in another order"
        raise IncomparableError(f"{a.name} and {b.name} have different servos: {difference}")
    if a.face != b.face:
        raise IncomparableError(f"{a.name} is of face {a.face!r}, but {b.name} of {b.face!r}")
    lips = [list(model.layout.lips) for model in models]
    if len(lips[0]) != len(lips[1]):
        raise IncomparableError(
            f"{a.name} and {b.name} have models of {len(lips[0])} and {len(lips[1])} lip points, "
            "which cannot be compared"
        )
    start_s, end_s = max(a.sound_s[0], b.sound_s[0]), min(a.sound_s[-1], b.sound_s[-1])
    in_both = (a.sound_s >= start_s - 1e-9) & (a.sound_s <= end_s + 1e-9)
    if in_both.sum() < 2:
        raise IncomparableError(f"{a.name} and {b.name} have no sound time in common")
    times_s = a.sound_s[in_both]
    markers_mm = [
        model.markers_mm(_interpolated(trace.sound_s, trace.coefficients, times_s))
        for trace, model in zip((a, b), models, strict=True)
    ]
    distances_mm = np.linalg.norm(markers_mm[1][:, lips[1]] - markers_mm[0][:, lips[0]], axis=2)
    # A phoneme cannot be interpolated: b's is that of its first tick at or after a's.
    next_tick = np.clip(np.searchsorted(b.sound_s, times_s - 1e-9), 0, len(b.sound_s) - 1)
    phoneme_of_tick = np.array(a.phonemes)[in_both]
    return Overlay(
        sound_s=times_s,
        phonemes=tuple(
            zip(phoneme_of_tick.tolist(), np.array(b.phonemes)[next_tick].tolist(), strict=True)
        ),
        gaps_mm=(models[0].lip_gaps_mm(markers_mm[0]), models[1].lip_gaps_mm(markers_mm[1])),
        lips_mm=np.sqrt((distances_mm**2).mean(axis=1)),
        sent_deg=(a.sent_deg[in_both], _interpolated(b.sound_s, b.sent_deg, times_s)),
        own=(_gap_curve(a, models[0]), _gap_curve(b, models[1])),
    )


def compare(a: Trace, b: Trace, both: Overlay, *, margin_mm: float, n_worst: int = 5) -> Difference:
    """Return all figures of the difference between two traces, recorded runs of one face.

    both: their overlay. margin_mm: a closure (lips that touch) does not count as lost if lips are
    open by less in the other trace. n_worst: number of times of large difference to list.
    """
    apart_deg = np.abs(both.sent_deg[1] - both.sent_deg[0])
    gap_a, gap_b = both.gaps_mm
    shifts_s, lost_s, new_s = _match_closures(both, margin_mm)
    return Difference(
        overlap_s=(float(both.sound_s[0]), float(both.sound_s[-1])),
        lips_mm=float(both.lips_mm.max()),
        lips_rms_mm=float(np.sqrt((both.lips_mm**2).mean())),
        gap_mm=float(np.abs(gap_b - gap_a).max()),
        servo_most_deg=tuple(apart_deg.max(axis=0).tolist()),
        servo_rms_deg=tuple(np.sqrt((apart_deg**2).mean(axis=0)).tolist()),
        lag_s=motion_lag_s(*both.own[0], *both.own[1]),
        closure_shifts_s=shifts_s,
        lost_closures_s=lost_s,
        new_closures_s=new_s,
        ends_apart_s=_ends_apart_s(a, b),
        worst=_worst_ticks(a, both, apart_deg, n_worst),
    )


def excesses(servos: tuple[str, ...], diff: Difference, tolerance: Tolerance) -> list[str]:
    """Return a line for each figure that exceeds the tolerance; empty if none does.

    servos: names of the servos, in the order of the figures in `diff`.
    """
    lines = []
    if diff.lips_mm > tolerance.mm:
        lines.append(f"lips are up to {diff.lips_mm:.2f} mm apart, {tolerance.mm:g} allowed")
    if diff.gap_mm > tolerance.mm:
        lines.append(f"the lip gap is up to {diff.gap_mm:.2f} mm off, {tolerance.mm:g} allowed")
    most_deg, servo = max(zip(diff.servo_most_deg, servos, strict=True))
    if most_deg > tolerance.deg:
        lines.append(f"{servo} is up to {most_deg:.2f} deg off, {tolerance.deg:g} allowed")
    if diff.lag_s is not None and abs(diff.lag_s) > tolerance.s:
        lines.append(
            f"the motion is {1e3 * diff.lag_s:+.1f} ms late, {1e3 * tolerance.s:g} allowed"
        )
    shift_s = max(map(abs, diff.closure_shifts_s), default=0.0)
    if shift_s > tolerance.s:
        lines.append(
            f"a closure is shifted by {1e3 * shift_s:.1f} ms, {1e3 * tolerance.s:g} allowed"
        )
    if diff.lost_closures_s or diff.new_closures_s:
        lines.append(
            f"{len(diff.lost_closures_s)} closures are lost, {len(diff.new_closures_s)} are new"
        )
    if diff.ends_apart_s > tolerance.s + 1e-6:
        lines.append(f"one shows {diff.ends_apart_s:.3f} s that the other does not")
    return lines


def motion_lag_s(times_s: Array, first: Array, second_s: Array, second: Array) -> float | None:
    """Return how much later the second curve moves: the lag of the greatest correlation.

    Lags up to 0.25 s, or a quarter of the overlap if that is less, are tried in steps of 1 ms; a
    parabola through the best three refines the result.

    Parameters
    ----------
    times_s,first : Array
        (n,) seconds and values of the first curve.
    second_s,second : Array
        (m,) seconds and values of the second curve.

    Returns
    -------
    float | None
        Seconds, positive where the second is later; None if either hardly moves (standard
        deviation below 0.05) or they hardly overlap.
    """
    if min(first.std(), second.std()) < _STILL_MM:
        return None
    start_s, end_s = max(times_s[0], second_s[0]), min(times_s[-1], second_s[-1])
    max_lag_s = min(_MOST_LAG_S, (end_s - start_s) / 4.0)
    lags_s = np.arange(-max_lag_s, max_lag_s + _LAG_STEP_S / 2.0, _LAG_STEP_S)
    # Samples of the first curve that stay within the second at every lag.
    is_compared = (times_s >= start_s + max_lag_s) & (times_s <= end_s - max_lag_s)
    if is_compared.sum() < 3:
        return None
    reference = first[is_compared] - first[is_compared].mean()
    scores = []
    for lag_s in lags_s:
        shifted = np.interp(times_s[is_compared] + lag_s, second_s, second)
        shifted = shifted - shifted.mean()
        scale = float(np.linalg.norm(reference) * np.linalg.norm(shifted))
        scores.append(float(reference @ shifted) / scale if scale > 0.0 else -1.0)
    best = int(np.argmax(scores))
    if not 0 < best < len(scores) - 1:
        return float(lags_s[best])
    left, top, right = scores[best - 1 : best + 2]
    # https://ccrma.stanford.edu/~jos/sasp/Quadratic_Interpolation_Spectral_Peaks.html
    curvature = left - 2.0 * top + right
    offset = 0.5 * (left - right) / curvature if curvature else 0.0
    return round(float(lags_s[best] + offset * _LAG_STEP_S), 6) + 0.0  # never -0.0


@dataclass(frozen=True, slots=True)
class _Closure:
    """A closure, an interval in which lips touch. All times are sound times.

    start_s: its beginning, interpolated between ticks; times_s: (n,), of its ticks.
    """

    start_s: float
    times_s: Array


def _find_closures(times_s: Array, gaps_mm: Array) -> list[_Closure]:
    """Return each closure of the lips in a curve, an interval in which their gap is below 1 mm.

    A closure that holds at the first tick is left out: its beginning is not known. times_s:
    (n_ticks,) sound times; gaps_mm: (n_ticks,) lip gaps.
    """
    closed = gaps_mm < CLOSED_GAP_MM
    found = []
    for start in (np.flatnonzero(closed[1:] & ~closed[:-1]) + 1).tolist():
        opens = np.flatnonzero(~closed[start:])
        end = start + int(opens[0]) if len(opens) else len(closed)
        before_mm, after_mm = gaps_mm[start - 1], gaps_mm[start]
        share = (before_mm - CLOSED_GAP_MM) / (before_mm - after_mm)
        start_s = times_s[start - 1] + share * (times_s[start] - times_s[start - 1])
        found.append(_Closure(float(start_s), times_s[start:end]))
    return found


def _match_closures(
    both: Overlay, margin_mm: float
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Return (shifts of closures in both traces, starts of lost ones, starts of new ones), in s.

    A shift is positive where the second trace closes later. A closure of one trace alone is lost
    (only the first has it) or new only if the lips of the other trace stay open by more than
    `margin_mm` beyond a closure's limit, 1 mm.
    """
    span_s = both.sound_s[0], both.sound_s[-1]
    of_first, of_second = (
        [each for each in _find_closures(*curve) if span_s[0] <= each.start_s <= span_s[1]]
        for curve in both.own
    )
    shifts, lost = [], []
    for closure in of_first:
        nearest = min(of_second, key=lambda each: abs(each.start_s - closure.start_s), default=None)
        if nearest is None or abs(nearest.start_s - closure.start_s) > _SAME_CLOSURE_S:
            lost.append(closure)
            continue
        of_second.remove(nearest)
        shifts.append(nearest.start_s - closure.start_s)
    return (
        tuple(shifts),
        tuple(each.start_s for each in lost if _stays_open(both.own[1], each, margin_mm)),
        tuple(each.start_s for each in of_second if _stays_open(both.own[0], each, margin_mm)),
    )


def _stays_open(curve: tuple[Array, Array], closure: _Closure, margin_mm: float) -> bool:
    """Return whether a trace's lips stay open during a closure of the other trace.

    curve: (sound times, lip gaps in mm) of the trace that is examined; open: at every tick of
    `closure` its gap exceeds a closure's limit by more than `margin_mm`.
    """
    return bool(np.interp(closure.times_s, *curve).min() > CLOSED_GAP_MM + margin_mm)


def _gap_curve(trace: Trace, model: FaceModel) -> tuple[Array, Array]:
    return trace.sound_s, model.lip_gaps_mm(model.markers_mm(trace.coefficients))


def _worst_ticks(a: Trace, both: Overlay, apart_deg: Array, n_worst: int) -> tuple[Moment, ...]:
    """Return the ticks at which two traces differ most, worst first, at least 0.3 s apart.

    At most `n_worst`, none without a difference. The lip distance in `both` decides; where it is
    equal, the servos' absolute difference, `apart_deg` (n, n_servos).
    """
    remaining = both.lips_mm + 1e-3 * apart_deg.max(axis=1)
    found: list[Moment] = []
    while len(found) < n_worst and remaining.max() > 0.0:
        tick = int(np.argmax(remaining))
        servo = int(np.argmax(apart_deg[tick]))
        found.append(
            Moment(
                sound_s=float(both.sound_s[tick]),
                phonemes=both.phonemes[tick],
                lips_mm=float(both.lips_mm[tick]),
                gaps_mm=(float(both.gaps_mm[0][tick]), float(both.gaps_mm[1][tick])),
                servo=a.servos[servo],
                off_deg=float(both.sent_deg[1][tick, servo] - both.sent_deg[0][tick, servo]),
            )
        )
        remaining[np.abs(both.sound_s - both.sound_s[tick]) < _WORST_APART_S] = 0.0
    return tuple(found)


def _ends_apart_s(a: Trace, b: Trace) -> float:
    """Return by how many s the starts or the ends of traces differ, whichever is more, less a tick.

    A start before sound time 0 counts as 0.
    """
    tick_s = max(float(np.diff(trace.sound_s).min()) for trace in (a, b))
    starts_s, ends_s = (
        [max(0.0, float(trace.sound_s[tick])) for trace in (a, b)] for tick in (0, -1)
    )
    apart_s = max(abs(starts_s[0] - starts_s[1]), abs(ends_s[0] - ends_s[1]))
    return max(0.0, apart_s - tick_s)


def _interpolated(known_s: Array, values: Array, times_s: Array) -> Array:
    """Return values (n, k), known at times `known_s`, interpolated at `times_s` (m,) as (m, k)."""
    return np.stack([np.interp(times_s, known_s, column) for column in values.T], axis=1)


def check_plot(path: Path) -> None:
    """Check that the picture of a difference can be written to `path`.

    Raises UserError for another kind of picture, OutputError.
    """
    if path.suffix not in _SUFFIXES:
        raise UserError(f"{path}: the plot's name must end in {' or '.join(_SUFFIXES)}")
    check_output(path, replaces=_is_drawing, kind="PNG or SVG picture")


def _is_drawing(head: bytes) -> bool:
    return is_picture(head) or (head.startswith(b"<?xml") and b"svg" in head)


def draw_difference(path: Path, first: Trace, second: Trace, both: Overlay) -> None:
    """Write a PNG or SVG picture of two traces: lip gaps, lip distance, most different servos.

    path: ends in .png or .svg. both: the overlay of the traces; three servos are drawn at most.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    apart_deg = np.abs(both.sent_deg[1] - both.sent_deg[0]).max(axis=0)
    servos = np.argsort(apart_deg)[::-1][:_N_SERVOS_DRAWN].tolist()
    figure, axes = plt.subplots(
        2 + len(servos), 1, sharex=True, figsize=(11, 4 + 1.8 * len(servos)), layout="constrained"
    )
    gap_axis, distance_axis = axes[0], axes[1]
    for trace, curve, style in zip((first, second), both.gaps_mm, ("-", "--"), strict=True):
        gap_axis.plot(both.sound_s, curve, style, label=trace.name, linewidth=1.2)
    gap_axis.axhline(CLOSED_GAP_MM, color="0.5", linewidth=0.6, linestyle=":")
    gap_axis.set_ylabel("lip gap, mm")
    gap_axis.legend(loc="upper right", fontsize=8)
    _label_phonemes(gap_axis, both)
    distance_axis.fill_between(both.sound_s, both.lips_mm, color="tab:red", linewidth=0.0)
    distance_axis.set_ylabel("lips apart,\nmm rms")
    for axis, servo in zip(axes[2:], servos, strict=True):
        for curve, style in zip(both.sent_deg, ("-", "--"), strict=True):
            axis.plot(both.sound_s, curve[:, servo], style, linewidth=1.0)
        axis.set_ylabel(f"{first.servos[servo]},\ndeg", fontsize=8)
    axes[-1].set_xlabel("sound time, s")
    with written_whole(path) as file:
        figure.savefig(file, dpi=110, format=path.suffix[1:])
    plt.close(figure)


def _label_phonemes(axis: "Axes", both: Overlay) -> None:
    """Write the first trace's phonemes above the axis, each at its beginning, on two lines in turn.

    Two lines, so that short phonemes do not overlap.
    """
    above_axis = axis.get_xaxis_transform()
    previous, n = "", 0
    for time_s, (phoneme, _) in zip(both.sound_s.tolist(), both.phonemes, strict=True):
        if phoneme != previous:
            axis.text(time_s, 1.02 + 0.08 * (n % 2), phoneme, fontsize=6, transform=above_axis)
            n += 1
        previous = phoneme
