"""A text that the robot says: synthesised in a thread of its own, sentence by sentence."""

import threading
from collections.abc import Iterator
from typing import Final

from lipservo.street.sources import warn
from lipsync.audio.playout import Playout
from lipsync.audio.playout_events import PlayoutRequest
from lipsync.audio.playout_stream import PlayoutStream
from lipsync.errors import UserError
from lipsync.text_to_speech.spoken_text import SpokenText, Voice
from lipsync.text_to_speech.synthesizers import speak_in_pieces, synthesizer_for

#: Synthesised so far ahead of what is being said: a sentence or two.
_AHEAD_S: Final = 20.0
_LOOK_AGAIN_S: Final = 0.1
_END_S: Final = 2.0
_LANGUAGE: Final = "en-us"


class SpokenWords:
    """Synthesises to the end of the text, or until `close`, or until what it said is dropped."""

    def __init__(self, text: str, language: str, playout: Playout, name: str = "text") -> None:
        """name: of the streams, one for each sentence. Raises SynthesisError."""
        self._name = name
        self._playout = playout
        self._closed = threading.Event()
        pieces = speak_in_pieces(synthesizer_for(), text, Voice(language or _LANGUAGE))
        # The first sentence is spoken before anything moves: a mistake is told at once.
        self._newest = self._say(next(pieces))
        playout.announced.add(self)
        self._thread = threading.Thread(
            target=self._speak, args=(pieces,), name="text to speech", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Synthesise no more."""
        self._closed.set()
        self._thread.join(timeout=_END_S)

    def _speak(self, pieces: Iterator[SpokenText]) -> None:
        try:
            for piece in pieces:
                while self._newest.waiting_s > _AHEAD_S and not self._closed.is_set():
                    self._closed.wait(_LOOK_AGAIN_S)
                if self._closed.is_set() or self._newest.is_dropped:
                    return
                self._newest = self._say(piece)
        except UserError as error:
            warn(f"{error}; what came before it is said")
        finally:
            self._playout.announced.discard(self)

    def _say(self, piece: SpokenText) -> PlayoutStream:
        stream = PlayoutStream(
            self._name, piece.sample_rate_hz, self._playout.output_rate_hz, piece.phonemes
        )
        stream.push(piece.samples)
        stream.end()
        self._playout.requests.append(PlayoutRequest("say", stream))
        return stream
