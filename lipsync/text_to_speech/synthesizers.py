"""Speech synthesisers by name, and long texts spoken sentence by sentence."""

from collections.abc import Iterator

from lipsync.audio.playout_stream import MOST_WAITING_S
from lipsync.plugins import DEFAULT_SYNTHESIZER, SYNTHESIZERS
from lipsync.text_to_speech.spoken_form import spoken_form
from lipsync.text_to_speech.synthesis import (
    DEFAULT_VOICE,
    SynthesisError,
    SynthesizedSpeech,
    Synthesizer,
    UnspeakableTextError,
    Voice,
    pieces,
)

#: A sentence longer than this, in characters, is cut: 25 s of speech.
LONGEST_PIECE = 400


def synthesizer_for(name: str = DEFAULT_SYNTHESIZER) -> Synthesizer:
    """Return a new speech synthesiser, by its name in `lipsync.plugins.SYNTHESIZERS`.

    Raises PluginError for an unknown name, SynthesisError where what it needs is not installed.
    """
    synthesizer: Synthesizer = SYNTHESIZERS.load(name)()
    return synthesizer


def speak_in_pieces(
    synthesizer: Synthesizer, text: str, voice: Voice = DEFAULT_VOICE
) -> Iterator[SynthesizedSpeech]:
    """Yield the speech of a text of any length by sentences, each made when the iterator advances.

    The text is spoken in its `spoken_form`. The first sentence sounds soon, and no more than
    one is in memory. Pieces in which nothing can be spoken, such as a line of dashes, are left
    out. Raises UnspeakableTextError at the end if all were left out, and SynthesisError as
    `speak` does, and for a sentence of more than five minutes.
    """
    is_spoken = False
    for piece in pieces(spoken_form(text, voice.language), LONGEST_PIECE):
        try:
            spoken = synthesizer.speak(piece, voice)
        except UnspeakableTextError:
            continue
        if spoken.duration_s > MOST_WAITING_S:
            raise SynthesisError(f"{piece[:40]!r}: over {MOST_WAITING_S:g} s long; check the voice")
        is_spoken = True
        yield spoken
    if not is_spoken:
        raise UnspeakableTextError("the text has nothing that can be spoken; write words")
