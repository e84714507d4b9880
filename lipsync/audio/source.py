"""What every source of sound, and every loudspeaker, answers to."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import AudioBlock
from lipsync.errors import UserError


class SoundError(UserError):
    """Sound cannot be had; the message is one line: what, where, what to do."""


class AudioSource(Protocol):
    """Sound as it becomes available, 16 kHz mono, in blocks of about 10 ms without gaps.

    Use it as a context manager: it holds its device from `__enter__` to `__exit__`.
    """

    @property
    def name(self) -> str:
        """A short name for the terminal: the file, the device."""

    @property
    def duration_s(self) -> float | None:
        """Length of the whole stream; None when it has no known end."""

    @property
    def is_live(self) -> bool:
        """Sound comes when it comes, by a clock of its own; `blocks(inf)` gives all that has."""

    @property
    def lost_blocks(self) -> int:
        """Blocks that the device or the computer dropped (overruns)."""

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """The blocks not handed out before that end at or before sound time `until_s`."""

    def __enter__(self) -> "AudioSource": ...

    def __exit__(self, *exc: object) -> None: ...


class Loudspeaker(Protocol):
    """Where committed sound is played. Time is the timeline's: of what was written, first to last.

    Called by the live loop: nothing here may wait.
    """

    @property
    def name(self) -> str:
        """The device's own name."""

    @property
    def is_lost(self) -> bool:
        """Whether the device is gone: nothing is played until it is back."""

    @property
    def rate_hz(self) -> int:
        """Samples a second, a multiple of 100."""

    @property
    def latency_s(self) -> float:
        """How long after it was written a sample is heard at the earliest."""

    @property
    def n_device_underruns(self) -> int:
        """How often the device itself had nothing to play: the computer was too slow for it."""

    def write(self, samples: NDArray[np.float32]) -> None:
        """The next samples (n,) float32 mono of the timeline."""

    def silence_rest(self) -> float:
        """Play silence in place of all that is written and still within reach.

        Gives the timeline position, in seconds, from which on it is silent.
        """

    def position(self) -> tuple[float, float] | None:
        """(monotonic seconds, timeline seconds that leave the loudspeaker then).

        The newest report of the device; None before the first.
        """
