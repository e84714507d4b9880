"""What every source of sound answers to."""

from typing import Protocol

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
