"""Shared memory with three notes between the processes of a face: settings, speech status, stop.

The bridge process answers clients and writes the settings they request; the speech process follows
them, and writes its status. The supervisor writes whether a person has stopped the face, so that
speech falls silent. The memory is the supervisor's, so that settings and status outlive either
process. No process waits: a note that is being written is read at the next attempt. Each note has
one writer at a time.
"""

import json
import mmap
import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from typing import Final, Self

from lipservo.runtime.status.face_status import BridgeSide, SpeechStatus, Status, whole_status

#: Version, length in bytes and checksum of a note, then its JSON.
_HEAD: Final = struct.Struct("<QII")
#: The reasons of a few fallbacks and a path or two; a longer note is not written.
_NOTE_BYTES: Final = 16_384
#: Every field of a status, with what stands for "not known".
_UNKNOWN: Final = Status(BridgeSide()).as_dict()
_SIZE: Final = 3 * _NOTE_BYTES


class _Note:
    """A JSON object with version and checksum, at an offset in shared memory."""

    def __init__(self, memory: mmap.mmap, offset: int) -> None:
        self._memory = memory
        self._offset = offset
        self._version = 0
        self._value: dict[str, object] = {}

    def write(self, value: Mapping[str, object]) -> None:
        """Replace the note's value by `value`; do nothing if its JSON is longer than 16 kB."""
        text = json.dumps(value).encode()
        if len(text) > _NOTE_BYTES - _HEAD.size:
            return
        version, _, _ = _HEAD.unpack_from(self._memory, self._offset)
        start = self._offset + _HEAD.size
        # A reader that looks in between finds a checksum that does not fit.
        self._memory[start : start + len(text)] = text
        _HEAD.pack_into(self._memory, self._offset, version + 1, len(text), zlib.crc32(text))

    def read(self) -> dict[str, object]:
        """Return the newest intact value of the note; {} before the first."""
        version, length, checksum = _HEAD.unpack_from(self._memory, self._offset)
        if version != self._version and length <= _NOTE_BYTES - _HEAD.size:
            start = self._offset + _HEAD.size
            text = self._memory[start : start + length]
            if zlib.crc32(text) == checksum:
                self._version, self._value = version, json.loads(text)
        return self._value


class StatusBoard:
    """Shared memory with three notes: made by `create`; a child adopts the inherited `fileno`."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._memory = mmap.mmap(fd, _SIZE)
        self._settings = _Note(self._memory, 0)
        self._speech = _Note(self._memory, _NOTE_BYTES)
        self._stop = _Note(self._memory, 2 * _NOTE_BYTES)

    @classmethod
    def create(cls) -> Self:
        """Create a board with three empty notes."""
        fd = os.memfd_create("lipservo-status")
        os.ftruncate(fd, _SIZE)
        return cls(fd)

    @classmethod
    def adopt(cls, fd: int) -> Self:
        """Return the board of a descriptor that this process inherited."""
        os.set_inheritable(fd, False)
        return cls(fd)

    def fileno(self) -> int:
        """Return the descriptor that a child inherits."""
        return self._fd

    def add_settings(self, changed: Mapping[str, float]) -> None:
        """Add changed settings, by name, to those in the note."""
        self._settings.write({**self.settings(), **changed})

    def settings(self) -> dict[str, float]:
        """Return the settings requested so far, by name; {} where none was changed."""
        return {name: float(str(value)) for name, value in self._settings.read().items()}

    def write_stopped(self, *, is_stopped: bool) -> None:
        """Write whether a person has stopped the face, for the speech process to follow."""
        self._stop.write({**self._stop.read(), "is_stopped": is_stopped})

    def write_not_kept(self, why: str) -> None:
        """Write why a stop cannot be kept beyond the face's processes; empty: it can."""
        self._stop.write({**self._stop.read(), "not_kept": why})

    def not_kept(self) -> str:
        """Return what `write_not_kept` wrote last; empty before anything was written."""
        return str(self._stop.read().get("not_kept", ""))

    def is_stopped(self) -> bool:
        """Return whether a person has stopped the face; False before anything was written."""
        return self._stop.read().get("is_stopped") is True

    def write_speech(self, status: SpeechStatus) -> None:
        """Write the status of the speech side, for the processes that answer clients."""
        self._speech.write(asdict(status))

    def speech(self) -> SpeechStatus | None:
        """Return the last status of the speech side; None before the first."""
        record = self._speech.read()
        return SpeechStatus(**record) if record else None  # type: ignore[arg-type]  # as written

    def describe_stopped(self, supervisor: Mapping[str, object]) -> dict[str, object]:
        """Return the status for JSON while no bridge runs. supervisor: the servo side's fields."""
        return {**_UNKNOWN, **self._speech.read(), **supervisor}

    def describe(self, bridge: Mapping[str, object]) -> dict[str, object]:
        """Return the status of the whole face for JSON. bridge: the servo side's fields."""
        return whole_status(bridge, self.speech()).as_dict()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._memory.close()
        os.close(self._fd)
