"""Position, load, temperature and errors of every Feetech servo, read in place from its answers."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_bridge.bus import Array, HardwareError
from firmware_bridge.feetech.codec import EMPTY_SIZE, Status
from firmware_bridge.feetech.control_table import STATE
from firmware_bridge.feetech.mounting import MountedServo, ServoIdentity
from firmware_bridge.serial_servos.state_cache import ROOM_DEGC, ServoStateCache, read_only

#: The hardware error for each bit of register `status`; too much current counts as overload.
_MEANINGS: Final = {
    0x01: HardwareError.INPUT_VOLTAGE,
    0x02: HardwareError.ENCODER,
    0x04: HardwareError.OVERHEATING,
    0x08: HardwareError.OVERLOAD,
    0x20: HardwareError.OVERLOAD,
}
#: The bits above; in some firmware bit 4 says that torque is on.
_STATUS_BITS: Final = sum(_MEANINGS)
_HARDWARE: Final = np.array(
    [sum({error for bit, error in _MEANINGS.items() if bit & bits}) for bits in range(256)],
    dtype=np.uint8,
)


def hardware_errors(status: int) -> int:
    """Return the bits of `HardwareError` for a value of register `status`."""
    return int(_HARDWARE[status & _STATUS_BITS])


class PresentState:
    """The last known state of all servos, in `cache`; the methods store what servos answered.

    Errors are kept until the servo is restarted.
    """

    def __init__(self, servos: Sequence[MountedServo]) -> None:
        """Start without reports: positions NaN. All `servos` are of one dialect.

        `_frame` holds each servo's newest answer, in the face's order; the arrays of values are
        views into `_frame`, so that a copy of all answers updates them.
        """
        n, dialect = len(servos), servos[0].model.dialect
        ids = [servo.joint.servo_id for servo in servos]
        hottest = [servo.model.hottest_degc for servo in servos]
        self.cache = ServoStateCache(ids, dialect.n_positions - 1.0, hottest, return_delay_s=0.0)
        self._step = dialect.state_size + EMPTY_SIZE
        self._frame = bytearray(n * self._step)
        number = "<u2" if dialect.byte_order == "little" else ">u2"
        # Offsets from register `STATE` on; an answer has five bytes before its data.
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
        # Where the high byte of each position is, which has the sign.
        high_byte = EMPTY_SIZE - (0 if dialect.byte_order == "little" else 1)
        self._high_bytes = slice(high_byte, None, self._step)
        self._seen = b""
        self._heard = np.zeros(n, dtype=np.bool_)  # by this read; `enable` asks for places alone
        self._all_heard = False

    @property
    def current_ma(self) -> Array:
        """Present current of every servo.

        Returns
        -------
        Array
            (n_servos,) mA; NaN where the dialect has no current register.
        """
        if self._currents is None or self._current_unit_ma is None:
            return np.full(len(self.cache.ids), np.nan)
        return np.asarray((self._currents & 0x7FFF) * self._current_unit_ma, np.float64)

    def take_identity(self, index: int, found: ServoIdentity, now_s: float) -> None:
        """Store the limits and return delay of servo `index`, read from its EEPROM at `now_s`."""
        self.cache.take_identity(index, found, found.eeprom["max_temperature"], now_s)
        self._seen = b""

    def take_state(self, found: bytes | list[Status], now_s: float) -> Array:
        """Store one read of all servos' registers from `STATE` on; return how old each servo's are.

        Parameters
        ----------
        found : bytes | list[Status]
            The answers, as returned by `Group.ask`.
        now_s : float
            Monotonic seconds.

        Returns
        -------
        Array
            (n_servos,) seconds: age of each servo's values; 0 for those that answered.
        """
        cache = self.cache
        if isinstance(found, bytes):  # all answered, in the face's order
            self._frame[:] = found
            cache.heard_s.fill(now_s)
            self._all_heard = True
            ages_s = cache.no_age_s
        else:
            for status in found:
                n = cache.index[status.servo_id]
                at = n * self._step + EMPTY_SIZE - 1
                self._frame[at : at + len(status.data)] = status.data
                cache.heard_s[n] = now_s
            ages_s = cache.ages([status.servo_id for status in found], now_s)
            cache.count_silent(ages_s)
        pulses: Array = self._places()
        if ages_s is not cache.no_age_s:  # of a silent one what `enable` or `keep` found is newer
            pulses = np.where(ages_s > 0.0, cache.pulses, pulses)
        # The load has 10 bits, in 0.1 % of the stall torque; bit 10 is its direction.
        self.cache.effort = np.asarray((self._loads & 0x3FF) * 1e-3, np.float64)
        self._take_conditions()
        if not self._all_heard:  # values of servos that have never answered are unknown
            self._heard |= ages_s == 0.0
            ever = self._heard
            self._all_heard = bool(ever.all())
            self.cache.voltage_v = np.where(ever, cache.voltage_v, np.nan)
            self.cache.temperature_degc = np.where(ever, cache.temperature_degc, np.nan)
            self.cache.room_degc = np.where(ever, cache.room_degc, ROOM_DEGC)
        self.cache.pulses = pulses
        return ages_s

    def _places(self) -> Array:
        places: Array = self._positions.astype(np.float64)
        if self._signed and max(self._frame[self._high_bytes]) & 0x80:
            return np.where(places >= 0x8000, 0x8000 - places, places)
        return places

    def _take_conditions(self) -> None:
        """Store voltage, temperature and errors of the newest answers, if any has changed.

        Error bits add up; `forget_trouble` clears them.
        """
        of, cache = self._conditions, self.cache
        seen = b"".join([values.tobytes() for values in of.values()])
        if seen == self._seen and self._all_heard:
            return
        self._seen = seen
        self.cache.voltage_v = of["voltage"] * 0.1
        self.cache.temperature_degc = of["temperature"].astype(np.float64)
        self.cache.room_degc = cache.hottest - cache.temperature_degc
        now = _HARDWARE[of["status"] & _STATUS_BITS]
        self.cache.hardware = read_only(cache.hardware | now)

    def forget_trouble(self, index: int) -> None:
        """Clear the stored errors of a servo that was restarted."""
        self.cache.set_one("hardware", index, 0)
        self._seen = b""
