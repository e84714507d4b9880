"""The figures of `lipservo bench shapes`: when drawn mouths and our lips close for P, B and M."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lipservo.commands.run.exported_speech import SpokenSound
from lipsync.animpho.units import load_face_with_animphos
from lipsync.arrays import Array
from lipsync.export.lip_measures import lip_measures
from lipsync.export.mouth_cues import CENTISECOND_S, CLOSED_SHAPES, MouthCue
from lipsync.export.rhubarb_rules import rule_cues
from lipsync.export.shapes_of_motion import (
    lips_shut,
    motion_cues,
    sampling_times_s,
    shape_prototypes,
)
from lipsync.markers import CLOSED_GAP_MM
from lipsync.motion.closure_plan import BILABIALS
from lipsync.phonemes import SILENCE, PhonemeEvent

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


def compared_shapes(told: SpokenSound, heard: SpokenSound) -> ComparedShapes:
    """The methods on one sound. told: with its true phones; heard: by the recogniser."""
    phones, duration_s = tuple(told.events()), told.duration_s
    rules = rule_cues(phones, duration_s)
    at_burst = rule_cues(phones, duration_s, stops_at_burst=True)
    times_s = sampling_times_s(duration_s)
    motion, gap_mm = _drawn(told, times_s, duration_s)
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
    """When a mouth closes for P B M against the beginning of the phone; ms, late is positive.

    phones: how many; met: in how many the mouth is closed, 40 ms around; from an open mouth alone:
    median and 10th and 90th percentile of closings within 200 ms. None where there are none.
    """
    asked = [phone for phone in phones if phone.phoneme in BILABIALS]
    met = sum(any(_overlap(phone, interval) for interval in closed) for phone in asked)
    starts_s = np.array([start_s for start_s, _ in closed])
    errors_ms = []
    for before, phone in pairwise(phones):
        # After a pause or another closure the mouth may be closed already.
        if phone.phoneme in BILABIALS and before.phoneme not in (*BILABIALS, SILENCE):
            off_s = starts_s - phone.start_s
            if len(off_s) and abs(nearest := off_s[np.abs(off_s).argmin()]) <= _MATCHED_S:
                errors_ms.append(1e3 * float(nearest))
    figures: dict[str, float | int | None] = {"phones": len(asked), "met": met}
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
