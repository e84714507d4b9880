"""What a client and a face exchange: the protocol's version, answers, errors, and samples as bytes.

docs/agents.md is the protocol.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol, runtime_checkable

#: The version that this client speaks; a face of another says so, and so do we, in one line.
PROTOCOL: Final = 2
#: A message of the face, as docs/agents.md lists them.
Event = dict[str, Any]
_FULL_SCALE = 32_767


class FaceError(Exception):
    """The face refused, or does not answer. code: one of those in docs/agents.md, for programs."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True)
class Played:
    """What became of speech. finished: it was heard whole; else it was cut off.

    played_s: was heard; dropped_s: never will be.
    """

    finished: bool
    played_s: float
    dropped_s: float = 0.0


def played_of(event: Event) -> Played:
    """Return what became of a stream, from its last event."""
    finished = event["type"] == "finished"
    return Played(finished, float(event["played_s"]), float(event.get("dropped_s", 0.0)))


def error_of(event: Event) -> FaceError:
    """An `error` event, to be raised."""
    return FaceError(str(event.get("code", "")), str(event.get("message", "")))


#: A label, or its place in samples of the stream: (label, start), (label, start, end).
Unit = str | tuple[str, int | None] | tuple[str, int | None, int | None]
#: What is said: a text, or units of a kind.
SpeechUnits = str | tuple[Literal["words", "phonemes", "visemes"], Sequence[Unit]]
#: A face takes so many in a message, and a text so long.
_UNITS_AT_ONCE: Final = 1_000
_CHARACTERS_AT_ONCE: Final = 10_000


def unit_messages(units: SpeechUnits) -> Iterator[dict[str, Any]]:
    """The messages that tell it, each with its `type`; none of an empty text."""
    if isinstance(units, str):
        for first in range(0, len(units), _CHARACTERS_AT_ONCE):
            yield {"type": "text", "text": units[first : first + _CHARACTERS_AT_ONCE]}
        return
    kind, rows = units
    for first in range(0, len(rows), _UNITS_AT_ONCE):
        yield {"type": kind, "units": [_unit(u) for u in rows[first : first + _UNITS_AT_ONCE]]}


def _unit(unit: Unit) -> dict[str, object]:
    given = (unit,) if isinstance(unit, str) else unit
    named = zip(("label", "start_sample", "end_sample"), given, strict=False)
    return {name: value for name, value in named if value is not None}


@runtime_checkable
class SampleArray(Protocol):
    """A NumPy array, known by this; numpy is loaded only where one is written."""

    @property
    def dtype(self) -> object:
        """The type of its numbers."""

    def tobytes(self) -> bytes:
        """Return its numbers as bytes."""


#: s16le bytes, or an array (n,) or (n, 1): int16, or float in [-1, 1].
Pcm = bytes | bytearray | memoryview | SampleArray


def pcm_bytes(samples: Pcm) -> bytes:
    """The samples as s16le. Raises ValueError for an array of another shape or type."""
    if isinstance(samples, (bytes, bytearray, memoryview)):
        return bytes(samples)
    import numpy as np

    array = np.asarray(samples)
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 1:
        raise ValueError(f"samples of shape {array.shape}: mono is (n,) or (n, 1)")
    if np.issubdtype(array.dtype, np.floating):
        array = np.rint(np.clip(np.nan_to_num(array), -1.0, 1.0) * _FULL_SCALE)
    elif array.dtype != np.int16:
        raise ValueError(f"samples of type {array.dtype}: int16 or float in [-1, 1] are possible")
    return bytes(array.astype("<i2").tobytes())


def mono_pcm(data: bytes | memoryview, n_channels: int) -> bytes:
    """s16le of one channel: the mean of those that lie side by side in `data`."""
    if n_channels == 1:
        return bytes(data)
    import numpy as np

    mean = np.frombuffer(data, dtype="<i2").reshape(-1, n_channels).mean(axis=1)
    return bytes(np.rint(mean).astype("<i2").tobytes())
