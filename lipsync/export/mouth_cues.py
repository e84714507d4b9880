"""Mouth shapes of cartoons, named and written as Rhubarb Lip Sync does.

Shapes and file formats: the README of Rhubarb Lip Sync 1.13
(https://github.com/DanielSWolf/rhubarb-lip-sync), sections "Mouth shapes" and "Output formats".
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal
from xml.sax.saxutils import escape

Shape = Literal["A", "B", "C", "D", "E", "F", "G", "H", "X"]

#: A closed lips of P B M; B slightly open; C open; D wide open; E slightly rounded; F puckered;
#: G teeth on the lower lip; H tongue raised, for a long L; X at rest.
SHAPES: tuple[Shape, ...] = ("A", "B", "C", "D", "E", "F", "G", "H", "X")
CLOSED_SHAPES: tuple[Shape, ...] = ("A", "X")
#: Rhubarb's times are whole hundredths of a second.
CENTISECOND_S = 0.01


@dataclass(frozen=True, slots=True)
class MouthCue:
    """One mouth shape, shown from `start_cs` to `end_cs`: hundredths of a second of sound time."""

    shape: Shape
    start_cs: int
    end_cs: int


def centiseconds(time_s: float) -> int:
    """The nearest hundredth of a second."""
    return round(time_s / CENTISECOND_S)


def joined(cues: Iterable[MouthCue]) -> list[MouthCue]:
    """The same shapes in the same order, neighbours of one shape made one, empty ones left out."""
    found: list[MouthCue] = []
    for cue in cues:
        if cue.end_cs <= cue.start_cs:
            continue
        if found and found[-1].shape == cue.shape:
            cue = MouthCue(cue.shape, found.pop().start_cs, cue.end_cs)
        found.append(cue)
    return found


def overwritten(cues: Sequence[MouthCue], new: MouthCue) -> list[MouthCue]:
    """The cues with `new` in place of whatever lay there."""
    before = [MouthCue(c.shape, c.start_cs, min(c.end_cs, new.start_cs)) for c in cues]
    after = [MouthCue(c.shape, max(c.start_cs, new.end_cs), c.end_cs) for c in cues]
    return joined([*(c for c in before if c.end_cs > c.start_cs), new, *after])


def cues_tsv(cues: Sequence[MouthCue]) -> str:
    """A line a cue, `start TAB shape`; the last line is the end of the sound, with a closed mouth.

    Raises ValueError for no cues.
    """
    if not cues:
        raise ValueError("no mouth cues")
    lines = [f"{_seconds(cue.start_cs)}\t{cue.shape}\n" for cue in cues]
    return "".join(lines) + f"{_seconds(cues[-1].end_cs)}\tX\n"


def cues_json(cues: Sequence[MouthCue], sound_name: str, duration_s: float) -> str:
    """`metadata` and `mouthCues`, a cue a line."""
    rows = (
        f'    {{ "start": {_seconds(cue.start_cs)}, "end": {_seconds(cue.end_cs)}, '
        f'"value": "{cue.shape}" }}'
        for cue in cues
    )
    return (
        '{\n  "metadata": {\n'
        f'    "soundFile": {json.dumps(sound_name)},\n'
        f'    "duration": {_truncated(duration_s)}\n'
        '  },\n  "mouthCues": [\n' + ",\n".join(rows) + "\n  ]\n}\n"
    )


def cues_xml(cues: Sequence[MouthCue], sound_name: str, duration_s: float) -> str:
    """`rhubarbResult` with `metadata` and `mouthCues`."""
    rows = "".join(
        f'    <mouthCue start="{_seconds(cue.start_cs)}" end="{_seconds(cue.end_cs)}">'
        f"{cue.shape}</mouthCue>\n"
        for cue in cues
    )
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<rhubarbResult>\n  <metadata>\n'
        f"    <soundFile>{escape(sound_name)}</soundFile>\n"
        f"    <duration>{_truncated(duration_s)}</duration>\n"
        f"  </metadata>\n  <mouthCues>\n{rows}  </mouthCues>\n</rhubarbResult>\n"
    )


def _seconds(time_cs: int) -> str:
    return f"{time_cs // 100}.{time_cs % 100:02d}"


def _truncated(duration_s: float) -> str:
    # Half a nanosecond of grace, or 0.29 s would be cut to 0.28.
    return _seconds(int((duration_s + 5e-10) / CENTISECOND_S))
