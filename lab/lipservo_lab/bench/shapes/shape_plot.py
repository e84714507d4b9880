"""The picture of `lipservo bench shapes`; needs matplotlib, the extra `plots`."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.bench.shapes.shape_figures import ComparedShapes
from lipsync.audio.file import read_sound
from lipsync.export.mouth_cues import CENTISECOND_S, MouthCue
from lipsync.markers import CLOSED_GAP_MM
from lipsync.motion.closure_plan import BILABIALS
from lipsync.phonemes import SILENCE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    """Waveform, true phones, Rhubarb's shapes, our shapes, our lip gap, one below the other."""
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
    """Boxes with a word in each; those that the picture cuts off keep theirs inside it."""
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
