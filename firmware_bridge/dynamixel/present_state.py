"""Current and position of every Dynamixel, read in place from the frames of a tick."""

from collections.abc import Sequence

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.dynamixel.mounting import MountedServo, ServoIdentity
from firmware_bridge.dynamixel.wire.codec import CommonFrame, Status
from firmware_bridge.dynamixel.wire.line import FACTORY_RETURN_DELAY_S
from firmware_bridge.serial_servos.state_cache import ServoStateCache

#: present_current .. present_position, as they lie in the control table.
_MOTION = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
#: The same in a common frame.
_MOTION_BLOCK = CommonFrame.block_of(_MOTION)


class PresentState:
    """The last known state of all servos, in `cache`; the methods store what servos answered."""

    def __init__(self, servos: Sequence[MountedServo]) -> None:
        """Start without reports: positions NaN, temperature limits as from the factory."""
        ids = [servo.joint.servo_id for servo in servos]
        hottest = [float(servo.model.defaults["temperature_limit"]) for servo in servos]
        # The least of all models' scales will do: limits are read before anything moves.
        highest = min(servo.model.n_positions for servo in servos) - 1.0
        self.cache = ServoStateCache(ids, highest, hottest, FACTORY_RETURN_DELAY_S)
        units = [s.model.current_unit_ma for s in servos]
        stalls = [s.model.stall_a * 1e3 for s in servos]
        # Models without a current sensor count load in 0.1 %.
        self._effort_unit = np.array(
            [unit / stall if unit else 1e-3 for unit, stall in zip(units, stalls, strict=True)]
        )
        self._milliamperes = np.array(
            [stall if unit else np.nan for unit, stall in zip(units, stalls, strict=True)]
        )
        # The newest common frame of all servos, and views of the values in it.
        self._frame = bytearray(CommonFrame.size_of(len(ids), _MOTION.itemsize))
        blocks = CommonFrame.blocks(self._frame, _MOTION_BLOCK)
        self._positions, self._currents = blocks["position"], blocks["current"]
        self._current_units = np.zeros(len(ids))
        self._no_error_bytes = bytes(len(ids))

    @property
    def current_ma(self) -> Array:
        """Present current of every servo.

        Returns
        -------
        Array
            (n_servos,) mA; NaN where the model does not measure it.
        """
        current_ma: Array = self.cache.effort * self._milliamperes
        return current_ma

    def take_temperature(self, index: int, temperature_degc: int) -> None:
        """Store the temperature of servo `index`, and how far it is below the servo's own limit."""
        cache = self.cache
        cache.set_one("temperature_degc", index, temperature_degc)
        cache.set_one("room_degc", index, cache.hottest[index] - temperature_degc)

    def take_identity(self, index: int, found: ServoIdentity, now_s: float) -> None:
        """Store the limits and return delay of servo `index`, read from its EEPROM at `now_s`."""
        self.cache.take_identity(index, found, found.eeprom["temperature_limit"], now_s)

    def note(self, statuses: Sequence[Status], now_s: float) -> None:
        """Store that servos answered at `now_s`, and the errors in their status packets."""
        cache = self.cache
        for status in statuses:
            n = cache.index[status.servo_id]
            cache.heard_s[n] = now_s
            if status.error:
                self.cache.errors = cache.errors.copy()
                cache.errors[n] = status.error

    def take_motion(self, statuses: Sequence[Status], now_s: float) -> Array:
        """Store position and current from one read of all servos; return how old each is.

        Parameters
        ----------
        statuses : Sequence[Status]
            Ten bytes each, from the register present_current on.
        now_s : float
            Monotonic seconds.

        Returns
        -------
        Array
            (n_servos,) seconds: age of each servo's values; 0 for those that answered.
        """
        cache = self.cache
        # The usual case: all servos answered a fast read in one frame. `_positions` and `_currents`
        # are views of `_frame`, so that a copy of the answer updates them.
        if isinstance(statuses, CommonFrame) and statuses.ids == cache.ids:
            if statuses.errors != self._no_error_bytes:
                self.note(statuses, now_s)
            cache.heard_s.fill(now_s)
            self._frame[:] = statuses.stream
            cache.pulses[:] = self._positions
            self._current_units[:] = self._currents
            self.cache.effort = np.abs(self._current_units) * self._effort_unit
            return cache.no_age_s
        # Otherwise: a frame for each servo, or servos are missing.
        self.note(statuses, now_s)
        if statuses:
            at = [cache.index[status.servo_id] for status in statuses]
            values = np.frombuffer(b"".join([status.data for status in statuses]), dtype=_MOTION)
            cache.pulses[at] = values["position"]
            self.cache.effort = cache.effort.copy()
            cache.effort[at] = np.abs(values["current"]) * self._effort_unit[at]
        ages_s = cache.ages([status.servo_id for status in statuses], now_s)
        cache.count_silent(ages_s)
        return ages_s
