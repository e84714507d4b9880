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
    """One sound, drawn by each method. times_s, gap_mm: (n,), our lips, from the true phones.

    closed: by method, when its mouth is closed.
    """

    phones: tuple[PhonemeEvent, ...]
    duration_s: float
    rules: list[MouthCue]
    motion: list[MouthCue]
    times_s: Array
    gap_mm: Array
    closed: Mapping[str, list[Interval]]


def compared_shapes(from_text: SpokenSound, heard: SpokenSound) -> ComparedShapes:
    """Compare Rhubarb's rules and our motion on one sound.

    from_text: the sound with its true phones; heard: with those of the recogniser.
    """
    phones, duration_s = tuple(from_text.events()), from_text.duration_s
    rules = rule_cues(phones, duration_s)
    at_burst = rule_cues(phones, duration_s, stops_at_burst=True)
    times_s = sampling_times_s(duration_s)
    motion, gap_mm = _drawn(from_text, times_s, duration_s)
    motion_heard, gap_heard_mm = _drawn(heard, times_s, duration_s)
    closed = {
        "Rhubarb's rules, true phones": _closed_cues(rules),
        "the same, stops labelled at the burst": _closed_cues(at_burst),
        "our lips, true phones": _closed_lips(times_s, gap_mm),
        "our shapes, true phones": _closed_cues(motion),
        "our lips, from the sound": _closed_lips(times_s, gap_heard_mm),
        "our shapes, from the sound": _closed_cues(motion_heard),
    }
    return ComparedShapes(phones, duration_s, rules, motion, times_s, gap_mm, closed)


def closing_figures(
    phones: Sequence[PhonemeEvent], closed: Sequence[Interval]
) -> dict[str, float | int | None]:
    """Return how much later than the phone a mouth closes for P, B and M, in ms.

    phones: their number; closed: in how many the mouth is closed, 40 ms around. Median and 10th and
    90th percentile are of closings from an open mouth within 200 ms; None where there are none.
    """
    bilabials = [phone for phone in phones if phone.phoneme in BILABIALS]
    n_closed = sum(any(_overlap(phone, interval) for interval in closed) for phone in bilabials)
    starts_s = np.array([start_s for start_s, _ in closed])
    errors_ms = []
    for before, phone in pairwise(phones):
        # After a pause or another closure the mouth may be closed already.
        if phone.phoneme in BILABIALS and before.phoneme not in (*BILABIALS, SILENCE):
            off_s = starts_s - phone.start_s
            if len(off_s) and abs(nearest := off_s[np.abs(off_s).argmin()]) <= _MATCHED_S:
                errors_ms.append(1e3 * float(nearest))
    figures: dict[str, float | int | None] = {"phones": len(bilabials), "met": n_closed}
    names = ("p10_ms", "median_ms", "p90_ms")
    values = np.percentile(errors_ms, [10, 50, 90]) if errors_ms else [None] * 3
    return figures | {
        name: None if value is None else round(float(value), 1)
        for name, value in zip(names, values, strict=True)
    }


def _overlap(phone: PhonemeEvent, interval: Interval) -> bool:
    end_s = phone.start_s if phone.end_s is None else phone.end_s
    return interval[0] < end_s + _AROUND_S and interval[1] > phone.start_s - _AROUND_S


def _drawn(spoken: SpokenSound, times_s: Array, duration_s: float) -> tuple[list[MouthCue], Array]:
    """The shapes of the motion, and the lip gap (n,)."""
    model = load_face_with_animphos(spoken.model)
    measures = lip_measures(model)
    faces = np.array([frame.coefficients for frame in spoken.frames(times_s)])
    prototypes = shape_prototypes(model, measures)
    cues = motion_cues(prototypes, faces, lips_shut(measures, faces), duration_s)
    return cues, model.lip_gaps_mm(model.markers_mm(faces))


def _closed_cues(cues: Sequence[MouthCue]) -> list[Interval]:
    """Stretches of closed shapes; A and X that follow each other are one."""
    found: list[Interval] = []
    for cue in cues:
        if cue.shape in CLOSED_SHAPES:
            start_s, end_s = cue.start_cs * CENTISECOND_S, cue.end_cs * CENTISECOND_S
            if found and found[-1][1] == start_s:
                start_s = found.pop()[0]
            found.append((start_s, end_s))
    return found


def _closed_lips(times_s: Array, gap_mm: Array) -> list[Interval]:
    """Stretches in which the lips are as near as recorded closures."""
    is_closed = np.concatenate([[False], gap_mm <= CLOSED_GAP_MM, [False]])
    edges = np.flatnonzero(np.diff(is_closed.astype(np.int8)))
    ends_s = np.append(times_s, times_s[-1] + CENTISECOND_S)
    return [
        (float(ends_s[a]), float(ends_s[b])) for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]


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
    """Draw waveform, true phones, Rhubarb's shapes, our shapes and lip gap, one below the other."""
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
    _draw_blocks(axes[2], _blocks(compared.rules))
    _draw_blocks(axes[3], _blocks(compared.motion))
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


def _blocks(cues: Sequence[MouthCue]) -> Iterable[Block]:
    for cue in cues:
        start_s, end_s = cue.start_cs * CENTISECOND_S, cue.end_cs * CENTISECOND_S
        yield start_s, end_s, cue.shape, _COLOURS[cue.shape]


def _draw_blocks(axis: "Axes", blocks: Iterable[Block]) -> None:
    """Draw boxes with a word in each; a box that the picture cuts off keeps its word inside."""
    axis.set_ylim(0.0, 1.0)
    for start_s, end_s, word, colour in blocks:
        start_s, end_s = max(start_s, SHOWN_S[0]), min(end_s, SHOWN_S[1])
        if end_s - start_s < _NARROWEST_S:
            continue
        axis.barh(0.5, end_s - start_s, 1.0, start_s, color=colour, edgecolor="0.5", linewidth=0.6)
        if end_s - start_s < _ROOM_S * len(word):
            word = ""
        small = end_s - start_s < 2.0 * _ROOM_S * len(word)
        middle_s = (start_s + end_s) / 2.0
        axis.text(middle_s, 0.5, word, ha="center", va="center", fontsize=7 if small else 10)
