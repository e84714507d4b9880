"""What has been heard of the Feetech servos of one face so far, servo by servo."""

from collections.abc import Sequence
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array, HardwareError, Health
from firmware_bridge.feetech.codec import EMPTY_SIZE, Status
from firmware_bridge.feetech.control_table import STATE
from firmware_bridge.feetech.mounting import MountedServo, ServoIdentity

_Kind = TypeVar("_Kind", bound=np.generic)

#: What each bit of register `status` means here; too much current is too much load.
_MEANINGS: Final = {
    0x01: HardwareError.INPUT_VOLTAGE,
    0x02: HardwareError.ENCODER,
    0x04: HardwareError.OVERHEATING,
    0x08: HardwareError.OVERLOAD,
    0x20: HardwareError.OVERLOAD,
}
#: Bit 4 of what a servo answers with says that torque is on, in some firmware.
_STATUS_BITS: Final = sum(_MEANINGS)
_HARDWARE: Final = np.array(
    [sum({error for bit, error in _MEANINGS.items() if bit & bits}) for bits in range(256)],
    dtype=np.uint8,
)
#: Until a servo has been asked: as if freshly switched on in a warm room, 25 degC under 70.
_ROOM_DEGC: Final = 45.0


def hardware_errors(status: int) -> int:
    """Bits of `HardwareError` for a value of register `status`."""
    return int(_HARDWARE[status & _STATUS_BITS])


class ServoStateCache:
    """What every servo said last. Every array is (n_servos,), in the face's order.

    pulses, goals: position registers, NaN = never heard; low, high: the servo's own limits;
    enabled: torque was switched on by us and not confirmed off since; driven: it gets goals, since
    a goal may switch torque on. hardware: kept until the servo is restarted. What is handed out is
    handed out without a copy: these arrays are replaced, and never written into.
    """

    def __init__(self, servos: Sequence[MountedServo]) -> None:
        n, dialect = len(servos), servos[0].model.dialect
        self._index = {servo.joint.servo_id: k for k, servo in enumerate(servos)}
        self.low = np.zeros(n)
        self.high = np.full(n, dialect.n_positions - 1.0)
        self.hottest = np.array([servo.model.hottest_degc for servo in servos])
        # The newest answers of all, as they come; numbers are read in place.
        self._step = dialect.state_size + EMPTY_SIZE
        self._frame = bytearray(n * self._step)
        number = "<u2" if dialect.byte_order == "little" else ">u2"
        fields = {"position": (0, number), "load": (4, number)}
        fields |= {"voltage": (6, "u1"), "temperature": (7, "u1"), "status": (9, "u1")}
        if dialect.current_unit_ma is not None:
            fields["current"] = (dialect.registers["present_current"].address - STATE, number)
        block = np.dtype(
            {
                "names": list(fields),
                "offsets": [at + EMPTY_SIZE - 1 for at, _ in fields.values()],
                "formats": [kind for _, kind in fields.values()],
                "itemsize": self._step,
            }
        )
        values = np.frombuffer(self._frame, dtype=block)
        self._positions, self._loads = values["position"], values["load"]
        self._conditions = {name: values[name] for name in ("voltage", "temperature", "status")}
        self._current_unit_ma = dialect.current_unit_ma
        self._currents = values["current"] if self._current_unit_ma is not None else None
        self._signed = dialect.registers["present_position"].sign is not None
        high_byte = EMPTY_SIZE - (0 if dialect.byte_order == "little" else 1)
        self._high_bytes = slice(high_byte, None, self._step)
        self._seen = b""
        self.pulses: Array = np.full(n, np.nan)
        self.goals = np.full(n, np.nan)
        self.effort: Array = np.zeros(n)
        self.no_errors = _read_only(np.zeros(n, dtype=np.uint8))
        self._no_age_s = _read_only(np.zeros(n))
        self.errors = self.no_errors
        self.heard_s = np.full(n, -np.inf)
        self._all_heard = False
        self.torque = _read_only(np.zeros(n, dtype=np.bool_))
        self.enabled = np.zeros(n, dtype=np.bool_)
        self.driven = np.zeros(n, dtype=np.bool_)
        self._never = _read_only(np.zeros(n, dtype=np.bool_))
        self.hardware = self.no_errors
        self.temperature_degc: Array = np.full(n, np.nan)
        self.room_degc: Array = np.full(n, _ROOM_DEGC)
        self.voltage_v: Array = np.full(n, np.nan)
        self.unanswered = _read_only(np.zeros(n, dtype=np.int64))

    def set_one(self, name: str, index: int, value: float) -> None:
        """Replace the array of this name where a servo's value in it has changed."""
        array = getattr(self, name)
        if array.item(index) != value:
            array = array.copy()
            array[index] = value
            setattr(self, name, _read_only(array))

    def take_identity(self, index: int, found: ServoIdentity, now_s: float) -> None:
        """Its own limits, as its EEPROM says."""
        self.low[index] = found.eeprom["min_position_limit"]
        self.high[index] = found.eeprom["max_position_limit"]
        self.hottest[index] = found.eeprom["max_temperature"]
        self._seen = b""
        self.heard_s[index] = now_s

    def take_state(self, found: bytes | list[Status], now_s: float) -> Array:
        """The bytes from `STATE` on, as a `Group` gives them; how old each servo's part is."""
        if isinstance(found, bytes):
            self._frame[:] = found
            self.heard_s.fill(now_s)
            self._all_heard = True
            ages_s = self._no_age_s
        else:
            for status in found:
                n = self._index[status.servo_id]
                at = n * self._step + EMPTY_SIZE - 1
                self._frame[at : at + len(status.data)] = status.data
                self.heard_s[n] = now_s
            ages_s = self.ages([status.servo_id for status in found], now_s)
            self.unanswered = _read_only(self.unanswered + (ages_s > 0.0))
        pulses: Array = self._places()
        self.effort = np.asarray((self._loads & 0x3FF) * 1e-3, np.float64)
        self._take_conditions()
        if not self._all_heard:
            ever = np.isfinite(self.pulses)
            ever[np.flatnonzero(ages_s == 0.0)] = True
            self._all_heard = bool(ever.all())
            self.voltage_v = np.where(ever, self.voltage_v, np.nan)
            self.temperature_degc = np.where(ever, self.temperature_degc, np.nan)
            self.room_degc = np.where(ever, self.room_degc, _ROOM_DEGC)
            pulses = np.where(ever, pulses, np.nan)
        self.pulses = pulses
        return ages_s

    def _places(self) -> Array:
        places: Array = self._positions.astype(np.float64)
        if self._signed and max(self._frame[self._high_bytes]) & 0x80:
            return np.where(places >= 0x8000, 0x8000 - places, places)
        return places

    def _take_conditions(self) -> None:
        """Volts, warmth and trouble, which hardly ever change from tick to tick."""
        of = self._conditions
        seen = b"".join([values.tobytes() for values in of.values()])
        if seen == self._seen and self._all_heard:
            return
        self._seen = seen
        self.voltage_v = of["voltage"] * 0.1
        self.temperature_degc = of["temperature"].astype(np.float64)
        self.room_degc = self.hottest - self.temperature_degc
        now = _HARDWARE[of["status"] & _STATUS_BITS]
        self.hardware = _read_only(self.hardware | now)

    def forget_trouble(self, index: int) -> None:
        """It has been restarted: what it reports from now on counts."""
        self.set_one("hardware", index, 0)
        self._seen = b""

    def ages(self, ids: Sequence[int], now_s: float) -> Array:
        """How old each servo's part of a reading is; 0 for those just found."""
        ages = np.maximum(now_s - self.heard_s, 1e-9)
        ages[[self._index[each] for each in ids]] = 0.0
        return ages

    def health(self, now_s: float) -> Health:
        """For others to keep."""
        if self._currents is None or self._current_unit_ma is None:
            current_ma = np.full(len(self.heard_s), np.nan)
        else:
            current_ma = (self._currents & 0x7FFF) * self._current_unit_ma
        return Health(
            silent_s=now_s - self.heard_s,
            torque_on=self.torque,
            watchdog_tripped=self._never,
            hardware_errors=self.hardware,
            temperature_degc=self.temperature_degc,
            room_degc=self.room_degc,
            voltage_v=self.voltage_v,
            effort=self.effort,
            current_ma=current_ma,
            n_unanswered=self.unanswered,
        )


def _read_only(array: NDArray[_Kind]) -> NDArray[_Kind]:
    array.flags.writeable = False
    return array
