"""Torque of single Feetech servos: on without a jump or jerk, off until confirmed, off by force."""

from collections.abc import Collection, Sequence

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.capabilities import SOFT_START_S
from firmware_bridge.feetech import codec
from firmware_bridge.feetech.control_table import CONTROL, TORQUE_ENABLE
from firmware_bridge.feetech.line import Line
from firmware_bridge.feetech.mounting import MountedServo, ServoIdentity, identify, mismatches
from firmware_bridge.feetech.present_state import PresentState
from firmware_bridge.serial_servos.mounting import Mounting
from firmware_bridge.serial_servos.torque import (
    SOFT_DEG_S,
    SOFT_STRENGTH,
    SPEED_MARGIN,
    WRITE_TRIES,
    SerialRelease,
    SerialTorqueSwitch,
    write_verified,
)


def torque_verified(line: Line, servo_id: int, *, on: bool) -> bool:
    """Set torque to `on` until a read confirms it, three times at most; return whether it did."""
    for _ in range(WRITE_TRIES):
        line.tell(codec.torque((servo_id,), on=on))
        status = line.read(servo_id, TORQUE_ENABLE, 1)
        if status is not None and status.data == (b"\1" if on else b"\0"):
            return True
    return False


class TorqueSwitch(SerialTorqueSwitch[Line]):
    """Switches torque of one Feetech servo at a time. Every method may raise PortError.

    A goal switches torque on by itself in servos that are limp, so a servo gets its limits before
    its goal, its goal before its torque, and no goals once its torque goes off.
    """

    torque_address = TORQUE_ENABLE
    identify, mismatches = staticmethod(identify), staticmethod(mismatches)

    def __init__(
        self, servos: Sequence[MountedServo], present: PresentState, mounting: Mounting
    ) -> None:
        """Switch torque of `servos`, all of one dialect; no servo gets goals yet.

        present: their last known state. Public arrays are (n_servos,), read by the bus in a tick.
        """
        super().__init__(servos, present, mounting)
        n = len(servos)
        #: Servos that get goals; others get none, since a goal may switch torque on.
        self.driven = np.zeros(n, dtype=np.bool_)
        #: Servos that missed an answer: no goals until a read shows that they have not restarted.
        self.doubted = np.zeros(n, dtype=np.bool_)
        self._dialect = servos[0].model.dialect
        self._identities: list[ServoIdentity | None] = [None] * n
        #: Values of register goal_speed: of a soft start, the largest that may be sent now, and the
        #: one for a position step a second.
        self.slow, self.top, self.units = np.ones(n), np.ones(n), np.ones(n)
        #: The torque_limit that was set; when a soft start ends, infinite: none is under way.
        self._strengths = [0] * n
        self._full_at_s = np.full(n, np.inf)
        self._goal = self._dialect.registers["goal_position"].address

    def take_identity(self, index: int, found: ServoIdentity, now_s: float) -> None:
        """Store a servo's own settings, read at `now_s`, which are used from now on."""
        self._identities[index] = found
        super().take_identity(index, found, now_s)

    @property
    def at_full_strength(self) -> bool:
        """Whether no servo with torque on is still limited by its slow start."""
        return not np.isfinite(self._full_at_s).any()

    def disable(self, line: Line, index: int) -> bool:
        """Switch torque off; return whether the servo confirmed it."""
        self.driven[index] = self.doubted[index] = False
        self._full_at_s[index] = np.inf
        return super().disable(line, index)

    def cancel(self) -> None:
        """Mark all servos as not driven: none gets goals or full strength now; sends nothing."""
        self.driven[:] = self.doubted[:] = False
        self._full_at_s[:] = np.inf

    def _prepare(self, line: Line, index: int, place: int) -> str:
        """Set soft limits, then `place` as the goal, before torque on; return what is refused.

        "": nothing was refused. place: present position in encoder steps. The goal may switch
        torque on already; if the servo does not confirm the goal, torque is switched off.
        """
        if not self._bound(line, index, soft=True):
            return "does not take its slow start"
        self._cache.enabled[index] = True
        self._cache.torque.forget((index,))  # a goal may switch it on
        if self._take_goal(line, index, place):
            return ""
        self._switch(line, index, on=False)
        return "does not take the place where it stands as its goal"

    def _begin_soft_start(self, index: int, now_s: float) -> None:
        self.driven[index] = True
        self._full_at_s[index] = now_s + SOFT_START_S

    def _hold(self, line: Line, index: int) -> bool:
        """Set full limits and the present position as the goal; return whether reads confirm both.

        False, too, for a servo that never answered or may not be driven. Only if True is it sent
        goals afterwards.
        """
        if self._identities[index] is None:
            return False
        self._cache.enabled[index] = True
        obstacle, place = self._place_to_hold(line, index)
        if obstacle or not self._bound(line, index, soft=False):
            return False
        self.driven[index] = self._take_goal(line, index, place)
        return bool(self.driven[index])

    def _set_torque(self, line: Line, servo_id: int, *, on: bool) -> bool:
        return torque_verified(line, servo_id, on=on)

    def doubt(self, ages_s: Array) -> None:
        """Withhold goals from driven servos that missed an answer just now, and may have restarted.

        Parameters
        ----------
        ages_s : Array
            (n_servos,) seconds; 0 for servos that just answered.
        """
        silent = self.driven & (ages_s > 0.0)
        self.doubted |= silent
        self.driven &= ~silent

    def look_after(self, line: Line, index: int, control: bytes) -> None:
        """Set full strength when due; switch off a servo that lost its limits in a restart.

        control: the servo's registers from torque_enable on, read just now. After a brown-out a
        servo may come back with torque on, but without the speed and torque limits set before. A
        servo that has them gets goals again.
        """
        self.note(index, control, line.transport.clock.now())
        if self.doubted[index] and not control[0]:
            self.doubted[index] = False  # limp: `enable` will set its limits anew
        if not (self.driven[index] or self.doubted[index]) or not control[0]:
            return
        of, speed = self._dialect, self._dialect.decode("goal_speed", control, CONTROL)
        strength = self._strengths[index]
        if "torque_limit" in of.registers:
            strength = of.decode("torque_limit", control, CONTROL)
        if not 0 < speed <= self.top[index] or strength != self._strengths[index]:
            self.disable(line, index)
            return
        self.driven[index], self.doubted[index] = True, False
        is_due = self._full_at_s[index] <= line.transport.clock.now()
        if is_due and self._bound(line, index, soft=False):
            self._full_at_s[index] = np.inf

    def _bound(self, line: Line, index: int, *, soft: bool) -> bool:
        """Limit a servo's speed and, if possible, its torque; return whether reads confirm both.

        soft: the low limits of a soft start, otherwise those of the joint. A servo that cannot go
        as fast as the joint's limit stores its own top speed instead, which is accepted. The full
        torque limit is one step below the value after a restart, by which restarts are detected.
        """
        servo, found, dialect = self._servos[index], self._identities[index], self._dialect
        if found is None:
            return False
        servo_id, registers = servo.joint.servo_id, dialect.registers
        full_deg_s = servo.joint.max_speed_deg_s * SPEED_MARGIN
        slow = found.speed_register(min(SOFT_DEG_S, full_deg_s), dialect)
        speed = slow if soft else found.speed_register(full_deg_s, dialect)
        if "acceleration" in registers:
            line.write(servo_id, registers["acceleration"].address, b"\0")
        if "torque_limit" in registers:
            limit = found.eeprom["max_torque"]
            limit = max(1, round(limit * SOFT_STRENGTH) if soft else limit - 1)
            data = dialect.encode("torque_limit", limit)
            if not write_verified(line, servo_id, registers["torque_limit"].address, data):
                return False
            self._strengths[index] = limit
        for _ in range(WRITE_TRIES):
            address = registers["goal_speed"].address
            line.write(servo_id, address, dialect.encode("goal_speed", speed))
            status = line.read(servo_id, address, registers["goal_speed"].size)
            if status is not None:
                # What the servo has stored: `speed`, or less if it cannot go as fast.
                kept = dialect.decode("goal_speed", status.data, address)
                if 0 < kept <= speed:
                    self.slow[index], self.top[index] = min(slow, kept), kept
                    self.units[index] = found.speed_unit
                    return True
        return False

    def _take_goal(self, line: Line, index: int, place: int) -> bool:
        data = self._dialect.encode("goal_position", place)
        taken = write_verified(line, self._servos[index].joint.servo_id, self._goal, data)
        if taken:
            self._cache.goals[index] = self._cache.pulses[index] = place
        return taken


class LineRelease(SerialRelease[Line]):
    """Torque off at an open port, for Feetech servos that another process drove before."""

    make_line = Line
    torque_address = TORQUE_ENABLE

    def tell_all(self, addresses: Sequence[int]) -> None:
        """Send torque off to these addresses and to all servos, twice each."""
        for ids in (tuple(addresses), (), tuple(addresses), ()):
            self._line.tell(codec.torque(ids, on=False))

    def _tell_off(self, address: int) -> None:
        self._line.tell(codec.torque((address,), on=False))

    def _wait_out(self) -> None:
        self._line.read(codec.MAX_ID, TORQUE_ENABLE, 1)

    def _scan(self, _known: Collection[int]) -> Collection[int]:
        return self._line.scan()
