"""Rendering of one sound file into one performance file."""

import time
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from lipservo.rendering.line_expression import line_expression
from lipservo.rendering.spoken_line import Script, spoken_line
from lipservo.runtime.servos.assembly import load_settings
from lipservo.runtime.speech.expression import check_expression
from lipsync.arrays import Array
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.expectation.expectation import read_expectation
from lipsync.expectation.soft_expectation import read_soft_expectation
from lipsync.face.model import open_model, read_face
from lipsync.offline.line_methods import Line, LineMethod, Speaker, line_synthesizer, shown_faces
from lipsync.offline.offline_model_file import load_offline_model
from lipsync.offline.performance import RATE_HZ, Performance, performed_sound, write_performance


@dataclass(frozen=True, slots=True)
class Rendering:
    """Options of rendering lines. strength: scale of the mouth's motion, 1 as the speaker's.

    model, offline: files of the face model and of its offline model; None: the shipped ones.
    includes_sound: whether the sound is stored in the file, or only its name and checksum.
    expression: the face, by name or YAML, whose head and eyes are stored too; None: none are.
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

    script: its phones or text, if known; how: options. Raises UserError with one line about a bad
    sound, script or model.
    """
    performance, done = rendered_line(sound, script, how)
    write_performance(performance, output)
    return replace(done, output=output)


def rendered_line(sound: Path, script: Script, how: Rendering) -> tuple[Performance, Rendered]:
    """Compute the performance of a sound (a line) without writing it; return it and its figures.

    The figures are those of `Rendered`; as there is no output file yet, `output` holds `sound`.
    script: the line's phones or text, if known; how: options. Raises UserError.
    """
    speaker = load_speaker(how.model, how.offline)
    line, heard_notes = spoken_line(sound, script)
    began_s = time.perf_counter()
    faces, notes = rendered_faces(speaker, line, how.method, how.strength)
    performance = Performance(
        speaker.face.checksum,
        faces.astype(np.float32),
        line.events,
        performed_sound(sound, included=how.includes_sound),
        how.method,
        {} if how.expression is None else line_expression(how.expression, line, len(faces)),
    )
    seconds = time.perf_counter() - began_s
    duration_s = len(line.samples) / SAMPLE_RATE_HZ
    all_notes = (*heard_notes, *notes)
    return performance, Rendered(sound, duration_s, len(line.events), seconds, all_notes)


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


def check_expression_of(face: str) -> None:
    """Raise SettingsError or ExpressionModelError now if the face's expression cannot be used."""
    check_expression(*load_settings(face))


@cache
def load_speaker(model: Path | None, offline: Path | None) -> Speaker:
    """Load the face model and the offline model from files, once per process; None: shipped ones.

    Raises ModelError, and OfflineModelError for an offline model that was made for another face.
    """
    with open_model(model) as file:
        face = read_face(file)
        expectation = read_expectation(file, face.n_components)
        soft = read_soft_expectation(file, face.n_components)
    found = load_offline_model(offline)
    found.check_face(face, str(offline or "the shipped offline model"))
    return Speaker(face, expectation, found, soft)
