"""The text of an export file, from the phonemes and frames that `replay` computes for a sound.

It is computed as it is written: a sound of hours needs little more memory than one of a minute.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from lipservo.rendering.spoken_sound import SpokenSound, spoken_sound
from lipservo.runtime.motion_options import ChosenMotion
from lipservo.settings.motion_names import ON_STAGE
from lipsync.animpho.units import load_face_with_animphos
from lipsync.arrays import Array
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
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phonemes import PhonemeEvent

_ROWS_AT_ONCE = 4096


@dataclass(frozen=True, slots=True)
class Exported:
    """The request for an export. ending: of the output file, lower case.

    phonemes: labels; None: they are recognised, following `text` unless it is empty.
    channel: the one that is heard; "": the face's.
    """

    file_format: Literal["rhubarb", "arkit", "ovr"]
    ending: str
    sound: Path
    phonemes: LabelFile | None
    text: str
    shapes: Literal["motion", "rules"]
    rate_hz: float
    channel: str = ""


def motion_shapes(spoken: SpokenSound) -> list[MouthCue]:
    """Return the mouth shapes, with their times, of the motion that the robot would show."""
    duration_s = spoken.duration_s
    model = load_face_with_animphos(spoken.model)
    measures = lip_measures(model)
    times_s = sampling_times_s(duration_s)
    faces = np.zeros((len(times_s), model.n_components))
    for n, frame in enumerate(spoken.frames(times_s)):
        faces[n] = frame.coefficients
    shut = lips_shut(measures, faces)
    return motion_cues(shape_prototypes(model, measures), faces, shut, duration_s)


def exported_text(
    request: Exported, chosen: ChosenMotion, config: str, model: Path | None
) -> tuple[Iterable[str], dict[str, object]]:
    """Return the export file's text in pieces, and its duration, counts and the like by name.

    chosen: motion options typed. config: the face's name or YAML path. model: the face model's
    file; None: the shipped one. Raises UserError.
    """
    heard = spoken_sound(request.sound, request.phonemes, chosen, config, model, ON_STAGE)
    spoken = replace(heard, text=request.text, channel=request.channel or heard.channel)
    duration_s = spoken.duration_s
    if request.file_format == "rhubarb":
        is_motion = request.shapes == "motion"
        cues = motion_shapes(spoken) if is_motion else rule_cues(spoken.events(), duration_s)
        whole = _cue_text(cues, request, duration_s)
        return [whole], {"duration_s": duration_s, "shapes": request.shapes, "n_cues": len(cues)}
    times_s = frame_times_s(duration_s, request.rate_hz)
    values: Iterable[Array]
    if request.file_format == "arkit":
        arkit = ArkitMap(lip_measures(load_face_with_animphos(model)))
        values = map(arkit.values, spoken.frames(times_s))
        names = ARKIT_NAMES
    else:
        values = _visemes(spoken.events(), times_s, load_face(model).tightest_s)
        names = OVR_NAMES
    track = WeightTrack(request.file_format, request.rate_hz, names, times_s, values)
    write = live_link_csv if track.kind == "arkit" else track_csv
    text = track_lines(track) if request.ending == ".jsonl" else write(track)
    return text, {"duration_s": duration_s, "rate_hz": request.rate_hz, "n_frames": len(times_s)}


def _visemes(events: Sequence[PhonemeEvent], times_s: Array, tightest_s: Array) -> Iterator[Array]:
    """Yield the rows of `viseme_weights`, computed for a minute or so at a time."""
    for i in range(0, len(times_s), _ROWS_AT_ONCE):
        yield from viseme_weights(events, times_s[i : i + _ROWS_AT_ONCE], tightest_s)


def _cue_text(cues: Sequence[MouthCue], request: Exported, duration_s: float) -> str:
    if request.ending == ".tsv":
        return cues_tsv(cues)
    write = cues_json if request.ending == ".json" else cues_xml
    return write(cues, str(request.sound), duration_s)
