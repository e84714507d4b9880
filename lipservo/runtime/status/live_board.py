"""The present state of a face, in shared memory that watching programs may read.

The loop that drives the servos and the one that recognises each write a record a tick, some hundred
bytes, and know nothing of readers: one watcher or twenty cost them the same. A record has a number
and a checksum; one that is read while it is being written is rejected.
`firmware_bridge.process.control_socket` hands the memory to clients, read-only.
"""

import json
import mmap
import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from firmware_bridge.bus import Array, Feedback, any_set
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.report import TickReport
from firmware_bridge.loop.servo_supervision import SILENT_S
from lipsync.face.frame import NO_EXPRESSION, Expression

if TYPE_CHECKING:
    from lipservo.runtime.status.street_tick import StreetTick

Record = np.void

#: Names of `Expression`, in the order of a record.
EXPRESSION_NAMES: Final = tuple(Expression.__dataclass_fields__)
#: Blocks of sound between two ticks of the slowest face (10 Hz), and some that came late.
MOST_PEAKS: Final = 16
#: The layout, which is written once: names and numbers of all that is in the records.
_ABOUT_BYTES: Final = 1 << 16
_ABOUT_HEAD: Final = struct.Struct("<II")
#: Number, checksum, then the record.
_HEAD: Final = struct.Struct("<QI")
#: Half a second of a loop at 100 Hz, for a reader that looks 30 times a second.
_N_SLOTS: Final = 64


@dataclass(frozen=True, slots=True)
class BoardLayout:
    """The layout of a board's records. servos, states, phonemes: names by number in records."""

    name: str
    config: str
    servos: tuple[str, ...]
    states: tuple[str, ...]
    phonemes: tuple[str, ...]
    n_components: int
    rate_hz: float

    def servo_type(self) -> np.dtype[Any]:
        """Return the NumPy type of servo records; readings never received are NaN in a record."""
        n = len(self.servos)
        return np.dtype(
            [
                ("time_s", "<f8"), ("goal_deg", "<f4", (n,)), ("encoder_deg", "<f4", (n,)),
                ("effort", "<f4", (n,)), ("state", "u1"), ("torque_on", "u1"),
                ("n_ticks", "<u4"), ("n_late", "<u4"), ("n_stale", "<u4"),
            ]
        )  # fmt: skip

    def speech_type(self) -> np.dtype[Any]:
        """Return the NumPy type of speech records: what is shown at monotonic `time_s`.

        sound_s: its sound time; phoneme: number in `phonemes`; peaks: of the 10 ms blocks shown
        since the record before, 255 = full scale; expression: NaN where none is set.
        """
        return np.dtype(
            [
                ("time_s", "<f8"), ("sound_s", "<f8"), ("phoneme", "<i2"), ("is_cut_off", "u1"),
                ("is_speech", "u1"), ("n_peaks", "u1"), ("peaks", "u1", (MOST_PEAKS,)),
                ("arousal", "<f4"), ("coefficients", "<f4", (self.n_components,)),
                ("expression", "<f4", (len(EXPRESSION_NAMES),)),
            ]
        )  # fmt: skip


class _Ring:
    """A ring buffer in shared memory: the newest `_N_SLOTS` records of one writer.

    fields: of the record in the making, by name; fields not set keep the last record's values.
    """

    def __init__(self, memory: mmap.mmap, offset: int, kind: np.dtype[Any]) -> None:
        """Use `memory` from byte `offset` on; its records stay. kind: NumPy type of a record."""
        self._memory = memory
        self._offset = offset
        self._kind = kind
        self._slot_bytes = _HEAD.size + kind.itemsize
        self._n_written = 0
        self._record = np.zeros((), kind)
        self.fields = {name: self._record[name] for name in kind.names or ()}

    @property
    def size(self) -> int:
        """The number of bytes that the ring occupies."""
        return self._slot_bytes * _N_SLOTS

    def write(self, values: Mapping[str, object]) -> None:
        """Set fields by name, and write the record into the next slot with its number and checksum.

        Called in the tick; never waits.
        """
        for name, value in values.items():
            self.fields[name][...] = value
        raw = self._record.tobytes()
        self._n_written += 1
        start = self._offset + self._n_written % _N_SLOTS * self._slot_bytes
        self._memory[start + _HEAD.size : start + self._slot_bytes] = raw
        _HEAD.pack_into(self._memory, start, self._n_written, zlib.crc32(raw))

    def continue_numbers(self) -> None:
        """Continue the record numbers of an earlier writer, which has died."""
        self._n_written = max((number for number, _ in self._slots()), default=0)

    def newer_than(self, number: int) -> list[tuple[int, Record]]:
        """Return (number, record) of every intact record numbered above `number`, oldest first.

        Records older than the ring, or being written now, are missing.
        """
        next_start = self._offset + (number + 1) % _N_SLOTS * self._slot_bytes
        if _HEAD.unpack_from(self._memory, next_start)[0] <= number:
            return []  # the next record has not been written yet: the usual case
        found = []
        for n, start in self._slots():
            if n <= number:
                continue
            raw = self._memory[start + _HEAD.size : start + self._slot_bytes]
            if zlib.crc32(raw) == _HEAD.unpack_from(self._memory, start)[1]:
                found.append((n, np.frombuffer(raw, self._kind)[0]))
        return sorted(found, key=itemgetter(0))

    def _slots(self) -> list[tuple[int, int]]:
        """Return (number of its record, offset in the memory) of each slot; number 0: empty."""
        starts = (self._offset + i * self._slot_bytes for i in range(_N_SLOTS))
        return [(_HEAD.unpack_from(self._memory, start)[0], start) for start in starts]


class LiveBoard:
    """The shared memory with the ring of servo records and the ring of speech records.

    Make it with `create`; a child process that inherits its `fileno` calls `adopt`.
    """

    def __init__(self, fd: int, *, writable: bool) -> None:
        """Map the memory of descriptor `fd`. Raises ValueError if that contains no board."""
        # The memory holds the layout as JSON, the ring of servo records, that of speech records.
        self._fd = fd
        access = mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ
        self._memory = mmap.mmap(fd, 0, access=access)
        length, checksum = _ABOUT_HEAD.unpack_from(self._memory, 0)
        text = self._memory[_ABOUT_HEAD.size : _ABOUT_HEAD.size + length]
        if not length or zlib.crc32(text) != checksum:
            raise ValueError("this shared memory is not a live board")
        self.layout = _layout(json.loads(text))
        self._servos = _Ring(self._memory, _ABOUT_BYTES, self.layout.servo_type())
        after = _ABOUT_BYTES + self._servos.size
        self._speech = _Ring(self._memory, after, self.layout.speech_type())
        if writable:
            self._servos.continue_numbers()
            self._speech.continue_numbers()

    @classmethod
    def create(cls, layout: BoardLayout) -> Self:
        """Create an empty board, writable, in new shared memory, which `fileno` hands to others.

        layout: names and sizes of the records. Raises ValueError if servos' names are too long.
        """
        text = json.dumps(asdict(layout)).encode()
        if len(text) > _ABOUT_BYTES - _ABOUT_HEAD.size:
            raise ValueError("names of servos are too long for a live board")
        kinds = (layout.servo_type(), layout.speech_type())
        rings = sum((_HEAD.size + kind.itemsize) * _N_SLOTS for kind in kinds)
        fd = os.memfd_create("lipservo-live")
        os.ftruncate(fd, _ABOUT_BYTES + rings)
        with mmap.mmap(fd, 0) as memory:
            memory[_ABOUT_HEAD.size : _ABOUT_HEAD.size + len(text)] = text
            _ABOUT_HEAD.pack_into(memory, 0, len(text), zlib.crc32(text))
        return cls(fd, writable=True)

    @classmethod
    def adopt(cls, fd: int) -> Self:
        """Return the board, writable, of a descriptor that a supervisor handed over."""
        os.set_inheritable(fd, False)
        return cls(fd, writable=True)

    @classmethod
    def watch(cls, fd: int) -> Self:
        """Return the board, read-only, of a descriptor from the control socket.

        Raises ValueError if that contains no board, OSError if it cannot be mapped.
        """
        return cls(fd, writable=False)

    def fileno(self) -> int:
        """Return the descriptor that a child inherits."""
        return self._fd

    def write_servos(self, **values: object) -> None:
        """Write the servo record of one tick; `BoardLayout.servo_type` has the names."""
        self._servos.write(values)

    def write_speech(self, peaks: Sequence[float] = (), **values: object) -> None:
        """Write one speech record; `BoardLayout.speech_type` has the names. peaks: 0 to 1."""
        newest = [round(255 * min(1.0, max(0.0, p))) for p in peaks[-MOST_PEAKS:]]
        self._speech.fields["peaks"][: len(newest)] = newest
        self._speech.write({**values, "n_peaks": len(newest)})

    def servos_since(self, number: int) -> list[tuple[int, Record]]:
        """Return (number, record) of every servo record numbered above `number`, oldest first."""
        return self._servos.newer_than(number)

    def speech_since(self, number: int) -> list[tuple[int, Record]]:
        """Return (number, record) of every speech record numbered above `number`, oldest first."""
        return self._speech.newer_than(number)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._memory.close()
        os.close(self._fd)


def expression_values(expression: Expression = NO_EXPRESSION) -> list[float]:
    """Return the values of an expression in the order of a speech record, NaN where none is set."""
    values = (getattr(expression, name) for name in EXPRESSION_NAMES)
    return [float("nan") if value is None else value for value in values]


def _layout(record: Mapping[str, Any]) -> BoardLayout:
    lists = {name: tuple(record[name]) for name in ("servos", "states", "phonemes")}
    return BoardLayout(**{**record, **lists})


#: The states of a face; their indices are the numbers in the records.
FACE_STATES = tuple(state.value for state in FaceState)


class ServoBoard:
    """A writer of the servos' goals and positions to a `LiveBoard`, a record a tick."""

    def __init__(self, board: LiveBoard, bridge: Bridge) -> None:
        self._board = board
        self._bridge = bridge
        self._never = np.full(len(bridge.names), np.nan)

    def observe(self, tick: "StreetTick") -> None:
        """Write the servo record of one tick of the live pipeline (`Street`)."""
        self.tell(tick.report)

    def tell(self, report: TickReport) -> None:
        """Write the servo record of one tick of the bridge."""
        feedback = self._bridge.feedback
        counts = self._bridge.counts
        self._board.write_servos(
            time_s=report.time_s,
            goal_deg=report.sent_deg,
            encoder_deg=self._never if feedback is None else _answered_deg(feedback),
            effort=self._never if feedback is None else feedback.effort,
            state=FACE_STATES.index(self._bridge.state.value),
            torque_on=report.torque_on is not False,  # what is not known may hold
            n_ticks=counts.n_ticks,
            n_late=counts.n_late,
            n_stale=counts.n_stale,
        )


def _answered_deg(feedback: Feedback) -> Array:
    """Return the servos' positions (n_servos,) in degrees; NaN: silent longer than SILENT_S."""
    if not any_set(feedback.age_s):  # all answered just now
        return feedback.positions_deg
    return np.where(feedback.age_s > SILENT_S, np.nan, feedback.positions_deg)
