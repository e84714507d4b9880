"""Silence, for a robot that is on and has nothing to say."""

import numpy as np

from lipsync.audio.cutter import BLOCK_SAMPLES
from lipsync.audio.source import AudioSource
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock, samples_before

_SILENCE = np.zeros(BLOCK_SAMPLES, dtype=np.float32)
_SILENCE.flags.writeable = False


class SilentSource:
    """An endless `AudioSource` of zeros; `blocks` needs a finite `until_s`."""

    name = "silence"
    duration_s: float | None = None
    is_live = False
    lost_blocks = 0

    def __init__(self, start_s: float = 0.0) -> None:
        """start_s: the first block is the one that holds this sound time."""
        self._n_blocks = int(samples_before(start_s)) // BLOCK_SAMPLES

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """The blocks not handed out before that end at or before sound time `until_s`."""
        first, end = self._n_blocks, int(samples_before(until_s)) // BLOCK_SAMPLES
        self._n_blocks = max(first, end)
        return [AudioBlock(_SILENCE, n * BLOCK_SAMPLES / SAMPLE_RATE_HZ) for n in range(first, end)]

    def __enter__(self) -> "SilentSource":
        return self

    def __exit__(self, *exc: object) -> None:
        """Nothing to give back."""


class SilenceAfter:
    """A source with a known end, followed by endless silence: the last phones need to be heard out.

    `duration_s` stays that of the source.
    """

    is_live = False

    def __init__(self, source: AudioSource, start_s: float = 0.0) -> None:
        """start_s: where `source` begins; without more, a source that is over begins in silence."""
        if source.duration_s is None:
            raise ValueError(f"{source.name} has no end to put silence after")
        self._source = source
        self._end_s = source.duration_s
        self._silence = SilentSource(max(0.0, start_s - self._end_s))

    @property
    def name(self) -> str:
        """The source's name."""
        return self._source.name

    @property
    def duration_s(self) -> float:
        """The source's length, without the silence."""
        return self._end_s

    @property
    def lost_blocks(self) -> int:
        """Blocks that the source lost."""
        return self._source.lost_blocks

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """The blocks not handed out before that end at or before sound time `until_s`."""
        blocks = self._source.blocks(until_s)
        for silent in self._silence.blocks(max(0.0, until_s - self._end_s)):
            blocks.append(AudioBlock(silent.samples, silent.start_s + self._end_s))
        return blocks

    def __enter__(self) -> "SilenceAfter":
        self._source.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        self._source.__exit__(*exc)
