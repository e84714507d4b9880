"""Sources of sound and loudspeakers: contracts, cutting into blocks, and silence as a source."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock, samples_before
from lipsync.errors import UserError


class SoundError(UserError):
    """Error of a sound file or device; the message is one line: what, where, what to do."""


class AudioSource(Protocol):
    """A source of sound as it becomes available, 16 kHz mono, in blocks of about 10 ms, no gaps.

    Use it as a context manager: it holds its device from `__enter__` to `__exit__`.
    """

    @property
    def name(self) -> str:
        """A short name for the terminal: that of the file or the device."""

    @property
    def duration_s(self) -> float | None:
        """Length of the whole stream in seconds; None when it has no known end."""

    @property
    def is_live(self) -> bool:
        """Whether sound arrives by a clock of its own; `blocks(inf)` then returns all so far."""

    @property
    def lost_blocks(self) -> int:
        """The number of blocks that were dropped (overruns), or could not be decoded."""

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Return the blocks, not returned before, that end at or before sound time `until_s`."""

    def __enter__(self) -> "AudioSource": ...

    def __exit__(self, *exc: object) -> None: ...


class Loudspeaker(Protocol):
    """A loudspeaker that plays what is written. Its time counts the samples written, in seconds.

    Called by the live loop: nothing here may wait.
    """

    @property
    def name(self) -> str:
        """The name of the loudspeaker in use."""

    @property
    def is_lost(self) -> bool:
        """Whether the device is gone: nothing is played until it is back."""

    @property
    def rate_hz(self) -> int:
        """The sample rate in Hz, a multiple of 100."""

    @property
    def latency_s(self) -> float:
        """Seconds from writing a sample to its being heard, at the least."""

    @property
    def n_underruns(self) -> int:
        """The number of times that it had nothing to play in time: the computer was too slow."""

    def write(self, samples: NDArray[np.float32]) -> None:
        """Write the next samples of the timeline.

        Parameters
        ----------
        samples : NDArray[np.float32]
            (n,) float32 mono at `rate_hz`.
        """

    def silence_rest(self) -> float:
        """Play silence in place of all written sound that can still be replaced.

        Return the timeline position, in seconds, from which on it is silent.
        """

    def position(self) -> tuple[float, float] | None:
        """Return (monotonic seconds, timeline seconds that leave the loudspeaker then).

        The newest report of the device; None before the first report.
        """


BLOCK_SAMPLES = round(BLOCK_S * SAMPLE_RATE_HZ)


class BlockCutter:
    """A cutter of samples into `AudioBlock`s of 10 ms; the samples before a block give its time."""

    def __init__(self, n_before: int = 0) -> None:
        """Create a cutter. `n_before`: samples of the stream left out before the first block."""
        self._waiting: NDArray[np.float32] = np.zeros(0, dtype=np.float32)
        self._n_out = n_before

    @property
    def held_until_s(self) -> float:
        """Sound time in seconds just after the last sample pushed."""
        return (self._n_out + len(self._waiting)) / SAMPLE_RATE_HZ

    def push(self, samples: NDArray[np.float32]) -> None:
        """Add samples to be cut into blocks.

        Parameters
        ----------
        samples : NDArray[np.float32]
            (n,) at 16 kHz.
        """
        self._waiting = np.concatenate((self._waiting, samples))

    def take(self, until_s: float) -> list[AudioBlock]:
        """Remove and return the whole blocks that end at or before sound time `until_s`."""
        n_wanted = min(samples_before(until_s) - self._n_out, len(self._waiting))
        n_blocks = max(0, int(n_wanted) // BLOCK_SAMPLES)
        return [self._cut(BLOCK_SAMPLES) for _ in range(n_blocks)]

    def take_rest(self, until_s: float) -> list[AudioBlock]:
        """Remove and return all blocks until `until_s` of a stream that has ended.

        The last block may be shorter than 10 ms.
        """
        blocks = self.take(until_s)
        n_left = len(self._waiting)
        if 0 < n_left < BLOCK_SAMPLES and self._n_out + n_left <= samples_before(until_s):
            blocks.append(self._cut(n_left))
        return blocks

    def _cut(self, n_samples: int) -> AudioBlock:
        block = AudioBlock(self._waiting[:n_samples], self._n_out / SAMPLE_RATE_HZ)
        self._waiting = self._waiting[n_samples:]
        self._n_out += n_samples
        return block


_SILENCE = np.zeros(BLOCK_SAMPLES, dtype=np.float32)
_SILENCE.flags.writeable = False


class SilentSource:
    """An endless `AudioSource` of zeros; `blocks` needs a finite `until_s`."""

    name = "silence"
    duration_s: float | None = None
    is_live = False
    lost_blocks = 0

    def __init__(self, start_s: float = 0.0) -> None:
        """Begin at the block that contains sound time `start_s`."""
        self._n_blocks = int(samples_before(start_s)) // BLOCK_SAMPLES

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Return the blocks, not returned before, that end at or before sound time `until_s`."""
        first, end = self._n_blocks, int(samples_before(until_s)) // BLOCK_SAMPLES
        self._n_blocks = max(first, end)
        return [AudioBlock(_SILENCE, n * BLOCK_SAMPLES / SAMPLE_RATE_HZ) for n in range(first, end)]

    def __enter__(self) -> "SilentSource":
        return self

    def __exit__(self, *exc: object) -> None:
        """Do nothing: there is no device to release."""


class SilenceAfter:
    """A source with a known end, then endless silence, so that its last phones are recognised."""

    is_live = False

    def __init__(self, source: AudioSource, start_s: float = 0.0) -> None:
        """Put silence after `source`. Raises ValueError for a source without a known end.

        start_s: sound time at which `source` begins; past its end, the silence begins there.
        """
        if source.duration_s is None:
            raise ValueError(f"{source.name} never ends, so no silence can follow it")
        self._source = source
        self._end_s = source.duration_s
        self._silence = SilentSource(max(0.0, start_s - self._end_s))

    @property
    def name(self) -> str:
        """The name of the source before the silence."""
        return self._source.name

    @property
    def duration_s(self) -> float:
        """The source's length in seconds, without the silence."""
        return self._end_s

    @property
    def lost_blocks(self) -> int:
        """The number of blocks that the source lost."""
        return self._source.lost_blocks

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Return the blocks, not returned before, that end at or before sound time `until_s`."""
        blocks = self._source.blocks(until_s)
        for silent in self._silence.blocks(max(0.0, until_s - self._end_s)):
            blocks.append(AudioBlock(silent.samples, silent.start_s + self._end_s))
        return blocks

    def __enter__(self) -> "SilenceAfter":
        self._source.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        self._source.__exit__(*exc)
