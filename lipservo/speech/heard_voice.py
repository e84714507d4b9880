"""What was heard of the voice, by sound time: the sound is heard before its face is shown."""

import math
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import BLOCK_S, AudioBlock
from lipsync.prosody.voice_frame import SILENT_VOICE, VoiceFrame

#: Ten seconds: more than any delay from sound to face.
_N_KEPT: Final = 1_000


class VoiceListener(Protocol):
    """Who tells how something is said: `lipsync.prosody.voice_tracker.VoiceTracker`."""

    def feed(self, samples: NDArray[np.float32]) -> VoiceFrame:
        """Hear the next 10 ms."""


class HeardVoice:
    """Keeps the voice frames of the last seconds."""

    def __init__(self, listener: VoiceListener) -> None:
        self._listener = listener
        self._kept: list[tuple[int, VoiceFrame]] = [(-1, SILENT_VOICE)] * _N_KEPT

    def hear(self, block: AudioBlock) -> None:
        """The next 10 ms of sound."""
        n = round(block.start_s / BLOCK_S)
        self._kept[n % _N_KEPT] = (n, self._listener.feed(block.samples))

    def at(self, sound_s: float) -> VoiceFrame:
        """The 10 ms around a sound time; silence where nothing was heard."""
        n = math.floor(sound_s / BLOCK_S + 1e-6)
        kept, frame = self._kept[n % _N_KEPT]
        return frame if kept == n else SILENT_VOICE

    def peaks(self, after_s: float, until_s: float, most: int) -> list[float]:
        """Of every 10 ms between two sound times, the newest `most` of them."""
        first, last = (math.floor(each / BLOCK_S + 1e-6) for each in (after_s, until_s))
        return [self.at(n * BLOCK_S).peak for n in range(max(first, last - most) + 1, last + 1)]
