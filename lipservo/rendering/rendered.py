"""Rendering of one sound file into one performance file."""

import hashlib
import json
import os
import time
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from importlib.metadata import version
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np

from lipservo.rendering.line_expression import line_expression
from lipservo.rendering.spoken_line import Script, spoken_line
from lipservo.runtime.servos.assembly import load_settings
from lipsync.arrays import Array
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.expectation.expectation import read_expectation
from lipsync.expectation.soft_expectation import read_soft_expectation
from lipsync.face.model import SHIPPED_MODEL, open_model, read_face
from lipsync.offline.line_methods import Line, LineMethod, Speaker, line_synthesizer, shown_faces
from lipsync.offline.offline_model_file import SHIPPED, load_offline_model
from lipsync.offline.performance import (
    RATE_HZ,
    Performance,
    PerformedSound,
    performed_sound,
    read_performance,
    sound_file,
    write_performance,
)


@dataclass(frozen=True, slots=True)
class Rendering:
    """Options of rendering lines.

    strength: scale of the mouth's motion, 1 as the recorded speaker's. method: how faces are made.
    model, offline: files of the face model and of its offline model; None: the shipped ones.
    includes_sound: whether the sound is stored in the performance file, or only its name and
    checksum. expression: the face, by name or YAML, by whose expression settings head and eyes are
    stored too; None: none are.
    """

    method: LineMethod
    strength: float = 1.0
    model: Path | None = None
    offline: Path | None = None
    includes_sound: bool = True
    expression: str | None = None


@dataclass(frozen=True, slots=True)
class Rendered:
    """What was rendered: the output file, duration_s of the sound, and n_phonemes in it.

    seconds: spent on computing; notes: cautions for a person.
    """

    output: Path
    duration_s: float
    n_phonemes: int
    seconds: float
    notes: tuple[str, ...]


def render(sound: Path, script: Script, output: Path, how: Rendering) -> Rendered:
    """Render a sound to the performance file `output`, whole or not at all; return its figures.

    script: the sound's phones or text, if known; how: options. Raises UserError with one line about
    a bad sound, script or model.
    """
    performance, rendered = rendered_line(sound, script, how)
    write_performance(performance, output)
    return replace(rendered, output=output)


def rendered_line(sound: Path, script: Script, how: Rendering) -> tuple[Performance, Rendered]:
    """Compute the performance of a sound (a line) without writing it; return it and its figures.

    As there is no output file yet, `output` of the figures holds `sound`. script: the line's phones
    or text, if known; how: options. Raises UserError, also if a file changed meanwhile.
    """
    labels = None if script.phones is None else script.phones.path
    files = (sound, labels, how.model, how.offline, how.expression)
    stamps = _stamps(*files)
    speaker = load_speaker(how.model, how.offline)
    line, line_notes = spoken_line(sound, script)
    began_s = time.perf_counter()
    faces, notes = rendered_faces(speaker, line, how.method, how.strength)
    performed = performed_sound(sound, included=how.includes_sound, channel=script.channel)
    performance = Performance(
        speaker.face.checksum,
        faces.astype(np.float32),
        line.events,
        performed,
        how.method,
        {} if how.expression is None else line_expression(how.expression, line, len(faces)),
        _origin(performed, script, how),
    )
    if _stamps(*files) != stamps:
        raise UserError(
            f"{sound}: it, its labels or a model changed while it was rendered; render it again"
        )
    seconds = time.perf_counter() - began_s
    duration_s = len(line.samples) / SAMPLE_RATE_HZ
    all_notes = (*line_notes, *notes)
    return performance, Rendered(sound, duration_s, len(line.events), seconds, all_notes)


def is_rendered(output: Path, sound: Path, script: Script, how: Rendering) -> bool:
    """Return whether `output` is the whole performance that rendering this line would give now.

    False if anything has changed on which the performance depends (the sound, the script, a model,
    an option, the version of lipservo), or if its content is missing or damaged.
    """
    try:
        performance = read_performance(output)
        if performance.origin != _origin(performed_sound(sound, included=False), script, how):
            return False
        if how.includes_sound:
            with sound_file(performance.sound, output):
                pass  # it compares the bytes with their checksum
    except (UserError, OSError):
        return False
    return True


def _origin(sound: PerformedSound, script: Script, how: Rendering) -> str:
    """Return a digest of all that the performance of a line depends on, as 64 hex digits.

    The sound counts by name and bytes, phones by their file's bytes, models by theirs.
    """
    phones: list[str] = []
    if script.phones is not None:
        labels = script.phones
        phones = [labels.path.suffix, labels.tier, labels.alphabet, _digest(labels.path)]
    facts = [
        [sound.name, sound.sha256],
        phones,
        [script.text, script.channel],
        _common_origin(how, *_stamps(how.model, how.offline, how.expression)),
    ]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


@lru_cache(maxsize=8)
def _common_origin(how: Rendering, *_stamps: tuple[int, ...]) -> list[object]:
    """Return what all lines with these options depend on: version, options, digests of models.

    It is computed once per process for equal options and unchanged files, as the models are loaded
    once, too.
    """
    models = resources.files("lipsync.models")
    expression = how.expression and load_settings(how.expression)[0].model_dump_json()
    return [
        version("lipservo"),
        [how.method, how.strength, how.includes_sound, expression],
        _digest(how.model or models / f"{SHIPPED_MODEL}.npz"),
        _digest(how.offline or models / f"{SHIPPED}.npz"),
    ]


def _stamps(*paths: Path | str | None) -> tuple[tuple[int, ...], ...]:
    """Return for each path at which there is a file what changes when that file is replaced."""
    stats = [os.stat(path) for path in paths if path and os.path.exists(path)]
    return tuple((each.st_mtime_ns, each.st_size, each.st_ino) for each in stats)


def _digest(place: Traversable) -> str:
    with place.open("rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def rendered_faces(
    speaker: Speaker, line: Line, method: LineMethod, strength: float = 1.0
) -> tuple[Array, tuple[str, ...]]:
    """Return the mouth's motion for a whole line of speech, made by the given method.

    Parameters
    ----------
    speaker : Speaker
        Models of the face and its speech.
    line : Line
        Sound and phones.
    method : LineMethod
        Method that makes the motion.
    strength : float
        Scale of the motion: 0 keeps the mouth closed, 1 moves as the speaker did.

    Returns
    -------
    tuple[Array, tuple[str, ...]]
        (n, n_components), 100 a second from 0 to the end of the sound, and notes.
    """
    synthesizer, notes = line_synthesizer(speaker, line, method, strength)
    n_frames = int(np.ceil(len(line.samples) / SAMPLE_RATE_HZ * RATE_HZ)) + 1
    return shown_faces(synthesizer, np.arange(n_frames) / RATE_HZ), tuple(notes)


def load_speaker(model: Path | None, offline: Path | None) -> Speaker:
    """Load the face model and the offline model, unless they are those loaded before.

    None: the shipped ones. Raises ModelError, and OfflineModelError for an offline model that was
    made for another face.
    """
    return _loaded_speaker(model, offline, *_stamps(model, offline))


@lru_cache(maxsize=2)
def _loaded_speaker(model: Path | None, offline: Path | None, *_stamps: tuple[int, ...]) -> Speaker:
    with open_model(model) as file:
        face = read_face(file)
        expectation = read_expectation(file, face.n_components)
        soft = read_soft_expectation(file, face.n_components)
    offline_model = load_offline_model(offline)
    offline_model.check_face(face, str(offline or "the shipped offline model"))
    return Speaker(face, expectation, offline_model, soft)
