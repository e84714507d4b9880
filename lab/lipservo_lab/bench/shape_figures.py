"""The picture of `lipservo bench shapes`; needs matplotlib, the extra `plots`.

The figures of `lipservo bench shapes`: when drawn mouths and our lips close for P, B and M.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lipservo.rendering.spoken_sound import SpokenSound
from lipservo.terminal.pictures import save_picture, without_screen
from lipsync.animpho.units import load_face_with_animphos
from lipsync.arrays import Array
from lipsync.audio.file import read_sound
from lipsync.export.arkit import lip_measures
from lipsync.export.mouth_cues import CENTISECOND_S, CLOSED_SHAPES, MouthCue, rule_cues
from lipsync.export.shapes_of_motion import (
    lips_shut,
    motion_cues,
    sampling_times_s,
    shape_prototypes,
)
from lipsync.markers import CLOSED_GAP_MM
from lipsync.motion.finishing import BILABIALS
from lipsync.phonemes import SILENCE, PhonemeEvent

if TYPE_CHECKING:
    from matplotlib.axes import Axes


#: A closing belongs to the nearest phone, no farther than this; labels are good to 40 ms.
_MATCHED_S, _AROUND_S = 0.2, 0.04

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ComparedShapes:
    """One sound with the mouth shapes that each method draws for it.

    rules, motion: shapes by Rhubarb's rules and by our motion. times_s, gap_mm: (n,), our lip gap.
    All of these are made from the true phones. closed: intervals in which the mouth is closed, s,
    by the method's title.
    """

    phones: tuple[PhonemeEvent, ...]
    duration_s: float
    rules: list[MouthCue]
    motion: list[MouthCue]
    times_s: Array
    gap_mm: Array
    closed: Mapping[str, list[Interval]]


def compared_shapes(from_text: SpokenSound, heard: SpokenSound) -> ComparedShapes:
    """Draw one sound by Rhubarb's rules and by our motion, and find when the mouth closes in each.

    from_text: the sound with its true phones; heard: with those of the recogniser.
    """
    phones, duration_s = tuple(from_text.events()), from_text.duration_s
    rules = rule_cues(phones, duration_s)
    at_burst = rule_cues(phones, duration_s, stops_at_burst=True)
    times_s = sampling_times_s(duration_s)
    motion, gap_mm = _drawn(from_text, times_s, duration_s)
    heard_motion, heard_gap_mm = _drawn(heard, times_s, duration_s)
    closed = {
        "Rhubarb's rules, true phones": _closed_intervals(rules),
        "the same, stops labelled at the burst": _closed_intervals(at_burst),
        "our lips, true phones": _touching_intervals(times_s, gap_mm),
        "our shapes, true phones": _closed_intervals(motion),
        "our lips, from the sound": _touching_intervals(times_s, heard_gap_mm),
        "our shapes, from the sound": _closed_intervals(heard_motion),
    }
    return ComparedShapes(phones, duration_s, rules, motion, times_s, gap_mm, closed)


def closing_figures(
    phones: Sequence[PhonemeEvent], closed: Sequence[Interval]
) -> dict[str, float | int | None]:
    """Return how reliably, and how late after the phone's beginning, a mouth closes for P, B and M.

    closed: intervals with a closed mouth, s. Figures: the number of P, B and M; in how many
    of them, 40 ms around, the mouth is closed; percentiles of the delay, ms, of the
    closing nearest to the phone, if it is within 200 ms and the phone before leaves the mouth open
    (None: there is no such closing).
    """
    bilabials = [phone for phone in phones if phone.phoneme in BILABIALS]
    n_closed = sum(any(_overlap(phone, interval) for interval in closed) for phone in bilabials)
    closing_starts_s = np.array([start_s for start_s, _ in closed])
    errors_ms = []
    for previous, phone in pairwise(phones):
        # After a pause or another closure the mouth may be closed already.
        if phone.phoneme in BILABIALS and previous.phoneme not in (*BILABIALS, SILENCE):
            delays_s = closing_starts_s - phone.start_s
            if len(delays_s) and abs(nearest := delays_s[np.abs(delays_s).argmin()]) <= _MATCHED_S:
                errors_ms.append(1e3 * float(nearest))
    figures: dict[str, float | int | None] = {"phones": len(bilabials), "met": n_closed}
    names = ("p10_ms", "median_ms", "p90_ms")
    values = np.percentile(errors_ms, [10, 50, 90]) if errors_ms else [None] * 3
    return figures | {
        name: None if value is None else round(float(value), 1)
        for name, value in zip(names, values, strict=True)
    }


def _overlap(phone: PhonemeEvent, interval: Interval) -> bool:
    """Return whether the mouth is closed at some time from 40 ms before a phone to 40 ms after."""
    end_s = phone.start_s if phone.end_s is None else phone.end_s
    return interval[0] < end_s + _AROUND_S and interval[1] > phone.start_s - _AROUND_S


def _drawn(spoken: SpokenSound, times_s: Array, duration_s: float) -> tuple[list[MouthCue], Array]:
    """Return the mouth shapes of a sound's motion, and the lip gap, (n,) mm, at `times_s`."""
    model = load_face_with_animphos(spoken.model)
    measures = lip_measures(model)
    faces = np.array([frame.coefficients for frame in spoken.frames(times_s)])
    prototypes = shape_prototypes(model, measures)
    cues = motion_cues(prototypes, faces, lips_shut(measures, faces), duration_s)
    return cues, model.lip_gaps_mm(model.markers_mm(faces))


def _closed_intervals(cues: Sequence[MouthCue]) -> list[Interval]:
    """Return the intervals, s, of closed shapes; adjacent ones (A and X) make one interval."""
    found: list[Interval] = []
    for cue in cues:
        if cue.shape in CLOSED_SHAPES:
            start_s, end_s = cue.start_cs * CENTISECOND_S, cue.end_cs * CENTISECOND_S
            if found and found[-1][1] == start_s:
                start_s = found.pop()[0]
            found.append((start_s, end_s))
    return found


def _touching_intervals(times_s: Array, gap_mm: Array) -> list[Interval]:
    """Return the intervals, s, in which the lip gap is at most that of recorded closures."""
    is_closed = np.concatenate([[False], gap_mm <= CLOSED_GAP_MM, [False]])
    edges = np.flatnonzero(np.diff(is_closed.astype(np.int8)))
    # The time of each frame, and the end of the last one: where intervals begin and end.
    at_s = np.append(times_s, times_s[-1] + CENTISECOND_S)
    return [(float(at_s[a]), float(at_s[b])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


#: What is shown, s.
SHOWN_S = (1.35, 4.35)
#: A darker shape is a wider mouth, purple a rounded one.
_COLOURS = {
    "A": "#f4c7c3", "X": "#eeeeee", "B": "#dbe9f6", "C": "#a6cbe5", "D": "#5b9bd0", "H": "#8fbfdc",
    "E": "#cbb8e0", "F": "#a48cc8", "G": "#d5e8c9",
}  # fmt: skip
_LEGEND = (
    "A lips closed   X at rest   B slightly open   C open   D wide open   "
    "E slightly rounded   F puckered   G teeth on lip   H tongue raised"
)
#: Cut off at the edge to less than this, a block has no room for its word.
_NARROWEST_S = 0.015
#: What a small letter takes up.
_ROOM_S = 0.0135
Block = tuple[float, float, str, str]


def draw_shapes(compared: ComparedShapes, sound: Path, output: Path) -> None:
    """Write a picture of one sound to `output`.

    Waveform, true phones, Rhubarb's shapes, our shapes and our lip gap, one below the other, of the
    seconds `SHOWN_S`. sound: the recording's file.
    """
    without_screen()
    from matplotlib import pyplot as plt

    samples, rate_hz = read_sound(sound)
    figure, axes = plt.subplots(
        5, 1, sharex=True, figsize=(13, 7.2), layout="constrained", height_ratios=(2, 1, 1, 1, 3)
    )
    axes[0].plot(np.arange(len(samples)) / rate_hz, samples, linewidth=0.4, color="0.3")
    axes[0].set_title(
        "The same phones drawn by Rhubarb's rules and by the robot's motion; "
        "shaded: P, B, M, where lips must touch",
        loc="left",
    )
    phones = (
        (p.start_s, compared.duration_s if p.end_s is None else p.end_s,
         "" if p.phoneme == SILENCE else p.phoneme,
         _COLOURS["A"] if p.phoneme in BILABIALS else "white")
        for p in compared.phones
    )  # fmt: skip
    _draw_blocks(axes[1], phones)
    _draw_blocks(axes[2], _cue_blocks(compared.rules))
    _draw_blocks(axes[3], _cue_blocks(compared.motion))
    axes[4].plot(compared.times_s, compared.gap_mm, color="tab:red")
    axes[4].axhline(CLOSED_GAP_MM, color="0.5", linewidth=0.8, linestyle=":")
    axes[4].text(SHOWN_S[1], CLOSED_GAP_MM, " closed", va="center", fontsize=9, color="0.4")
    axes[4].set_ylim(bottom=0.0)
    axes[4].set_xlabel(f"sound time, s\n{_LEGEND}")
    rows = ("sound", "true phones", "Rhubarb's rules", "our shapes", "robot's lip gap, mm")
    for axis, name in zip(axes, rows, strict=True):
        axis.set_ylabel(name, rotation=0, ha="right", va="center")
        axis.set_xlim(*SHOWN_S)
        if name != rows[-1]:
            axis.set_yticks([])
        for phone in compared.phones:
            if phone.phoneme in BILABIALS and phone.end_s is not None:
                axis.axvspan(phone.start_s, phone.end_s, color=_COLOURS["A"], alpha=0.35, zorder=0)
    save_picture(figure, output)
    plt.close(figure)


def _cue_blocks(cues: Sequence[MouthCue]) -> Iterable[Block]:
    """Yield (start in s, end in s, label, colour) of each mouth shape."""
    for cue in cues:
        start_s, end_s = cue.start_cs * CENTISECOND_S, cue.end_cs * CENTISECOND_S
        yield start_s, end_s, cue.shape, _COLOURS[cue.shape]


def _draw_blocks(axis: "Axes", blocks: Iterable[Block]) -> None:
    """Draw a row of labelled boxes, clipped to `SHOWN_S`; the label stands inside what is shown.

    A box without room for its label has none.
    """
    axis.set_ylim(0.0, 1.0)
    for start_s, end_s, label, colour in blocks:
        start_s, end_s = max(start_s, SHOWN_S[0]), min(end_s, SHOWN_S[1])
        if end_s - start_s < _NARROWEST_S:
            continue
        axis.barh(0.5, end_s - start_s, 1.0, start_s, color=colour, edgecolor="0.5", linewidth=0.6)
        if end_s - start_s < _ROOM_S * len(label):
            label = ""
        small = end_s - start_s < 2.0 * _ROOM_S * len(label)
        middle_s = (start_s + end_s) / 2.0
        axis.text(middle_s, 0.5, label, ha="center", va="center", fontsize=7 if small else 10)
