"""A robot's own voice: any program that reads a text and writes a WAV file.

`sound: {synthesizer: command, voice: "my-tts --out {wav}"}` in a face's YAML. The text of a
sentence goes to the program's standard input in UTF-8; it writes the sound to `{wav}`, or to its
standard output where the command does not name it. A program that knows times writes them to
`{words}`, in any of the forms of docs/text.md. The command runs without a shell; for one, write
`sh -c '...'`.
"""

import shlex
import subprocess
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import soundfile

from lipsync.audio.file import Levels, open_sound
from lipsync.audio.source import SoundError
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.reader import labels_in
from lipsync.spoken_text import SpokenText, SpokenTextError, SpokenUnit
from lipsync.text_to_speech.synthesis import (
    DEFAULT_VOICE,
    SynthesisError,
    SynthesizedSpeech,
    UnspeakableTextError,
    Voice,
    checked_text,
)
from lipsync.text_to_speech.voice_process import LONGEST_S, Request, VoiceProcess, serve
from lipsync.textgrid import LabelError

_WAV, _WORDS, _LANGUAGE = "{wav}", "{words}", "{language}"
#: Of the file of times of a sentence.
_LARGEST_WORDS_BYTES: Final = 1 << 20
_FULL_SCALE: Final = 32768.0


class CommandVoice:
    """The speech `Synthesizer` that runs a program for each text; its voice names are commands."""

    longest_text = 5000

    def __init__(self) -> None:
        self._process = _process()

    def languages(self) -> tuple[str, ...]:
        """Return an empty tuple: the program determines the language."""
        return ()

    def voices(self) -> tuple[str, ...]:
        """Return an empty tuple: any program can be a voice."""
        return ()

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SynthesizedSpeech:
        """Return the speech that the voice's command makes of a text. Raises SynthesisError.

        Where the command gives no phoneme times, the result has `units` in place of phonemes.
        """
        written = checked_text(text, self.longest_text)
        _check_voice(voice)
        answer, sound = self._process.request(
            {"text": written, "command": voice.name, "language": voice.language}
        )
        return speech_of(sound, answer["sample_rate_hz"], written, answer["words"])


def speech_of(sound: bytes, sample_rate_hz: int, text: str, words: str) -> SynthesizedSpeech:
    """Return the speech with `text` and int16 samples as bytes, timed by `words`.

    words: JSON as in docs/text.md, or "" for no times. Raises SynthesisError for words that cannot
    be used, or end long after the sound, UnspeakableTextError for no sound.
    """
    samples = np.frombuffer(sound, np.int16).astype(np.float32) / np.float32(_FULL_SCALE)
    if not len(samples):
        raise UnspeakableTextError(f"{text[:40]!r} made no sound; write words")
    text_units = SpokenText("text", (SpokenUnit(text, 0),), sample_rate_hz)
    speech = SynthesizedSpeech(samples, sample_rate_hz, (), (), units=text_units)
    if not words.strip():
        return speech
    try:
        labels = labels_in(words.encode(), LabelFile(Path(_WORDS)), end_s := speech.duration_s)
        if labels.phones:
            phones = (each for each in labels.phones if each.start_s < end_s)
            cut = tuple(replace(each, end_s=min(each.end_s or end_s, end_s)) for each in phones)
            return replace(speech, phonemes=cut, units=None)
        units = tuple(
            SpokenUnit(unit.label, round(unit.start_s * sample_rate_hz)) for unit in labels.words
        )
        return replace(speech, units=SpokenText("word", units, sample_rate_hz))
    except (LabelError, SpokenTextError) as error:
        raise SynthesisError(str(error)) from None


def _check_voice(voice: Voice) -> None:
    """Raise SynthesisError for a voice without a usable command, or with its own rate or pitch.

    A language other than the default is refused unless the command has `{language}`.
    """
    if not voice.name.strip():
        raise SynthesisError(
            'the voice has no command; write it as `sound: {synthesizer: command, voice: "my-tts '
            "--out {wav}\"}` in the face's YAML"
        )
    if (voice.rate_wpm, voice.pitch) != (DEFAULT_VOICE.rate_wpm, DEFAULT_VOICE.pitch):
        raise SynthesisError("give rate and pitch as options in the voice's own command")
    if voice.language != DEFAULT_VOICE.language and _LANGUAGE not in voice.name:
        raise SynthesisError(
            f"`sound: {{voice: ...}}` in the face's YAML is a command without {_LANGUAGE}, so it "
            f"cannot be told to speak {voice.language!r}; write {_LANGUAGE} into it"
        )
    try:
        shlex.split(voice.name)
    except ValueError as error:
        raise SynthesisError(f"the voice's command cannot be read: {error}") from None


@cache
def _process() -> VoiceProcess:
    return VoiceProcess(
        __name__,
        f"the voice's command took longer than {LONGEST_S:g} s for a sentence; it was ended",
    )


def _run_command(request: Request) -> tuple[dict[str, object], bytes]:
    """Run the command of a request; return its sample rate and words, and its int16 sound as bytes.

    Raises SynthesisError if the command fails or its output cannot be used.
    """
    with tempfile.TemporaryDirectory(prefix="lipservo-voice-") as folder:
        wav, words = Path(folder) / "sound.wav", Path(folder) / "words.json"
        values = {_WAV: str(wav), _WORDS: str(words), _LANGUAGE: request["language"]}
        arguments = shlex.split(request["command"])
        for name, value in values.items():
            arguments = [argument.replace(name, value) for argument in arguments]
        printed_path = wav if _WAV not in request["command"] else Path(folder) / "printed"
        errors_path = Path(folder) / "complaints"
        with printed_path.open("wb") as out, errors_path.open("wb") as errors:
            try:
                done = subprocess.run(
                    arguments,
                    input=request["text"].encode(),
                    stdout=out,
                    stderr=errors,
                    check=False,
                )
            except (OSError, ValueError) as error:
                raise SynthesisError(f"the voice's command cannot be run: {error}") from None
        if done.returncode != 0:
            raise SynthesisError(
                f"the voice's command {arguments[0]} failed with status {done.returncode}"
                f"{_last_line(errors_path)}"
            )
        return _read_outputs(wav, words)


def _read_outputs(wav: Path, words: Path) -> tuple[dict[str, object], bytes]:
    """Return the command's sample rate and words, and its sound, mono int16, as bytes.

    words: the file of times, which may be missing. Raises SynthesisError if there is no sound, or
    none that is allowed, or the file of times is larger than 1 MB.
    """
    try:
        with open_sound(wav) as sound:
            sample_rate_hz, subtype = sound.samplerate, sound.subtype
            samples = sound.read(dtype="float32", always_2d=True)
    except (SoundError, soundfile.LibsndfileError, RuntimeError, OSError) as error:
        raise SynthesisError(
            f"the voice's command wrote no sound that can be used to {_WAV} or its output ({error})"
        ) from None
    file_bytes = words.read_bytes()[: _LARGEST_WORDS_BYTES + 1] if words.is_file() else b""
    if len(file_bytes) > _LARGEST_WORDS_BYTES:
        raise SynthesisError(f"the voice's command wrote more than 1 MB to {_WORDS}")
    levels = Levels()
    levels.add(samples := np.nan_to_num(samples, posinf=1.0, neginf=-1.0))
    mix, _ = levels.mix(subtype)
    mono = np.rint(mix.mono(samples) * (_FULL_SCALE - 1.0)).astype(np.int16)
    return {
        "sample_rate_hz": int(sample_rate_hz),
        "words": file_bytes.decode("utf-8", "replace"),
    }, mono.tobytes()


def _last_line(complaints: Path) -> str:
    """Return the last line of a command's standard error, after ": "; "" if it is empty."""
    lines = complaints.read_bytes()[-2000:].decode("utf-8", "replace").strip().splitlines()
    return f": {lines[-1][:160]}" if lines else ""


if __name__ == "__main__":
    serve(_run_command)
