"""Data that a client and a face exchange: the protocol's version, results, errors, and samples.

docs/agents.md is the protocol.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol

#: The version that this client speaks; a face of another says so, and so do we, in one line.
PROTOCOL: Final = 2
#: A message of the face, as docs/agents.md lists them.
Event = dict[str, Any]
_FULL_SCALE = 32_767


class FaceError(Exception):
    """An error that a face reported, or its missing answer. code: one of docs/agents.md."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True)
class Played:
    """How much of a stream was played. finished: all of it; otherwise it was cut off.

    played_s: seconds that were played; dropped_s: seconds that never will be.
    """

    finished: bool
    played_s: float
    dropped_s: float = 0.0


def played_of(event: Event) -> Played:
    """Return how much of a stream was played, from its event `finished` or `interrupted`."""
    finished = event["type"] == "finished"
    return Played(finished, float(event["played_s"]), float(event.get("dropped_s", 0.0)))


def error_of(event: Event) -> FaceError:
    """Return a FaceError with the code and message of an `error` event."""
    return FaceError(str(event.get("code", "")), str(event.get("message", "")))


#: A label, or its place in samples of the stream: (label, start), (label, start, end).
Unit = str | tuple[str, int | None] | tuple[str, int | None, int | None]
#: What is said: a text, or units of a kind.
SpeechUnits = str | tuple[Literal["words", "phonemes", "visemes"], Sequence[Unit]]
#: A face takes so many in a message, a label and a text so long.
_UNITS_AT_ONCE: Final = 1_000
_CHARACTERS_OF_LABEL: Final = 100
_CHARACTERS_AT_ONCE: Final = 10_000


def unit_messages(units: SpeechUnits) -> Iterator[dict[str, Any]]:
    """Yield the messages that send a text or units, each with its `type`; none for empty text."""
    if isinstance(units, str):
        for first in range(0, len(units), _CHARACTERS_AT_ONCE):
            yield {"type": "text", "text": units[first : first + _CHARACTERS_AT_ONCE]}
        return
    kind, rows = units
    for first in range(0, len(rows), _UNITS_AT_ONCE):
        yield {"type": kind, "units": [_unit(u) for u in rows[first : first + _UNITS_AT_ONCE]]}


def _unit(unit: Unit) -> dict[str, object]:
    label, *place = (unit,) if isinstance(unit, str) else unit
    given = (label[:_CHARACTERS_OF_LABEL], *place)
    named = zip(("label", "start_sample", "end_sample"), given, strict=False)
    return {name: value for name, value in named if value is not None}


class SampleArray(Protocol):
    """A NumPy array, by two of its attributes; numpy is loaded only where an array is written."""

    @property
    def dtype(self) -> object:
        """The type of the array's numbers."""

    def tobytes(self) -> bytes:
        """Return the array's numbers as bytes."""


#: s16le bytes, or an array (n,) or (n, 1): int16, or float in [-1, 1].
Pcm = bytes | bytearray | memoryview | SampleArray


def pcm_bytes(samples: Pcm) -> bytes:
    """Return samples as s16le bytes. Raises ValueError for an array of another shape or type."""
    if isinstance(samples, (bytes, bytearray, memoryview)):
        return bytes(samples)
    import numpy as np

    array = np.asarray(samples)
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 1:
        raise ValueError(f"samples have shape {array.shape}; send mono, (n,) or (n, 1)")
    if np.issubdtype(array.dtype, np.floating):
        array = np.rint(np.clip(np.nan_to_num(array), -1.0, 1.0) * _FULL_SCALE)
    elif array.dtype != np.int16:
        raise ValueError(f"samples have type {array.dtype}; send int16, or float in [-1, 1]")
    return bytes(array.astype("<i2").tobytes())


def mono_pcm(data: bytes | memoryview, n_channels: int) -> bytes:
    """Return one channel of s16le sound: the mean of the `n_channels` interleaved in `data`."""
    if n_channels == 1:
        return bytes(data)
    import numpy as np

    mean = np.frombuffer(data, dtype="<i2").reshape(-1, n_channels).mean(axis=1)
    return bytes(np.rint(mean).astype("<i2").tobytes())
