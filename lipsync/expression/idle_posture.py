"""A head that is alive where nobody speaks, and quiet: it holds, makes a small move, and holds.

A gear train that always moves is heard in a silent room and wears. So idle motion is no drift but
moves with rests between them, each paid for out of a budget of travel (docs/expression.md).
"""

import math
from random import Random
from typing import Final

from lipsync.expression.bounded import smoothstep
from lipsync.expression.cue import CUE_PERIOD_S

#: Mean speed of each axis of the neck in idle, at most; and how much travel may be saved up.
BUDGET_DEG_S: Final = 0.4
_MOST_SAVED_DEG, _FIRST_SAVED_DEG = 10.0, 1.0
#: Between moves: mean and standard deviation, beyond the shortest pause.
_SHORTEST_PAUSE_S, _PAUSE_S, _PAUSE_SD_S = 2.0, 5.0, 3.0
#: Every other move is a breath: up, a moment, and down, 3.8 s in all (0.26 Hz).
_BREATHING = 0.5
_LEAST_BREATH_DEG, _MOST_BREATH_DEG = 0.4, 0.8
_IN_S, _FULL_S, _OUT_S = 1.5, 0.5, 1.8
#: The others go to the other side of the middle; less than four pulses of a servo of 0.088
#: degrees a pulse would be gear noise and nothing seen.
_FURTHEST_DEG, _LEAST_MOVE_DEG = 0.9, 0.35
_MOVE_S = 1.2
#: The head goes along with a look away only where its part is as large.
_LEAST_TURN_DEG = 3.0
_SETTLING_S = 2.0


class _Axis:
    """One angle that holds or is on its way, and what it may still travel."""

    def __init__(self) -> None:
        self.angle_deg = 0.0
        self.goal_deg = 0.0
        self.home_deg = 0.0
        self.saved_deg = _FIRST_SAVED_DEG
        self._start_deg = 0.0
        self._elapsed_s = 0.0
        self._duration_s = _MOVE_S
        self.is_moving = False

    def go(self, goal_deg: float, duration_s: float) -> None:
        self._start_deg, self.goal_deg = self.angle_deg, goal_deg
        self._elapsed_s, self._duration_s = 0.0, duration_s
        self.is_moving = goal_deg != self.angle_deg

    def step(self) -> float:
        if self.is_moving:
            self._elapsed_s += CUE_PERIOD_S
            share = smoothstep(self._elapsed_s / self._duration_s)
            self.is_moving = share < 1.0
            way_deg = self.goal_deg - self._start_deg
            self.angle_deg = self._start_deg + share * way_deg if share < 1.0 else self.goal_deg
        return self.angle_deg

    def affordable(self, way_deg: float) -> float:
        """As much of a way as can be gone there and back."""
        return math.copysign(min(abs(way_deg), self.saved_deg / 2.0), way_deg)

    def pays(self, travel_deg: float) -> bool:
        if travel_deg > self.saved_deg:
            return False
        self.saved_deg -= travel_deg
        return True


class IdlePosture:
    """Pitch, yaw and roll of a head in idle."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._pitch, self._yaw, self._roll = self._axes = (_Axis(), _Axis(), _Axis())
        self._pause_s = self._drawn_pause_s()
        self._breath_left_s = 0.0
        self._is_turned = False

    def step(self, turn_deg: tuple[float, float]) -> tuple[float, float, float]:
        """One cue later, of idle. turn_deg: (yaw, pitch) of the head's part of a look away."""
        for axis in self._axes:
            axis.saved_deg = min(_MOST_SAVED_DEG, axis.saved_deg + BUDGET_DEG_S * CUE_PERIOD_S)
        if self._breath_left_s > 0.0:
            self._breathe_out()
        elif not (self._pitch.is_moving or self._yaw.is_moving or self._roll.is_moving):
            self._pause_s -= CUE_PERIOD_S
            if self._is_turned:
                self._turn_back(turn_deg)
            elif math.hypot(*turn_deg) >= _LEAST_TURN_DEG:
                self._turn(turn_deg)
            if self._pause_s <= 0.0 and not self._is_turned:
                self._pause_s = self._drawn_pause_s()
                self._begin_move()
        return self.follow()

    def follow(self) -> tuple[float, float, float]:
        """One cue later: what has begun goes on, nothing begins."""
        return self._pitch.step(), self._yaw.step(), self._roll.step()

    def settle(self) -> None:
        """Go to the middle, whatever the budget says; call it once, then `follow`."""
        self._breath_left_s = 0.0
        self._is_turned = False
        for axis in self._axes:
            axis.home_deg = 0.0
            axis.go(0.0, _SETTLING_S)

    def _drawn_pause_s(self) -> float:
        shape = (_PAUSE_S / _PAUSE_SD_S) ** 2
        return _SHORTEST_PAUSE_S + self._random.gammavariate(shape, _PAUSE_S / shape)

    def _begin_move(self) -> None:
        random = self._random
        if random.random() < _BREATHING:
            size_deg = random.uniform(_LEAST_BREATH_DEG, _MOST_BREATH_DEG)
            if self._pitch.pays(2.0 * size_deg):
                self._pitch.go(self._pitch.home_deg + size_deg, _IN_S)
                self._breath_left_s = _IN_S + _FULL_S
            return
        axis = random.choice(self._axes)
        travel_deg = random.uniform(_LEAST_MOVE_DEG, _FURTHEST_DEG)
        if axis.pays(travel_deg):
            axis.home_deg -= math.copysign(travel_deg, axis.home_deg)
            axis.go(axis.home_deg, _MOVE_S)

    def _breathe_out(self) -> None:
        self._breath_left_s -= CUE_PERIOD_S
        if self._breath_left_s <= 0.0:
            self._pitch.go(self._pitch.home_deg, _OUT_S)

    def _turn(self, turn_deg: tuple[float, float]) -> None:
        """As far as there and back can be paid, so that the head never stays turned for want of it.

        What is too small to be worth it is left to the eyes.
        """
        yaw_deg, pitch_deg = self._yaw.affordable(turn_deg[0]), self._pitch.affordable(turn_deg[1])
        if math.hypot(yaw_deg, pitch_deg) < _LEAST_TURN_DEG:
            return
        self._is_turned = True
        for axis, way_deg in ((self._yaw, yaw_deg), (self._pitch, pitch_deg)):
            if abs(way_deg) >= _LEAST_MOVE_DEG and axis.pays(2.0 * abs(way_deg)):
                axis.go(axis.home_deg + way_deg, _MOVE_S)

    def _turn_back(self, turn_deg: tuple[float, float]) -> None:
        if math.hypot(*turn_deg) < _LEAST_TURN_DEG:
            self._is_turned = False
            self._yaw.go(self._yaw.home_deg, _MOVE_S)
            self._pitch.go(self._pitch.home_deg, _MOVE_S)
