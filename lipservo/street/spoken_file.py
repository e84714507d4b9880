"""A sound file that the robot says: read in a thread of its own, a little ahead of the playout."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipservo.street.sources import warn
from lipsync.audio.file import checked_rate_hz, sound_chunks
from lipsync.audio.playout import Playout
from lipsync.audio.playout_events import PlayoutRequest
from lipsync.audio.playout_stream import PlayoutStream
from lipsync.audio.source import SoundError
from lipsync.phonemes import PhonemeEvent

#: Read so far ahead: a slow disk is not heard, and a long file needs no memory.
_AHEAD_S: Final = 5.0
_LOOK_AGAIN_S: Final = 0.2
_END_S: Final = 2.0


class SpokenChunks:
    """Pushes chunks of sound, mono (n,), until there are no more, or until `close`."""

    def __init__(
        self, chunks: Iterator[NDArray[np.float32]], stream: PlayoutStream, playout: Playout
    ) -> None:
        """stream: of the chunks' rate, which the playout is asked to say."""
        self._chunks = chunks
        self._stream = stream
        self._closed = threading.Event()
        playout.requests.append(PlayoutRequest("say", stream))
        self._thread = threading.Thread(target=self._read, name="sound file", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Read no more."""
        self._closed.set()
        self._thread.join(timeout=_END_S)

    def _read(self) -> None:
        try:
            for chunk in self._chunks:
                while self._stream.waiting_s > _AHEAD_S and not self._closed.is_set():
                    self._closed.wait(_LOOK_AGAIN_S)
                if self._closed.is_set() or self._stream.ended:
                    return
                self._stream.push(chunk)
        except SoundError as error:
            warn(f"{error}; what came before it is said")
        finally:
            self._stream.end()


class SpokenFile(SpokenChunks):
    """The chunks of a file, to its end."""

    def __init__(
        self, path: Path, playout: Playout, *, start_s: float = 0.0, phonemes: Path | None = None
    ) -> None:
        """phonemes: a file of what is said when. Raises SoundError, LabelError."""
        rate_hz = checked_rate_hz(path, warn)
        known = () if phonemes is None else known_from(phonemes, start_s)
        stream = PlayoutStream(path.name, rate_hz, playout.output_rate_hz, known)
        super().__init__(sound_chunks(path, start_s), stream, playout)


def known_from(path: Path, start_s: float) -> tuple[PhonemeEvent, ...]:
    """The phonemes of a file that begin at `start_s` or later, counted from there."""
    from lipsync.phoneme_files.reader import read_known_phonemes

    return tuple(
        PhonemeEvent(
            event.phoneme,
            event.start_s - start_s,
            None if event.end_s is None else event.end_s - start_s,
        )
        for event in read_known_phonemes(path)
        if event.start_s >= start_s
    )
