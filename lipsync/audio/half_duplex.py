"""A microphone on a robot that also speaks: it is listened to while the robot is silent.

Half duplex: while the robot speaks its mouth shows its own words, never those of the person it
talks to, nor its own echo.
"""

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.cutter import BLOCK_SAMPLES
from lipsync.audio.source import AudioSource

Samples = NDArray[np.float32]

#: A microphone hands sound over in pieces of up to 40 ms (PulseAudio): so much is held back, or the
#: timeline, which goes on evenly, would find holes.
_HELD_BLOCKS: Final = 4
#: Beyond this the microphone's clock runs faster than ours; the oldest block is left out.
_MOST_BLOCKS: Final = 10


class ListenedMicrophone:
    """The blocks of a microphone on another's timeline: one whenever one is asked for."""

    def __init__(self, microphone: AudioSource) -> None:
        """microphone: entered, and live."""
        self._microphone = microphone
        self._blocks: deque[Samples] = deque(maxlen=_MOST_BLOCKS)
        self._is_primed = False

    @property
    def name(self) -> str:
        """The device's own name."""
        return self._microphone.name

    @property
    def lost_blocks(self) -> int:
        """Blocks that the device or the computer dropped."""
        return self._microphone.lost_blocks

    def take(self) -> Samples | None:
        """The next 10 ms (160,) at 16 kHz; None while too little has come."""
        for block in self._microphone.blocks(float("inf")):
            if len(block.samples) == BLOCK_SAMPLES:
                self._blocks.append(block.samples)
        if not self._is_primed and len(self._blocks) < _HELD_BLOCKS:
            return None
        self._is_primed = bool(self._blocks)
        return self._blocks.popleft() if self._blocks else None

    def discard(self) -> None:
        """What was heard until now is nobody's business."""
        self._microphone.blocks(float("inf"))
        self._blocks.clear()
        self._is_primed = False
