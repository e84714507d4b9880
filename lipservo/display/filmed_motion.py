"""The motion of a film, one frame per picture, from a sound, a text, a performance or a trace."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import soundfile

from lipservo.display.film import is_file, named_file
from lipservo.rendering.line_expression import line_expression
from lipservo.rendering.spoken_sound import SpokenSound, labels_of
from lipservo.runtime.motion_options import MotionOptions
from lipservo.runtime.servos.assembly import load_settings
from lipservo.runtime.sound import speaker_of, voice_of
from lipservo.traces.trace_file import read_trace
from lipsync.arrays import Array
from lipsync.audio.file import checked_sound, read_speech
from lipsync.errors import UserError
from lipsync.face.frame import DRAWN_MOUTH, Expression, Frame
from lipsync.face.model import load_face
from lipsync.offline.line_methods import Line
from lipsync.offline.performance import RATE_HZ, SUFFIX, Performance, read_performance, sound_file
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.text_to_speech.synthesis import SynthesizedSpeech
from lipsync.text_to_speech.synthesizers import speak_in_pieces, synthesizer_for
from lipsync.textgrid import write_tiers

#: The longest film; a picture is held at a time, but its motion as a whole.
LONGEST_FILM_S = 600.0


@dataclass(frozen=True, slots=True)
class FilmedMotion:
    """A motion to film: one frame per picture, frame n at n / rate s of sound time.

    sound: the sound file; None: a silent film. servos, sent_deg (n, n_servos): the goals that a
    traced run sent to its servos; else (), None. heard: how a sound or text was heard; else None.
    """

    frames: tuple[Frame, ...]
    sound: Path | None
    servos: tuple[str, ...] = ()
    sent_deg: Array | None = None
    heard: "SpeechRequest | None" = None


@dataclass(frozen=True, slots=True)
class SpeechRequest:
    """What is known of the words of a sound, and the options by which it becomes motion.

    config, model: the face's YAML and face model, None: the default one. script: labels; text: the
    words of the sound; with neither the recogniser finds the phonemes. head: name of the face by
    whose expression settings head and eyes move; None: they are still. channel: the sound channel
    that moves the mouth; all are in the film.
    """

    motion: MotionOptions
    config: str
    model: Path | None
    script: LabelFile | None = None
    text: str = ""
    head: str | None = None
    channel: str = ""


@contextmanager
def filmed(speech: str, request: SpeechRequest, rate_hz: int) -> Iterator[FilmedMotion]:
    """Yield the motion of `speech`: a sound file, a performance, or a text to synthesise.

    The sound file exists until the `with` block ends. rate_hz: pictures a second. Raises UserError.
    """
    with ExitStack() as stack:
        path = Path(speech)
        if path.suffix == SUFFIX:
            performance = read_performance(path)
            performance.check_face(load_face(request.model), speech)
            sound = stack.enter_context(sound_file(performance.sound, path))
            yield FilmedMotion(_frames_of_performance(performance, rate_hz), sound)
            return
        if not is_file(path):
            if named_file(speech) is not None:
                raise UserError(f"{speech}: no such file; give a sound, or a text in quotes")
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="lipservo-")))
            path, script = _synthesise_text(speech, request.config, folder)
            labels = None if script is None else LabelFile(script, "phones")
            text = "" if script else speech
            request = replace(request, script=labels, text=text, channel="")
        yield FilmedMotion(_frames_of_sound(path, request, rate_hz), path, heard=request)


def filmed_trace(trace: Path, sound: Path | None, model: Path | None, rate_hz: int) -> FilmedMotion:
    """Return the motion of a traced run from sound time 0 to the end of `sound`, or of the trace.

    sound: the sound file; None: the film is silent, and as long as the trace. Raises TraceError,
    UserError.
    """
    run = read_trace(trace)
    face = load_face(model)
    if run.model != face.checksum:
        raise UserError(
            f"{trace}: made with face model {run.model}, not {face.checksum}; give its --model"
        )
    end_s = float(run.sound_s[-1]) if sound is None else checked_sound(sound).duration_s
    times_s = _times_s(end_s, rate_hz)

    def interpolated(values: Array) -> Array:
        return np.stack([np.interp(times_s, run.sound_s, each) for each in values.T], axis=1)

    frames = tuple(map(Frame, times_s.tolist(), interpolated(run.coefficients)))
    return FilmedMotion(frames, sound, run.servos, interpolated(run.sent_deg))


def _times_s(duration_s: float, rate_hz: int) -> Array:
    """Return the sound time of each picture, (n,) s. Raises UserError for over 10 minutes."""
    if duration_s > LONGEST_FILM_S:
        raise UserError(f"{duration_s:.0f} s of sound: too long; cut it to {LONGEST_FILM_S:.0f} s")
    return np.arange(max(1, int(np.ceil(duration_s * rate_hz)))) / rate_hz


def _frames_of_performance(performance: Performance, rate_hz: int) -> tuple[Frame, ...]:
    """Return the frames of a performance, interpolated to `rate_hz` pictures a second."""
    times_s = _times_s(performance.duration_s, rate_hz)
    known_s = np.arange(len(performance.coefficients)) / RATE_HZ
    columns = [np.interp(times_s, known_s, column) for column in performance.coefficients.T]
    tracks = {
        name: np.interp(times_s, known_s, values) for name, values in performance.expression.items()
    }
    return _joined_frames(times_s, np.stack(columns, axis=1), tracks)


def _frames_of_sound(path: Path, request: SpeechRequest, rate_hz: int) -> tuple[Frame, ...]:
    """Return the frames of a sound file, with `rate_hz` pictures a second.

    Phonemes are those of the request's script or text, else recognised. Head and eyes move, and the
    line has an expression, if the request names a head.
    """
    labels = labels_of(path, request.script)
    spoken = SpokenSound(
        path, labels, request.motion, request.config, request.model, request.text, request.channel
    )
    times_s = _times_s(spoken.duration_s, rate_hz)
    frames = tuple(spoken.frames(times_s))
    if request.head is None:
        return frames
    n_known = int(np.ceil(spoken.duration_s * RATE_HZ)) + 1
    line = Line(tuple(spoken.events()), read_speech(path, request.channel))
    known_s = np.arange(n_known) / RATE_HZ
    tracks = {
        name: np.interp(times_s, known_s, values)
        for name, values in line_expression(request.head, line, n_known).items()
    }
    for name in DRAWN_MOUTH:
        tracks[name] = np.array([getattr(frame.expression, name) or 0.0 for frame in frames])
    return _joined_frames(times_s, np.stack([frame.coefficients for frame in frames]), tracks)


def _joined_frames(times_s: Array, faces: Array, tracks: dict[str, Array]) -> tuple[Frame, ...]:
    """Return a frame for each time, with its face and expression.

    times_s: (n,) seconds of sound time; faces: (n, n_components); tracks: (n,) by name, of which
    only fields of `Expression` are used.
    """
    known = {each.name for each in fields(Expression)} & set(tracks)
    return tuple(
        Frame(
            float(time_s),
            faces[n].astype(np.float64),
            Expression(**{name: float(tracks[name][n]) for name in known}),
        )
        for n, time_s in enumerate(times_s)
    )


def _synthesise_text(text: str, config: str, folder: Path) -> tuple[Path, Path | None]:
    """Synthesise a text by the face's voice into `folder`; return the sound file and a TextGrid.

    The TextGrid of the phonemes is None if the voice does not report them.
    """
    settings, folder_of_yaml = load_settings(config)
    speaker = speaker_of(settings.sound, folder_of_yaml)
    synthesizer = synthesizer_for(speaker.synthesizer)
    sentences = list(speak_in_pieces(synthesizer, text, voice_of(speaker)))
    rate_hz = sentences[0].sample_rate_hz
    sound = folder / "spoken.wav"
    soundfile.write(sound, np.concatenate([each.samples for each in sentences]), rate_hz)
    if not all(each.phonemes for each in sentences):
        return sound, None
    script = folder / "spoken.TextGrid"
    write_tiers(script, {"phones": tuple(_joined_phonemes(sentences))})
    return sound, script


def _joined_phonemes(sentences: Sequence[SynthesizedSpeech]) -> Iterator[tuple[str, float, float]]:
    """Yield (phoneme, start s, end s) of sentences that follow one another, from 0 s on."""
    begins_s = 0.0
    for sentence in sentences:
        for event in sentence.phonemes:
            end_s = sentence.duration_s if event.end_s is None else event.end_s
            yield event.phoneme, begins_s + event.start_s, begins_s + end_s
        begins_s += sentence.duration_s
