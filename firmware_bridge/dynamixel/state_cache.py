"""What has been heard of the servos of one face so far, servo by servo."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array, Health
from firmware_bridge.dynamixel.control_table import PULSES_PER_TURN
from firmware_bridge.dynamixel.mounting import MountedServo, ServoIdentity
from firmware_bridge.dynamixel.wire.codec import CommonFrame, Status
from firmware_bridge.dynamixel.wire.line import FACTORY_RETURN_DELAY_S

_Kind = TypeVar("_Kind", bound=np.generic)

#: present_current .. present_position, as they lie in the control table.
_MOTION = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
#: The same in a common frame.
_MOTION_BLOCK = CommonFrame.block_of(_MOTION)
#: Until a servo has been asked: as if freshly switched on in a warm room, 25 degC under 70.
_ROOM_DEGC = 45.0


class ServoStateCache:
    """What every servo said last. Every array is (n_servos,), in the face's order.

    pulses, goals: position registers, NaN = never heard; effort: share of the stall torque;
    low, high: the servo's own limits in pulses; heard_s: when it answered last;
    enabled: torque was switched on by us and not confirmed off since. What `health` and feedback
    hand out they hand out without a copy, in every tick: these arrays are replaced, by `set_one`
    for one, and never written into.
    """

    def __init__(self, servos: Sequence[MountedServo]) -> None:
        n = len(servos)
        self._ids = tuple(servo.joint.servo_id for servo in servos)
        self._index = {servo.joint.servo_id: k for k, servo in enumerate(servos)}
        self.low = np.zeros(n)
        self.high = np.full(n, PULSES_PER_TURN - 1.0)
        self.return_delay_s = np.full(n, FACTORY_RETURN_DELAY_S)
        self.hottest = np.array([float(s.model.defaults["temperature_limit"]) for s in servos])
        units = [s.model.current_unit_ma for s in servos]
        stalls = [s.model.stall_a * 1e3 for s in servos]
        # Models without a current sensor count load in 0.1 %.
        self._effort_unit = np.array(
            [unit / stall if unit else 1e-3 for unit, stall in zip(units, stalls, strict=True)]
        )
        self._milliamperes = np.array(
            [stall if unit else np.nan for unit, stall in zip(units, stalls, strict=True)]
        )
        # The newest common frame of all, and where the values lie in it: numbers are read in place.
        self._frame = bytearray(CommonFrame.size_of(n, _MOTION.itemsize))
        blocks = CommonFrame.blocks(self._frame, _MOTION_BLOCK)
        self._positions, self._currents = blocks["position"], blocks["current"]
        self._current_units = np.zeros(n)
        self.pulses = np.full(n, np.nan)
        self.goals = np.full(n, np.nan)
        self.effort = np.zeros(n)
        self.no_errors = _read_only(np.zeros(n, dtype=np.uint8))
        self._no_age_s = _read_only(np.zeros(n))
        self.errors = self.no_errors
        self._no_error_bytes = bytes(n)
        self.heard_s = np.full(n, -np.inf)
        self.torque = _read_only(np.zeros(n, dtype=np.bool_))
        self.enabled = np.zeros(n, dtype=np.bool_)
        self.tripped = _read_only(np.zeros(n, dtype=np.bool_))
        self.hardware = _read_only(np.zeros(n, dtype=np.uint8))
        self.temperature_degc = _read_only(np.full(n, np.nan))
        self.room_degc = _read_only(np.full(n, _ROOM_DEGC))
        self.voltage_v = _read_only(np.full(n, np.nan))
        self.unanswered = _read_only(np.zeros(n, dtype=np.int64))

    def set_one(self, name: str, index: int, value: float) -> None:
        """Replace the array of this name where a servo's value in it has changed."""
        array = getattr(self, name)
        if array.item(index) != value:
            array = array.copy()
            array[index] = value
            setattr(self, name, _read_only(array))

    def take_temperature(self, index: int, temperature_degc: int) -> None:
        """How warm it is, and by how much it may become warmer."""
        self.set_one("temperature_degc", index, temperature_degc)
        self.set_one("room_degc", index, self.hottest[index] - temperature_degc)

    def take_identity(self, index: int, said: ServoIdentity, now_s: float) -> None:
        """Its own limits and return delay, as its EEPROM says."""
        self.low[index] = said.eeprom["min_position_limit"]
        self.high[index] = said.eeprom["max_position_limit"]
        self.hottest[index] = said.eeprom["temperature_limit"]
        self.return_delay_s[index] = said.return_delay_s
        self.heard_s[index] = now_s

    def note(self, statuses: Sequence[Status], now_s: float) -> None:
        """Remember who answered, and with what error."""
        for status in statuses:
            n = self._index[status.servo_id]
            self.heard_s[n] = now_s
            if status.error:
                self.errors = self.errors.copy()
                self.errors[n] = status.error

    def take_motion(self, statuses: Sequence[Status], now_s: float) -> Array:
        """Ten bytes each from present_current on; how old each servo's part is, as `ages`."""
        if isinstance(statuses, CommonFrame) and statuses.ids == self._ids:
            if statuses.errors != self._no_error_bytes:
                self.note(statuses, now_s)
            self.heard_s.fill(now_s)
            self._frame[:] = statuses.stream
            self.pulses[:] = self._positions
            self._current_units[:] = self._currents
            self.effort = np.abs(self._current_units) * self._effort_unit
            return self._no_age_s
        self.note(statuses, now_s)
        if statuses:
            at = [self._index[status.servo_id] for status in statuses]
            values = np.frombuffer(b"".join([status.data for status in statuses]), dtype=_MOTION)
            self.pulses[at] = values["position"]
            self.effort = self.effort.copy()
            self.effort[at] = np.abs(values["current"]) * self._effort_unit[at]
        ages_s = self.ages(statuses, now_s)
        self.unanswered = _read_only(self.unanswered + (ages_s > 0.0))
        return ages_s

    def ages(self, found: Sequence[Status], now_s: float) -> Array:
        """How old each servo's part of a reading is; 0 for those just found."""
        ages = np.maximum(now_s - self.heard_s, 1e-9)
        ages[[self._index[status.servo_id] for status in found]] = 0.0
        return ages

    def health(self, now_s: float) -> Health:
        """For others to keep."""
        return Health(
            silent_s=now_s - self.heard_s,
            torque_on=self.torque,
            watchdog_tripped=self.tripped,
            hardware_errors=self.hardware,
            temperature_degc=self.temperature_degc,
            room_degc=self.room_degc,
            voltage_v=self.voltage_v,
            effort=self.effort,
            current_ma=self.effort * self._milliamperes,
            n_unanswered=self.unanswered,
        )


def _read_only(array: NDArray[_Kind]) -> NDArray[_Kind]:
    array.flags.writeable = False
    return array
