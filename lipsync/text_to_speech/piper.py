"""Piper, a neural voice: the extra `piper` and a model, NAME.onnx with NAME.onnx.json beside it.

It loads a model in a second or two, so it has a process of its own, which keeps the model that
spoke last. Its phonemes are returned without the times that its network planned for them, to
be found in the sound: P B M begin 34 ms before their planned times (docs/benchmarks.md). Why it is
not imported into the face: docs/decisions/speech-out.md.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from lipsync.alphabets import IPA, in_inventory
from lipsync.errors import MissingExtraError, check_extra
from lipsync.ipa import ipa_table
from lipsync.spoken_text import SpokenUnit
from lipsync.text_to_speech.command_voice import speech_of
from lipsync.text_to_speech.synthesis import (
    DEFAULT_VOICE,
    SynthesisError,
    SynthesizedSpeech,
    Voice,
    checked_text,
)
from lipsync.text_to_speech.voice_process import Request, VoiceProcess, serve

_RATES_WPM = range(80, 401)


class Piper:
    """The speech `Synthesizer` Piper; the name of a voice is the path of its model.

    Raises SynthesisError where Piper is not installed.
    """

    longest_text = 2000

    def __init__(self) -> None:
        try:
            check_extra("piper", "speaking by Piper")
        except MissingExtraError as error:
            raise SynthesisError(str(error)) from None
        self._process = _process()

    def languages(self) -> tuple[str, ...]:
        """Return an empty tuple: the model determines the language."""
        return ()

    def voices(self) -> tuple[str, ...]:
        """Return an empty tuple: any model can be a voice."""
        return ()

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SynthesizedSpeech:
        """Return a text's speech and its phonemes, without times. Raises SynthesisError.

        `[[` and `]]`, Piper's marks of phonemes, are read as text.
        """
        written = checked_text(text, self.longest_text).replace("[[", "[ [")
        if not Path(voice.name).is_file():
            raise SynthesisError(
                f"Piper's model {voice.name!r} does not exist; write its path as `sound: "
                f"{{synthesizer: piper, voice: NAME.onnx}}` in the face's YAML"
            )
        if voice.rate_wpm not in _RATES_WPM or voice.pitch != DEFAULT_VOICE.pitch:
            raise SynthesisError("Piper speaks 80 to 400 words a minute, and only at pitch 50")
        answer, sound = self._process.request(
            {
                "text": written,
                "model": voice.name,
                "language": voice.language,
                "stretch": DEFAULT_VOICE.rate_wpm / voice.rate_wpm,
            }
        )
        speech = speech_of(sound, answer["sample_rate_hz"], written, "")
        letters = [SpokenUnit(each) for each in join_ipa(answer["phonemes"])]
        units = in_inventory("phoneme", letters, IPA, speech.sample_rate_hz)
        return replace(speech, units=units) if units.units else speech


@cache
def _process() -> VoiceProcess:
    return VoiceProcess(__name__, "Piper crashes or hangs at this text, or with this model")


@lru_cache(maxsize=1)
def _load_model(model: str) -> Any:
    """Return the voice of a model's file; only the last one stays in memory."""
    from piper import PiperVoice

    return PiperVoice.load(model)


def _speak(request: Request) -> tuple[dict[str, object], bytes]:
    """Speak a request's text by its model; return rate and phonemes, and int16 sound as bytes.

    Raises SynthesisError if the model cannot be loaded or does not speak the request's language.
    """
    from piper import SynthesisConfig

    try:
        voice = _load_model(request["model"])
    except Exception as error:  # whatever onnxruntime, onnx and the model's JSON may raise
        line = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
        raise SynthesisError(f"{request['model']} cannot be loaded by Piper: {line}") from None
    spoken, wanted = voice.config.espeak_voice, request["language"]
    if wanted not in (DEFAULT_VOICE.language, spoken):
        raise SynthesisError(f"{request['model']} only speaks {spoken!r}, not {wanted!r}")
    stretch = SynthesisConfig(length_scale=voice.config.length_scale * request["stretch"])
    chunks = list(voice.synthesize(request["text"], stretch))
    sound = b"".join(chunk.audio_int16_bytes for chunk in chunks)
    phonemes = [each for chunk in chunks for each in chunk.phonemes]
    return {"sample_rate_hz": voice.config.sample_rate, "phonemes": phonemes}, sound


def join_ipa(letters: Sequence[str]) -> list[str]:
    """Return IPA letters, the two of each diphthong or affricate joined to one phoneme."""
    phonemes: list[str] = []
    for letter in letters:
        if phonemes and phonemes[-1] + letter in ipa_table():
            phonemes[-1] += letter
        else:
            phonemes.append(letter)
    return phonemes


if __name__ == "__main__":
    serve(_speak)
