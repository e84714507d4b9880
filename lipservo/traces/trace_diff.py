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

#: The lag is looked for within this, in steps of a millisecond.
_MOST_LAG_S, _LAG_STEP_S = 0.25, 0.001
#: Motion less than this has no timing to speak of, mm rms of the lip gap around its mean.
_STILL_MM = 0.05
#: The beginning of a closure in one trace and in the other are the same one within this.
_SAME_CLOSURE_S = 0.25
#: Worst moments that are told are so far apart.
_APART_S = 0.3
#: The servos that differ most, one panel each.
_SERVOS = 3
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
    """Return traces `a` and `b` aligned by sound time; `models`: the face model of each.

    Raises IncomparableError with one line.
    """
    if a.servos != b.servos:
        only = sorted(set(a.servos) ^ set(b.servos))
        what = f"only one of them has {only[0]}" if only else "in another order"
        raise IncomparableError(f"{a.name} and {b.name} have different servos: {what}")
    if a.face != b.face:
        raise IncomparableError(f"{a.name} is of face {a.face!r}, but {b.name} of {b.face!r}")
    lips = [list(model.layout.lips) for model in models]
    if len(lips[0]) != len(lips[1]):
        raise IncomparableError(
            f"{a.name} and {b.name} have models of {len(lips[0])} and {len(lips[1])} lip points, "
            "which cannot be compared"
        )
    start_s, end_s = max(a.sound_s[0], b.sound_s[0]), min(a.sound_s[-1], b.sound_s[-1])
    within = (a.sound_s >= start_s - 1e-9) & (a.sound_s <= end_s + 1e-9)
    if within.sum() < 2:
        raise IncomparableError(f"{a.name} and {b.name} have no sound time in common")
    times_s = a.sound_s[within]
    faces = [
        model.markers_mm(_at(trace.sound_s, trace.coefficients, times_s))
        for trace, model in zip((a, b), models, strict=True)
    ]
    apart_mm = np.linalg.norm(faces[1][:, lips[1]] - faces[0][:, lips[0]], axis=2)
    nearest = np.clip(np.searchsorted(b.sound_s, times_s - 1e-9), 0, len(b.sound_s) - 1)
    phoneme_of_tick = np.array(a.phonemes)[within]
    return Overlay(
        sound_s=times_s,
        phonemes=tuple(
            zip(phoneme_of_tick.tolist(), np.array(b.phonemes)[nearest].tolist(), strict=True)
        ),
        gaps_mm=(models[0].lip_gaps_mm(faces[0]), models[1].lip_gaps_mm(faces[1])),
        lips_mm=np.sqrt((apart_mm**2).mean(axis=1)),
        sent_deg=(a.sent_deg[within], _at(b.sound_s, b.sent_deg, times_s)),
        own=(_own_gaps(a, models[0]), _own_gaps(b, models[1])),
    )


def compare(a: Trace, b: Trace, laid: Overlay, *, margin_mm: float, n_worst: int = 5) -> Difference:
    """Return all figures of the difference between two traces, recorded runs of one face.

    laid: their overlay. margin_mm: a closure (lips that touch) does not count as lost if lips are
    open by less in the other trace. n_worst: number of times of large difference to list.
    """
    apart_deg = np.abs(laid.sent_deg[1] - laid.sent_deg[0])
    gap_a, gap_b = laid.gaps_mm
    shifts_s, lost_s, new_s = _match_closures(laid, margin_mm)
    return Difference(
        overlap_s=(float(laid.sound_s[0]), float(laid.sound_s[-1])),
        lips_mm=float(laid.lips_mm.max()),
        lips_rms_mm=float(np.sqrt((laid.lips_mm**2).mean())),
        gap_mm=float(np.abs(gap_b - gap_a).max()),
        servo_most_deg=tuple(apart_deg.max(axis=0).tolist()),
        servo_rms_deg=tuple(np.sqrt((apart_deg**2).mean(axis=0)).tolist()),
        lag_s=motion_lag_s(*laid.own[0], *laid.own[1]),
        closure_shifts_s=shifts_s,
        lost_closures_s=lost_s,
        new_closures_s=new_s,
        ends_apart_s=_ends_apart_s(a, b),
        worst=_worst(a, laid, apart_deg, n_worst),
    )


def excesses(servos: tuple[str, ...], found: Difference, tolerance: Tolerance) -> list[str]:
    """Return a line for each figure of `found` that exceeds the tolerance; empty if none does."""
    lines = []
    if found.lips_mm > tolerance.mm:
        lines.append(f"lips are up to {found.lips_mm:.2f} mm apart, {tolerance.mm:g} allowed")
    if found.gap_mm > tolerance.mm:
        lines.append(f"the lip gap is up to {found.gap_mm:.2f} mm off, {tolerance.mm:g} allowed")
    most_deg, servo = max(zip(found.servo_most_deg, servos, strict=True))
    if most_deg > tolerance.deg:
        lines.append(f"{servo} is up to {most_deg:.2f} deg off, {tolerance.deg:g} allowed")
    if found.lag_s is not None and abs(found.lag_s) > tolerance.s:
        lines.append(
            f"the motion is {1e3 * found.lag_s:+.1f} ms late, {1e3 * tolerance.s:g} allowed"
        )
    shift_s = max(map(abs, found.closure_shifts_s), default=0.0)
    if shift_s > tolerance.s:
        lines.append(
            f"a closure is shifted by {1e3 * shift_s:.1f} ms, {1e3 * tolerance.s:g} allowed"
        )
    if found.lost_closures_s or found.new_closures_s:
        lines.append(
            f"{len(found.lost_closures_s)} closures are lost, {len(found.new_closures_s)} are new"
        )
    if found.ends_apart_s > tolerance.s + 1e-6:
        lines.append(f"one shows {found.ends_apart_s:.3f} s that the other does not")
    return lines


def motion_lag_s(times_s: Array, first: Array, second_s: Array, second: Array) -> float | None:
    """Return how much later the second curve moves: the maximum of their cross-correlation.

    The lag is a quarter of a second at most, refined by a parabola.

    Parameters
    ----------
    times_s,first : Array
        (n,) seconds and values of the first curve.
    second_s,second : Array
        (m,) seconds and values of the second curve.

    Returns
    -------
    float | None
        Seconds; None if either hardly moves or they hardly overlap.
    """
    if min(first.std(), second.std()) < _STILL_MM:
        return None
    start_s, end_s = max(times_s[0], second_s[0]), min(times_s[-1], second_s[-1])
    most_s = min(_MOST_LAG_S, (end_s - start_s) / 4.0)
    lags_s = np.arange(-most_s, most_s + _LAG_STEP_S / 2.0, _LAG_STEP_S)
    inner = (times_s >= start_s + most_s) & (times_s <= end_s - most_s)
    if inner.sum() < 3:
        return None
    still = first[inner] - first[inner].mean()
    scores = []
    for lag_s in lags_s:
        moved = np.interp(times_s[inner] + lag_s, second_s, second)
        moved = moved - moved.mean()
        scale = float(np.linalg.norm(still) * np.linalg.norm(moved))
        scores.append(float(still @ moved) / scale if scale > 0.0 else -1.0)
    best = int(np.argmax(scores))
    if not 0 < best < len(scores) - 1:
        return float(lags_s[best])
    left, top, right = scores[best - 1 : best + 2]
    bend = left - 2.0 * top + right
    offset = 0.5 * (left - right) / bend if bend else 0.0
    return round(float(lags_s[best] + offset * _LAG_STEP_S), 6) + 0.0


@dataclass(frozen=True, slots=True)
class _Closure:
    """A closure (lips that touch), which begins at `start_s`. times_s: sound times of its ticks."""

    start_s: float
    times_s: Array


def _closures(times_s: Array, gaps_mm: Array) -> list[_Closure]:
    """Return each closure of the lips, an interval in which their gap is below 1 mm.

    A closure has its start, interpolated between ticks, and the times of its ticks. A closure at
    the first tick is left out. times_s: (n_ticks,) sound times; gaps_mm: (n_ticks,) lip gaps.
    """
    closed = gaps_mm < CLOSED_GAP_MM
    found = []
    for start in (np.flatnonzero(closed[1:] & ~closed[:-1]) + 1).tolist():
        opens = np.flatnonzero(~closed[start:])
        end = start + int(opens[0]) if len(opens) else len(closed)
        before, after = gaps_mm[start - 1], gaps_mm[start]
        share = (before - CLOSED_GAP_MM) / (before - after)
        moment_s = times_s[start - 1] + share * (times_s[start] - times_s[start - 1])
        found.append(_Closure(float(moment_s), times_s[start:end]))
    return found


def _match_closures(
    laid: Overlay, margin_mm: float
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Return shifts of the closures in both traces, and starts of those in one alone, all in s.

    The starts are of closures in only the first trace, and in only the second. margin_mm: a closure
    is missing in a trace whose lips stay open by more than that beyond a closure's limit.
    """
    span_s = laid.sound_s[0], laid.sound_s[-1]
    ours, theirs = (
        [each for each in _closures(*own) if span_s[0] <= each.start_s <= span_s[1]]
        for own in laid.own
    )
    shifts, lost = [], []
    for closure in ours:
        near = min(theirs, key=lambda each: abs(each.start_s - closure.start_s), default=None)
        if near is None or abs(near.start_s - closure.start_s) > _SAME_CLOSURE_S:
            lost.append(closure)
            continue
        theirs.remove(near)
        shifts.append(near.start_s - closure.start_s)
    return (
        tuple(shifts),
        tuple(each.start_s for each in lost if _open(laid.own[1], each, margin_mm)),
        tuple(each.start_s for each in theirs if _open(laid.own[0], each, margin_mm)),
    )


def _open(own: tuple[Array, Array], closure: _Closure, margin_mm: float) -> bool:
    """Return whether lips stay open by over `margin_mm` during a closure of the other trace.

    own: sound times and lip gaps of the trace that is examined.
    """
    return bool(np.interp(closure.times_s, *own).min() > CLOSED_GAP_MM + margin_mm)


def _own_gaps(trace: Trace, model: FaceModel) -> tuple[Array, Array]:
    return trace.sound_s, model.lip_gaps_mm(model.markers_mm(trace.coefficients))


def _worst(a: Trace, laid: Overlay, apart_deg: Array, n_worst: int) -> tuple[Moment, ...]:
    """Return the `n_worst` ticks at which two traces differ most, 0.3 s apart or more.

    The lip distance in `laid` decides, then the servos' difference, `apart_deg` (n, n_servos).
    """
    badness = laid.lips_mm + 1e-3 * apart_deg.max(axis=1)
    left = badness.copy()
    found: list[Moment] = []
    while len(found) < n_worst and left.max() > 0.0:
        at = int(np.argmax(left))
        servo = int(np.argmax(apart_deg[at]))
        found.append(
            Moment(
                sound_s=float(laid.sound_s[at]),
                phonemes=laid.phonemes[at],
                lips_mm=float(laid.lips_mm[at]),
                gaps_mm=(float(laid.gaps_mm[0][at]), float(laid.gaps_mm[1][at])),
                servo=a.servos[servo],
                off_deg=float(laid.sent_deg[1][at, servo] - laid.sent_deg[0][at, servo]),
            )
        )
        left[np.abs(laid.sound_s - laid.sound_s[at]) < _APART_S] = 0.0
    return tuple(found)


def _ends_apart_s(a: Trace, b: Trace) -> float:
    """Return by how many s starts or ends of traces differ, less a tick; before 0 s is ignored."""
    tick_s = max(float(np.diff(trace.sound_s).min()) for trace in (a, b))
    starts_s, ends_s = (
        [max(0.0, float(trace.sound_s[end])) for trace in (a, b)] for end in (0, -1)
    )
    apart_s = max(abs(starts_s[0] - starts_s[1]), abs(ends_s[0] - ends_s[1]))
    return max(0.0, apart_s - tick_s)


def _at(from_s: Array, values: Array, times_s: Array) -> Array:
    """Return values (n, k), known at times `from_s`, interpolated at `times_s` (m,) as (m, k)."""
    return np.stack([np.interp(times_s, from_s, column) for column in values.T], axis=1)


def check_plot(path: Path) -> None:
    """Check that the picture of a difference can be written to `path`.

    Raises UserError for another kind of picture, OutputError.
    """
    if path.suffix not in _SUFFIXES:
        raise UserError(f"{path}: the plot's name must end in {' or '.join(_SUFFIXES)}")
    check_output(path, replaces=_is_drawing, kind="PNG or SVG picture")


def _is_drawing(head: bytes) -> bool:
    return is_picture(head) or (head.startswith(b"<?xml") and b"svg" in head)


def draw_difference(path: Path, first: Trace, second: Trace, laid: Overlay) -> None:
    """Write a picture of two traces: lip gaps, lip distance, the three most different servos.

    laid: their overlay.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    apart_deg = np.abs(laid.sent_deg[1] - laid.sent_deg[0]).max(axis=0)
    servos = np.argsort(apart_deg)[::-1][:_SERVOS].tolist()
    figure, axes = plt.subplots(
        2 + len(servos), 1, sharex=True, figsize=(11, 4 + 1.8 * len(servos)), layout="constrained"
    )
    gap, apart = axes[0], axes[1]
    for trace, curve, style in zip((first, second), laid.gaps_mm, ("-", "--"), strict=True):
        gap.plot(laid.sound_s, curve, style, label=trace.name, linewidth=1.2)
    gap.axhline(CLOSED_GAP_MM, color="0.5", linewidth=0.6, linestyle=":")
    gap.set_ylabel("lip gap, mm")
    gap.legend(fontsize=8)
    _name_phonemes(gap, laid)
    apart.fill_between(laid.sound_s, laid.lips_mm, color="tab:red", linewidth=0.0)
    apart.set_ylabel("lips apart,\nmm rms")
    for axis, servo in zip(axes[2:], servos, strict=True):
        for curve, style in zip(laid.sent_deg, ("-", "--"), strict=True):
            axis.plot(laid.sound_s, curve[:, servo], style, linewidth=1.0)
        axis.set_ylabel(f"{first.servos[servo]},\ndeg", fontsize=8)
    axes[-1].set_xlabel("sound time, s")
    with written_whole(path) as file:
        figure.savefig(file, dpi=110, format=path.suffix[1:])
    plt.close(figure)


def _name_phonemes(axis: "Axes", laid: Overlay) -> None:
    """Write the first trace's phonemes above the axis, alternating between two lines."""
    place = axis.get_xaxis_transform()
    before, n = "", 0
    for time_s, (phoneme, _) in zip(laid.sound_s.tolist(), laid.phonemes, strict=True):
        if phoneme != before:
            axis.text(time_s, 1.02 + 0.08 * (n % 2), phoneme, fontsize=6, transform=place)
            n += 1
        before = phoneme
