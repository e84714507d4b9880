"""Snapshots of a face's state, read from its live board, and their encoding for clients.

`/api/twin` sends a snapshot in a hundred bytes, little-endian, which static/frame.js reads: u32
number; f32 time_s; u8 state, 255 unknown; u8 phoneme, 255 none; u8 flags; i8 arousal * 127;
f32 coefficients[n_components]; i16 expression[12], angles in 0.01 degrees, others in 0.0001; i16
goals[n_servos] and i16 encoders[n_servos] in 0.01 degrees; u8 n_peaks; u8 peaks[n_peaks]. -32768
of an i16: not known. `/api/state` sends a snapshot as a JSON array; its first message names the
array's fields.
"""

import json
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lipservo.runtime.status.live_board import EXPRESSION_NAMES, BoardLayout, LiveBoard, Record

#: The face's servo or speech side counts as gone after writing nothing for so long: a page, which
#: gets 30 snapshots a second, shows that within a second.
GONE_S: Final = 0.8
#: Peaks of sound in a snapshot: 10 ms each, so that 30 snapshots a second leave none out.
MOST_PEAKS: Final = 8

#: The layout before any face was read.
NO_LAYOUT: Final = BoardLayout("", "", (), (), (), 0, 0.0)
VERSION: Final = 1
RATE_HZ: Final = 30
TORQUE_ON, SERVOS_GONE, SPEECH_GONE, CUT_OFF, SPEAKING = 1, 2, 4, 8, 16
UNKNOWN: Final = 255
ABSENT: Final = -32768
_FRAME_HEAD: Final = struct.Struct("<IfBBBb")
_MOST_INT16: Final = 32767
#: Units per degree for angles of the expression; per 1 for the others, which go from 0 to 1.
_SCALES: Final = np.array([100.0 if n.endswith("_deg") else 1e4 for n in EXPRESSION_NAMES])
#: Fields of a snapshot in `/api/state`, in the order of its array.
FIELDS = (
    "number", "time_ms", "state", "phoneme", "flags", "arousal_percent", "goals_tenths_deg",
    "encoders_tenths_deg", "expression",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A snapshot of a face. number: of the dashboard's tick; time_s: since the dashboard started.

    servos, speech: the newest record of each side, None before its first. peaks: of the blocks of
    10 ms of sound since the snapshot before, 255 = full scale.
    """

    number: int
    time_s: float
    servos: Record | None = None
    speech: Record | None = None
    servos_gone: bool = True
    speech_gone: bool = True
    peaks: bytes = b""


@dataclass(slots=True)
class _Side:
    """The newest record of one writer of the board, the servo side or the speech side.

    number: of the record, counted by the board. seen_s: monotonic time of its arrival.
    """

    number: int = 0
    record: Record | None = None
    seen_s: float = float("-inf")

    def update(self, records: list[tuple[int, Record]], now_s: float) -> None:
        """Store the newest of `records`, (number, record) oldest first; for none keep the last."""
        if not records:
            return
        # A record found at the first look may be old: it counts from when it was written.
        seen_s = now_s if self.number else min(now_s, float(records[-1][1]["time_s"]))
        (self.number, self.record), self.seen_s = records[-1], seen_s

    def is_gone(self, now_s: float) -> bool:
        return now_s - self.seen_s > GONE_S


class BoardReader:
    """A reader of one live board, called once a tick. Times are monotonic seconds."""

    def __init__(self, board: LiveBoard) -> None:
        """Read from `board`, which `close` closes."""
        self._board = board
        self._servos, self._speech = _Side(), _Side()
        self.layout = board.layout

    def read(self, number: int, since_start_s: float, now_s: float) -> Snapshot:
        """Return a snapshot: the newest records, and the peaks of sound since the last call.

        number: of the snapshot. since_start_s: since the dashboard started. now_s: monotonic; the
        servo or the speech side counts as gone if it wrote no record in the last GONE_S.
        """
        speech = self._board.speech_since(self._speech.number)
        # At the first call the board's older records have no place in this snapshot.
        peaks = b""
        if self._speech.number:
            peaks = b"".join(each["peaks"][: each["n_peaks"]].tobytes() for _, each in speech)
        self._servos.update(self._board.servos_since(self._servos.number), now_s)
        self._speech.update(speech, now_s)
        return Snapshot(
            number,
            since_start_s,
            self._servos.record,
            self._speech.record,
            self._servos.is_gone(now_s),
            self._speech.is_gone(now_s),
            peaks[-MOST_PEAKS:],
        )

    def close(self) -> None:
        """Release the shared memory."""
        self._board.__exit__()


def _first_message(layout: BoardLayout, **more: object) -> str:
    """Return the first message of a stream, JSON: the names that indices refer to, and `more`."""
    names = {
        "version": VERSION, "name": layout.name, "servos": layout.servos, "states": layout.states,
        "phonemes": layout.phonemes, "expression": EXPRESSION_NAMES, "rate_hz": RATE_HZ,
    }  # fmt: skip
    return json.dumps({**names, **more})


def hello(layout: BoardLayout) -> str:
    """Return the first message of `/api/twin`, JSON: the names that indices in frames refer to."""
    return _first_message(layout, n_components=layout.n_components)


def flags_of(snapshot: Snapshot) -> int:
    """Return a frame's flag bits: torque on, servos gone, speech gone, sound cut off, speaking."""
    servos, speech = snapshot.servos, snapshot.speech
    flags = SERVOS_GONE if snapshot.servos_gone else 0
    flags |= SPEECH_GONE if snapshot.speech_gone else 0
    if servos is not None and not snapshot.servos_gone and servos["torque_on"]:
        flags |= TORQUE_ON
    if speech is not None and not snapshot.speech_gone:
        flags |= (CUT_OFF if speech["is_cut_off"] else 0) | (SPEAKING if speech["is_speech"] else 0)
    return flags


def state_of(snapshot: Snapshot, layout: BoardLayout) -> int:
    """Return the index in `layout.states` of the servo side's state; 255 where it is unknown."""
    if snapshot.servos is None or snapshot.servos_gone:
        return UNKNOWN
    state = int(snapshot.servos["state"])
    return state if state < len(layout.states) else UNKNOWN


def phoneme_of(snapshot: Snapshot, layout: BoardLayout) -> int:
    """Return the index in `layout.phonemes` of the phoneme shown; 255 for none."""
    if snapshot.speech is None or snapshot.speech_gone:
        return UNKNOWN
    phoneme = int(snapshot.speech["phoneme"])
    return phoneme if 0 <= phoneme < len(layout.phonemes) else UNKNOWN


def arousal_of(snapshot: Snapshot) -> float:
    """Return the arousal of the voice, -1 to 1; 0 where it is unknown."""
    if snapshot.speech is None or snapshot.speech_gone:
        return 0.0
    return float(np.nan_to_num(np.clip(snapshot.speech["arousal"], -1.0, 1.0)))


def goals_of(snapshot: Snapshot, layout: BoardLayout, scale: float) -> NDArray[np.int16]:
    """Return the servos' goal positions as whole numbers.

    Parameters
    ----------
    snapshot : Snapshot
        The newest records.
    layout : BoardLayout
        Names of the servos.
    scale : float
        Units per degree.

    Returns
    -------
    NDArray[np.int16]
        (n_servos,), in 1/scale degrees; `ABSENT` before the first record.
    """
    record = snapshot.servos
    return whole_numbers(unknown_angles(layout) if record is None else record["goal_deg"], scale)


def encoders_of(snapshot: Snapshot, layout: BoardLayout, scale: float) -> NDArray[np.int16]:
    """Return the servos' measured positions as whole numbers.

    Parameters
    ----------
    snapshot : Snapshot
        The newest records.
    layout : BoardLayout
        Names of the servos.
    scale : float
        Units per degree.

    Returns
    -------
    NDArray[np.int16]
        (n_servos,), in 1/scale degrees; `ABSENT` while they are not read.
    """
    record = None if snapshot.servos_gone else snapshot.servos
    return whole_numbers(unknown_angles(layout) if record is None else record["encoder_deg"], scale)


def expression_of(snapshot: Snapshot) -> NDArray[np.int16]:
    """Return the expression's channels in the order of `EXPRESSION_NAMES`, as whole numbers.

    Parameters
    ----------
    snapshot : Snapshot
        The newest records.

    Returns
    -------
    NDArray[np.int16]
        (n_channels,), angles in 0.01 degrees, others in 0.0001; `ABSENT` where one is not set.
    """
    record = None if snapshot.speech_gone else snapshot.speech
    return whole_numbers(
        [np.nan] * len(_SCALES) if record is None else record["expression"], _SCALES
    )


def encode(snapshot: Snapshot, layout: BoardLayout) -> bytes:
    """Return a snapshot as one frame of `/api/twin`, in the bytes of the module's docstring."""
    if snapshot.speech is None:
        coefficients = np.zeros(layout.n_components, "<f4")
    else:
        coefficients = snapshot.speech["coefficients"]
    head = _FRAME_HEAD.pack(
        snapshot.number & 0xFFFFFFFF,
        snapshot.time_s,
        state_of(snapshot, layout),
        phoneme_of(snapshot, layout),
        flags_of(snapshot),
        round(127 * arousal_of(snapshot)),
    )
    return b"".join(
        (
            head,
            coefficients.astype("<f4").tobytes(),
            expression_of(snapshot).tobytes(),
            goals_of(snapshot, layout, 100.0).tobytes(),
            encoders_of(snapshot, layout, 100.0).tobytes(),
            bytes([len(snapshot.peaks)]),
            snapshot.peaks,
        )
    )


def unknown_angles(layout: BoardLayout) -> NDArray[np.float32]:
    """Return NaN, an unknown angle, for every servo.

    Parameters
    ----------
    layout : BoardLayout
        Names of the servos.

    Returns
    -------
    NDArray[np.float32]
        (n_servos,), NaN.
    """
    return np.full(len(layout.servos), np.nan, np.float32)


def whole_numbers(values: ArrayLike, scale: float | NDArray[np.float64]) -> NDArray[np.int16]:
    """Return values scaled, rounded and clipped to 16 bits.

    Parameters
    ----------
    values : ArrayLike
        (n,).
    scale : float | NDArray[np.float64]
        Factor of all values, or (n,) factors.

    Returns
    -------
    NDArray[np.int16]
        (n,); NaN becomes `ABSENT`.
    """
    scaled = np.rint(np.asarray(values, np.float64) * scale)
    clipped = np.clip(np.nan_to_num(scaled, nan=ABSENT), ABSENT + 1, _MOST_INT16)
    return np.where(np.isnan(scaled), ABSENT, clipped).astype("<i2")


def state_hello(layout: BoardLayout) -> str:
    """Return the first message of `/api/state`, JSON: the fields of its arrays, and index names."""
    flags = {
        "torque_on": TORQUE_ON, "servos_gone": SERVOS_GONE, "speech_gone": SPEECH_GONE,
        "cut_off": CUT_OFF, "speaking": SPEAKING,
    }  # fmt: skip
    return _first_message(layout, fields=FIELDS, flags=flags)


def state_message(snapshot: Snapshot, layout: BoardLayout) -> str:
    """Return a snapshot as a JSON array in the order of `FIELDS` (names); null: not known.

    The field `expression` is itself an array, in the order of `EXPRESSION_NAMES`: those that end
    in `_deg` (angles of neck and eyes) in tenths of a degree, the others (lids, brow, smile) in
    hundredths.
    """
    expression = [
        None if value == ABSENT else round(value / (10 if name.endswith("_deg") else 100))
        for name, value in zip(EXPRESSION_NAMES, expression_of(snapshot).tolist(), strict=True)
    ]
    state, phoneme = state_of(snapshot, layout), phoneme_of(snapshot, layout)
    values = [
        snapshot.number,
        round(1e3 * snapshot.time_s),
        None if state == UNKNOWN else state,
        None if phoneme == UNKNOWN else phoneme,
        flags_of(snapshot),
        round(100 * arousal_of(snapshot)),
        _with_none(goals_of(snapshot, layout, 10.0).tolist()),
        _with_none(encoders_of(snapshot, layout, 10.0).tolist()),
        expression,
    ]
    return json.dumps(values, separators=(",", ":"))


def _with_none(values: list[int]) -> list[int | None]:
    return [None if value == ABSENT else value for value in values]
