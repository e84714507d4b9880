"""The text of an export file, from the phonemes and frames that `replay` computes for a sound."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from lipservo.rendering.spoken_sound import SpokenSound, spoken_sound
from lipservo.runtime.motion_options import (
    ChosenMotion,
)
from lipsync.animpho.units import load_face_with_animphos
from lipsync.export.arkit import ARKIT_NAMES, ArkitMap, lip_measures
from lipsync.export.mouth_cues import MouthCue, cues_json, cues_tsv, cues_xml, rule_cues
from lipsync.export.ovr_visemes import OVR_NAMES, viseme_weights
from lipsync.export.shapes_of_motion import (
    lips_shut,
    motion_cues,
    sampling_times_s,
    shape_prototypes,
)
from lipsync.export.weight_track import (
    WeightTrack,
    frame_times_s,
    live_link_csv,
    track_csv,
    track_lines,
)
from lipsync.face.model import load_face


@dataclass(frozen=True, slots=True)
class Exported:
    """The request for an export. ending: of the output file, lower case.

    phonemes: a TextGrid; None: they are recognised, following `text` unless it is empty.
    """

    file_format: Literal["rhubarb", "arkit", "ovr"]
    ending: str
    sound: Path
    phonemes: Path | None
    text: str
    shapes: Literal["motion", "rules"]
    rate_hz: float


def motion_shapes(spoken: SpokenSound) -> list[MouthCue]:
    """Return the mouth shapes, with their times, of the motion that the robot would show."""
    duration_s = spoken.duration_s
    model = load_face_with_animphos(spoken.model)
    measures = lip_measures(model)
    frames = spoken.frames(sampling_times_s(duration_s))
    faces = np.array([frame.coefficients for frame in frames])
    shut = lips_shut(measures, faces)
    return motion_cues(shape_prototypes(model, measures), faces, shut, duration_s)


def exported_text(
    request: Exported, chosen: ChosenMotion, config: str, model: Path | None
) -> tuple[str, dict[str, object]]:
    """Return the export file's text, and its duration, counts and the like by name.

    chosen: motion options typed. config: the face's name or YAML path. model: the face model's
    file; None: the shipped one. Raises UserError.
    """
    heard = spoken_sound(request.sound, request.phonemes, chosen, config, model)
    spoken = replace(heard, text=request.text)
    duration_s = spoken.duration_s
    if request.file_format == "rhubarb":
        is_motion = request.shapes == "motion"
        cues = motion_shapes(spoken) if is_motion else rule_cues(spoken.events(), duration_s)
        text = _cue_text(cues, request, duration_s)
        return text, {"duration_s": duration_s, "shapes": request.shapes, "n_cues": len(cues)}
    times_s = frame_times_s(duration_s, request.rate_hz)
    if request.file_format == "arkit":
        arkit = ArkitMap(lip_measures(load_face_with_animphos(model)))
        values = np.array([arkit.values(frame) for frame in spoken.frames(times_s)])
        names = ARKIT_NAMES
    else:
        values = viseme_weights(spoken.events(), times_s, load_face(model).tightest_s)
        names = OVR_NAMES
    track = WeightTrack(request.file_format, request.rate_hz, names, times_s, values)
    write = live_link_csv if track.kind == "arkit" else track_csv
    text = track_lines(track) if request.ending == ".jsonl" else write(track)
    return text, {"duration_s": duration_s, "rate_hz": request.rate_hz, "n_frames": len(times_s)}


def _cue_text(cues: Sequence[MouthCue], request: Exported, duration_s: float) -> str:
    if request.ending == ".tsv":
        return cues_tsv(cues)
    write = cues_json if request.ending == ".json" else cues_xml
    return write(cues, str(request.sound), duration_s)
