"""Torque of single servos: who may hold, how it comes on without a jump, and off for certain."""

import struct
from collections.abc import Sequence
from typing import Final

from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.handshake import identify, mismatches
from firmware_bridge.dynamixel.mounting import MountedServo, Mounting
from firmware_bridge.dynamixel.soft_start import SoftStart
from firmware_bridge.dynamixel.state_cache import ServoStateCache
from firmware_bridge.dynamixel.watchdog import Watchdogs
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.verified_write import write_verified

_TORQUE, _GOAL = register("torque_enable").address, register("goal_position").address
_PLACE, _LEVEL = register("present_position").address, register("status_return_level").address
#: Torque comes on one servo after another: twenty at once make the supply sag.
_STAGGER_S: Final = 0.010
#: In a tick there is no time for more; whoever is there answers the first or second question.
_TRIES: Final = 2


class TorqueSwitch:
    """Switches torque of one servo at a time. Every method may raise PortError."""

    def __init__(
        self,
        servos: Sequence[MountedServo],
        cache: ServoStateCache,
        mounting: Mounting,
        soft_start: SoftStart,
        watchdogs: Watchdogs,
    ) -> None:
        self._servos = tuple(servos)
        self._cache = cache
        self._mounting = mounting
        self._soft_start = soft_start
        self._watchdogs = watchdogs

    def obstacle(self, line: Line, index: int) -> str:
        """Why this servo cannot hold where it stands; empty: it can."""
        return self._place_to_hold(line, index)[0]

    def enable(self, line: Line, index: int) -> str:
        """Let it hold where it stands; why it does not, empty: it confirmed."""
        cache, servo_id = self._cache, self._servos[index].joint.servo_id
        obstacle, place = self._place_to_hold(line, index)
        if obstacle:
            return obstacle
        # First of all, since a tripped watchdog refuses every goal.
        if not self._watchdogs.start(line, servo_id):
            return "does not take its bus watchdog"
        if not write_verified(line, servo_id, _GOAL, struct.pack("<i", place)):
            return "does not take the place where it stands as its goal"
        cache.goals[index] = cache.pulses[index] = place
        cache.set_one("tripped", index, False)
        if not self._soft_start.apply_soft_limits(line, index):
            return "does not take its slow start"
        cache.enabled[index] = True
        if not write_verified(line, servo_id, _TORQUE, b"\1"):
            self.disable(line, index)
            return "does not switch its torque on"
        cache.set_one("torque", index, True)
        now_s = line.transport.clock.now()
        self._soft_start.note_torque_on(index, now_s)
        self._watchdogs.spoke(now_s)
        line.transport.clock.sleep_until(now_s + _STAGGER_S)
        return ""

    def keep(self, line: Line, index: int) -> bool:
        """Whether a servo that holds goes on holding where it stands; switches nothing on."""
        cache, servo_id = self._cache, self._servos[index].joint.servo_id
        torque = line.read(servo_id, _TORQUE, 1)
        if torque is None or torque.data != b"\1":
            return False
        cache.enabled[index] = True
        cache.set_one("torque", index, True)
        place = self._place(line, servo_id)
        if place is None or not self._watchdogs.start(line, servo_id):
            return False
        cache.goals[index] = cache.pulses[index] = place
        cache.set_one("tripped", index, False)
        return write_verified(line, servo_id, _GOAL, struct.pack("<i", place))

    def disable(self, line: Line, index: int) -> bool:
        """Torque off; whether it was read back."""
        limp = write_verified(line, self._servos[index].joint.servo_id, _TORQUE, b"\0")
        if limp:
            self._cache.enabled[index] = False
            self._cache.set_one("torque", index, False)
        return limp

    def renew_watchdog(self, line: Line, index: int, found: int) -> None:
        """A watchdog that is off while torque is on protects nobody: set it again."""
        tripped, wanted = 0xFF, self._watchdogs.setting
        if self._cache.enabled[index] and found not in (wanted, tripped):
            self._watchdogs.start(line, self._servos[index].joint.servo_id)

    def _place_to_hold(self, line: Line, index: int) -> tuple[str, int]:
        """What is in the way, or nothing and the place in pulses."""
        servo, cache = self._servos[index], self._cache
        servo_id = servo.joint.servo_id
        said = identify(line, servo, tries=_TRIES)
        if said is None:
            return "does not answer; check its power and cable", 0
        wrong = mismatches(servo, said)
        if wrong:
            return "; ".join(wrong), 0
        cache.take_identity(index, said, line.transport.clock.now())
        line.return_delay_s = float(cache.return_delay_s.max())
        line.write(servo_id, _LEVEL, b"\2")
        place = self._place(line, servo_id)
        if place is None:
            return "does not say where it stands", 0
        low, high = int(cache.low[index]), int(cache.high[index])
        if low <= place <= high:
            return "", place
        here_deg, *ends_deg = (self._mounting.one_deg(index, each) for each in (place, low, high))
        return (
            f"stands at {here_deg:.1f} deg, outside its own range; move it into "
            f"{min(ends_deg):.1f}..{max(ends_deg):.1f} deg by hand",
            0,
        )

    def _place(self, line: Line, servo_id: int) -> int | None:
        for _ in range(_TRIES):
            status = line.read(servo_id, _PLACE, 4)
            if status is not None and len(status.data) == 4:
                return int.from_bytes(status.data, "little", signed=True)
        return None
