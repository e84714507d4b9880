"""The motion profile of one servo: how its registers make a speed and an acceleration.

https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#what-is-the-profile
"""

import math
from dataclasses import dataclass
from typing import Final

from firmware_bridge.dynamixel.units import PULSES_PER_DEG, VELOCITY_UNIT_DEG_S

#: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#profile-acceleration108 and the next entry
VELOCITY_UNIT: Final = VELOCITY_UNIT_DEG_S * PULSES_PER_DEG
ACCELERATION_UNIT: Final = 214.577 * 6.0 * PULSES_PER_DEG / 60.0
#: "Infinite": faster than any motor.
UNBOUNDED: Final = 1e9
#: Bits 4 and 5 of moving_status, in place:
#: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#moving-status123
STEP, RECTANGLE, TRIANGLE, TRAPEZOID = 0x00, 0x10, 0x20, 0x30


@dataclass(frozen=True, slots=True)
class Course:
    """What one profile bounds, in pulses a second (squared), and its bits of moving_status."""

    top_speed: float
    acceleration: float
    shape: int


@dataclass(frozen=True, slots=True)
class Profile:
    """Profile velocity and acceleration as the registers hold them; 0 = no bound.

    timed: drive mode bit 2. They then are milliseconds: of the whole motion, and of speeding up.
    """

    timed: bool
    velocity: int
    acceleration: int

    @property
    def depends_on_distance(self) -> bool:
        """Whether each goal makes a course of its own."""
        return self.velocity > 0 and (self.timed or self.acceleration > 0)

    def course(self, distance: float, speed: float = 0.0) -> Course:
        """The course to a goal `distance` pulses away, moving towards it at `speed` already.

        With time as its measure the profile takes the time it was given, T, of which it speeds up
        and slows down for t each: distance = speed t / 2 + top speed (T - t).
        """
        if not self.velocity:
            return Course(UNBOUNDED, self._bound, STEP)
        if self.timed:
            return self._timed_course(distance, speed)
        top_speed = self.velocity * VELOCITY_UNIT
        if not self.acceleration:
            return Course(top_speed, UNBOUNDED, RECTANGLE)
        acceleration = self.acceleration * ACCELERATION_UNIT
        reached = math.sqrt(acceleration * distance)
        return Course(top_speed, acceleration, TRIANGLE if reached <= top_speed else TRAPEZOID)

    @property
    def _bound(self) -> float:
        """Without a profile velocity the acceleration still bounds, unless it is a time."""
        if self.timed or not self.acceleration:
            return UNBOUNDED
        return self.acceleration * ACCELERATION_UNIT

    def _timed_course(self, distance: float, speed: float) -> Course:
        total_s = self.velocity * 1e-3
        # As the manual says, speeding up never takes more than half of the time.
        rising_s = min(self.acceleration * 1e-3, 0.5 * total_s)
        top_speed = abs(distance - 0.5 * speed * rising_s) / (total_s - rising_s)
        if not rising_s:
            return Course(max(top_speed, 1e-6), UNBOUNDED, RECTANGLE)
        acceleration = max(top_speed, abs(top_speed - speed)) / rising_s
        shape = TRIANGLE if rising_s >= 0.5 * total_s else TRAPEZOID
        return Course(max(top_speed, 1e-6), max(acceleration, 1e-6), shape)
