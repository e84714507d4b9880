"""Torque on without a jerk: slow and weak at first, full speed and strength a second later."""

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_bridge.arrays import any_set
from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.units import VELOCITY_UNIT_DEG_S
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.verified_write import write_verified

_PROFILE: Final = register("profile_acceleration").address
_CURRENT: Final = register("goal_current").address
#: A servo whose torque has just come on goes no faster, and pulls no harder where it has a current
#: cap, for a while.
_SOFT_DEG_S: Final = 60.0
_SOFT_STRENGTH: Final = 0.3
SOFT_FOR_S: Final = 1.0
#: The servo itself goes this much faster than the gate allows, so that it does not fall behind by
#: rounding. What a person is told as the fastest is the fastest, to a twentieth.
_SPEED_MARGIN: Final = 1.05
#: Nobody acknowledges a sync write: full strength is said so often, this far apart.
_REPEATS: Final = 3
_REPEAT_S: Final = 0.1


class SoftStart:
    """Knows which servos are still limited, and lifts the limits when their time has come."""

    def __init__(self, servos: Sequence[MountedServo]) -> None:
        self._servos = tuple(servos)
        self._due_s = np.full(len(servos), np.inf)
        self._n_left = np.zeros(len(servos), dtype=np.int8)

    @property
    def is_active(self) -> bool:
        """Whether any servo has yet to be told of its full strength."""
        return bool(self._n_left.any())

    def apply_soft_limits(self, line: Line, index: int) -> bool:
        """Before torque comes on: slow, weak where there is a cap; whether it confirmed."""
        servo = self._servos[index]
        servo_id, cap = servo.joint.servo_id, servo.current_cap
        slow_deg_s = min(_SOFT_DEG_S, servo.joint.max_speed_deg_s)
        wanted = [(_PROFILE, struct.pack("<II", 0, _velocity(slow_deg_s)))]
        if cap is not None:
            weak = max(1, round(cap * _SOFT_STRENGTH))
            wanted.append((_CURRENT, struct.pack("<h", weak)))
        return all(write_verified(line, servo_id, *each) for each in wanted)

    def note_torque_on(self, index: int, now_s: float) -> None:
        """Torque came on now."""
        self._due_s[index] = now_s + SOFT_FOR_S
        self._n_left[index] = _REPEATS

    def cancel(self) -> None:
        """Torque is off everywhere."""
        self._due_s[:] = np.inf
        self._n_left[:] = 0

    def restore_full_limits(self, line: Line) -> None:
        """Full speed and strength a second after torque came on; call it again and again."""
        if not any_set(self._n_left):
            return
        now_s = line.transport.clock.now()
        due = np.flatnonzero(self._due_s <= now_s).tolist()
        if not due:
            return
        servos = [self._servos[n] for n in due]
        profiles = [(each.joint.servo_id, _full_profile(each)) for each in servos]
        line.tell(codec.sync_write(_PROFILE, 8, profiles))
        caps = [(s.joint.servo_id, s.current_cap) for s in servos]
        currents = [(each, struct.pack("<h", cap)) for each, cap in caps if cap is not None]
        if currents:
            line.tell(codec.sync_write(_CURRENT, 2, currents))
        self._n_left[due] -= 1
        self._due_s[due] = np.where(self._n_left[due] > 0, now_s + _REPEAT_S, np.inf)


def _full_profile(servo: MountedServo) -> bytes:
    return struct.pack("<II", 0, _velocity(servo.joint.max_speed_deg_s * _SPEED_MARGIN))


def _velocity(deg_s: float) -> int:
    """In units of the profile velocity register, at least 1: 0 would mean without bound."""
    return max(1, min(32_767, round(deg_s / VELOCITY_UNIT_DEG_S)))
