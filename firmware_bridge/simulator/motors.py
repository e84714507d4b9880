"""The motors of simulated servos, as arrays: profile, speed, load, current, heat, supply."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array
from firmware_bridge.dynamixel.control_table import VELOCITY_UNIT_DEG_S, servo_models

#: The simulation's own unit of a shaft's place is the pulse of this model, whatever the register of
#: a servo counts.
_UNIT: Final = servo_models()["XL330-M288"]
PULSES_PER_DEG: Final = _UNIT.pulses_per_deg
CENTER_PULSE: Final = _UNIT.center_pulse
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
    """Top speed (pulses/s) and acceleration (pulses/s^2) of a motor's motion to a goal.

    shape: the motion's bits in the register moving_status.
    """

    top_speed: float
    acceleration: float
    shape: int


@dataclass(frozen=True, slots=True)
class Profile:
    """Profile velocity and acceleration as the registers hold them; 0 = no bound.

    timed: drive mode bit 2: both are times in ms, of the whole motion and of speeding up.
    """

    timed: bool
    velocity: int
    acceleration: int

    @property
    def depends_on_distance(self) -> bool:
        """Whether each goal's distance must be known to compute its course."""
        return self.velocity > 0 and (self.timed or self.acceleration > 0)

    def course(self, distance: float, speed: float = 0.0) -> Course:
        """Return the course to a goal `distance` pulses away, moving towards it at `speed` already.

        speed: pulses/s. With a timed profile the motion takes the time T of the register velocity,
        and speeds up and slows down for t each: distance = speed t / 2 + top speed (T - t).
        """
        acceleration = self.acceleration * ACCELERATION_UNIT or UNBOUNDED  # 0: no bound
        if not self.velocity:
            return Course(UNBOUNDED, UNBOUNDED if self.timed else acceleration, STEP)
        if self.timed:
            return self._timed_course(distance, speed)
        top_speed = self.velocity * VELOCITY_UNIT
        if not self.acceleration:
            return Course(top_speed, acceleration, RECTANGLE)
        reached = math.sqrt(acceleration * distance)
        return Course(top_speed, acceleration, TRIANGLE if reached <= top_speed else TRAPEZOID)

    def _timed_course(self, distance: float, speed: float) -> Course:
        """Return `course` of a timed profile, whose velocity and acceleration are times in ms.

        distance: pulses; speed: present speed towards the goal, pulses/s.
        """
        total_s = self.velocity * 1e-3
        # As the manual says, speeding up never takes more than half of the time.
        rising_s = min(self.acceleration * 1e-3, 0.5 * total_s)
        # From distance = speed t / 2 + top speed (T - t), with T: total_s, t: rising_s.
        top_speed = abs(distance - 0.5 * speed * rising_s) / (total_s - rising_s)
        if not rising_s:
            return Course(max(top_speed, 1e-6), UNBOUNDED, RECTANGLE)
        acceleration = max(top_speed, abs(top_speed - speed)) / rising_s
        shape = TRIANGLE if rising_s >= 0.5 * total_s else TRAPEZOID
        return Course(max(top_speed, 1e-6), max(acceleration, 1e-6), shape)


#: The integration has fixed steps, so that the motion does not depend on when `advance` is called.
#: Short against any profile; between two steps positions go on in straight lines.
_STEP_S = 0.005
#: How fast the position loop closes an error, 1/s. It has no feedforward, as the factory settings
#: have none, so a shaft is 12 ms behind its trajectory and never quicker. Ours; not measured.
POSITION_LOOP_PER_S = 80.0
_AT_REST_PULSES = 0.01
#: moving_status: so near counts as arrived, so far from the trajectory as not following. The manual
#: names no numbers; these are ours.
_IN_POSITION_PULSES = 10.0
_FOLLOWING_PULSES = 60.0
_IN_POSITION, _ONGOING, _NOT_FOLLOWING = 1, 2, 8
#: goal_pwm and present_pwm at the full voltage:
#: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#goal-pwm100
FULL_PWM = 885

#: Bits of hardware_error_status: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#hardware-error-status70
VOLTAGE_ERROR, HEAT_ERROR, ENCODER_ERROR, SHOCK_ERROR, OVERLOAD_ERROR = 1, 4, 8, 16, 32


@dataclass(frozen=True, slots=True)
class Environment:
    """Properties that the manual does not state, as parameters; none was measured on a servo.

    overload_share: share of the stall torque that counts as overload after `overload_after_s`.
    heat_deg_s: warming at stall current; cooling_s: time constant of cooling.
    supply_ohm: resistance of supply and cable, common to all servos.
    """

    supply_v: float | None = None  # None: each model's nominal voltage
    supply_ohm: float = 0.05
    ambient_degc: float = 25.0
    heat_deg_s: float = 1.0
    cooling_s: float = 120.0
    overload_share: float = 0.8
    overload_after_s: float = 1.0
    standby_a: float = 0.017  # XL330 specifications


class MotorModel(Protocol):
    """The data of the motor of one servo model."""

    @property
    def nominal_voltage_v(self) -> float:
        """The voltage in V at which the other data are true."""

    @property
    def no_load_deg_s(self) -> float:
        """Top speed without load, in degrees per second."""

    @property
    def stall_a(self) -> float:
        """Current at stall, in A."""

    @property
    def current_unit_ma(self) -> float | None:
        """The unit in mA of the present-current register; None: that register counts load."""


class Motors:
    """All motors of a chain; positions in pulses, speeds in pulses a second. Arrays are (n,).

    Positions are the shafts' own, counter-clockwise, `CENTER_PULSE` in the middle of the first
    turn. A register shows `sign` x position + `zero`: equal, unless the servo is reversed, has a
    homing offset, or counts another turn.
    Set goal, torque, course, load and jam, call `advance`, and read the other arrays.
    """

    def __init__(self, models: Sequence[MotorModel], environment: Environment) -> None:
        """Start all motors in the middle of their range, without torque, at ambient temperature.

        trajectory: where the profile is now; position: where the shaft is, which follows.
        """
        n = len(models)
        self._environment = environment
        self.no_load = np.array([m.no_load_deg_s * PULSES_PER_DEG for m in models])
        self._stall_a = np.array([m.stall_a for m in models])
        self._nominal_v = np.array([m.nominal_voltage_v for m in models])
        self.supply_v = self._nominal_v.copy()
        if environment.supply_v is not None:
            self.supply_v[:] = environment.supply_v
        self.sign = np.ones(n)
        self.zero = np.zeros(n)
        self.position = np.full(n, float(CENTER_PULSE))
        self.velocity = np.zeros(n)
        self.trajectory = self.position.copy()
        self.trajectory_velocity = np.zeros(n)
        self.goal = self.position.copy()
        self.top_speed = np.full(n, UNBOUNDED)
        self.acceleration = np.full(n, UNBOUNDED)
        self.shape = np.zeros(n, dtype=np.int64)  # of the profile, as in moving_status
        self.moving_speed = np.zeros(n)  # moving_threshold
        self.torque_on = np.zeros(n, dtype=np.bool_)
        self.strength = np.ones(n)  # what goal current and goal PWM allow, share of stall torque
        self.free_speed = self.no_load.copy()  # no-load speed at what goal PWM allows
        self.load = np.zeros(n)  # external, share of the stall torque
        self.jammed = np.zeros(n, dtype=np.bool_)
        self.temperature = np.full(n, environment.ambient_degc)
        self.voltage_v = self.supply_v.copy()
        self.overload_s = np.zeros(n)
        self.now_s = 0.0
        #: Called at every step of the integration with its time and the positions, (n,), which
        #: are the motors' own array: copy what is kept. None costs nothing.
        self.motion: Callable[[float, Array], None] | None = None
        self._effort = np.zeros(n)  # share of the stall torque, without its direction
        self._wanted = np.zeros(n)  # speed that the position loop asks for; its sign: of the push
        self._grid_s = 0.0  # until when the motion is computed, a multiple of the step
        self._heat_kept = float(np.exp(-_STEP_S / environment.cooling_s))
        units = [(m.current_unit_ma, m.stall_a * 1e3) for m in models]
        # Models without a current sensor count load in 0.1 %.
        self._effort_scale = np.array([stall / unit if unit else 1e3 for unit, stall in units])
        self._values = np.zeros((10, n))
        self._shown: list[list[int]] = []
        #: The time of the stored `register_values`; -1: they must be computed again.
        self.shown_at_s = -1.0

    def register_values(self) -> list[list[int]]:
        """Return each servo's registers from `moving` to present_temperature, in register units.

        Ten whole numbers a servo, for the time of the last `advance`: moving, moving_status, PWM,
        current or load, velocity, position, trajectory's velocity and position, voltage (0.1 V),
        temperature (degC). Computed once for each time.
        """
        if self.shown_at_s != self.now_s:
            self.shown_at_s = self.now_s
            values, sign = self._values, self.sign
            ongoing = self.torque_on & (self.goal != self.trajectory)
            speed = np.abs(self.velocity)
            values[0] = ongoing | (speed > self.moving_speed)
            values[1] = self._moving_status(ongoing)
            duty = (speed / self.no_load + self._effort) * (self._nominal_v / self.voltage_v)
            duty = np.minimum(duty, self.free_speed / self.no_load) * self.torque_on
            push = np.copysign(sign, self._wanted * sign)
            values[2] = FULL_PWM * duty * push
            values[3] = self._effort * self._effort_scale * push
            values[4] = self.velocity * sign / VELOCITY_UNIT
            position = self.position + self.velocity * (self.now_s - self._grid_s)
            values[5] = position * sign + self.zero
            values[6] = self.trajectory_velocity * sign / VELOCITY_UNIT
            values[7] = self.trajectory * sign + self.zero
            values[8] = self.voltage_v * 10.0
            values[9] = self.temperature
            self._shown = np.rint(values).astype(np.int64).T.tolist()
        return self._shown

    def _moving_status(self, ongoing: NDArray[np.bool_]) -> NDArray[np.int64]:
        status = self.shape + _ONGOING * ongoing
        status += _IN_POSITION * (np.abs(self.goal - self.position) <= _IN_POSITION_PULSES)
        late = np.abs(self.trajectory - self.position) > _FOLLOWING_PULSES
        return np.asarray(status + _NOT_FOLLOWING * late)

    def set_course(self, index: int, course: Course) -> None:
        """Set top speed, acceleration and shape of one servo's motion to its next goal."""
        self.top_speed[index] = course.top_speed
        self.acceleration[index] = course.acceleration
        self.shape[index] = course.shape

    def stop(self, index: int) -> None:
        """Make the present position of one servo its goal, so that it holds there."""
        self.goal[index] = self.trajectory[index] = self.position[index]
        self.trajectory_velocity[index] = 0.0

    def advance(self, now_s: float) -> None:
        """Simulate all motors until `now_s`, in steps of 5 ms; an earlier time does nothing."""
        if now_s <= self.now_s:
            return
        self.now_s = now_s
        n_steps = int((now_s - self._grid_s) / _STEP_S)
        if not n_steps:
            return
        end_s = self._grid_s + n_steps * _STEP_S
        if self._at_rest():  # only temperatures change: one long step
            self.velocity[:] = 0.0
            span_s = n_steps * _STEP_S
            keep = float(np.exp(-span_s / self._environment.cooling_s))
            self._supply_and_heat(span_s, np.zeros_like(self.load), keep)
            if self.motion is not None:
                self.motion(end_s, self.position)
        else:
            for n in range(1, n_steps + 1):
                self._step()
                if self.motion is not None:
                    self.motion(self._grid_s + n * _STEP_S, self.position)
        self._grid_s = end_s

    def _at_rest(self) -> bool:
        strained = (np.abs(self.trajectory - self.position) >= _AT_REST_PULSES) | self.jammed
        moves = strained | (self.load != 0.0) | (self.goal != self.trajectory)
        return not (self.torque_on & moves).any()

    def _step(self) -> None:
        """Advance all motors by 5 ms: trajectory, speed, position, effort, voltage and heat.

        A proportional position loop, with a speed limited by load and voltage. The constants of the
        effort are our assumptions.
        """
        on = self.torque_on
        self._follow_profile()
        # room: share of the strength that the load leaves; top: highest speed that is possible
        room = np.maximum(0.0, 1.0 - self.load / np.maximum(self.strength, 1e-6))
        top = self.free_speed * room * self.voltage_v / self._nominal_v
        top = np.where(on & ~self.jammed, top, 0.0)
        error = self.trajectory - self.position
        wanted = POSITION_LOOP_PER_S * error
        velocity = np.minimum(np.maximum(wanted, -top), top)
        pace = np.abs(velocity) / self.no_load
        # Effort (share of the stall torque): load, friction of the motion, acceleration.
        effort = self.load + 0.05 * pace
        effort += 0.001 / _STEP_S * np.abs(velocity - self.velocity) / self.no_load
        # A motor held back pushes harder with distance; at top speed it has no torque to spare.
        spare = np.minimum(0.004 * np.abs(error), np.maximum(0.0, room - pace))
        effort += spare * (np.abs(wanted) > top)
        self.velocity = velocity
        self.position = self.position + velocity * _STEP_S
        self._wanted = wanted
        effort = np.where(on, np.maximum(0.0, np.minimum(effort, self.strength)), 0.0)
        self._supply_and_heat(_STEP_S, effort, self._heat_kept)

    def _follow_profile(self) -> None:
        """Move every trajectory by a step: full acceleration, top speed, braking in time.

        Trajectories of motors without torque are at the shaft's position. Profiles:
        https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#profile-velocity112
        """
        on, v = self.torque_on, self.trajectory_velocity
        change = self.acceleration * _STEP_S
        left = self.goal - self.trajectory
        distance = np.abs(left)
        # brake: highest speed from which whole steps of braking still stop at the goal
        brake = change * (np.sqrt(0.25 + (2.0 / _STEP_S) * distance / change) - 0.5)
        speed = np.minimum(np.minimum(self.top_speed, brake), distance / _STEP_S)
        v = np.minimum(np.maximum(np.copysign(speed, left), v - change), v + change)
        reach = np.abs(v)
        # there: reaches the goal within this step, slowly enough to stop there
        there = (distance <= reach * (_STEP_S * (1 + 1e-9))) & (reach <= 2 * change)
        there |= distance < 1e-6
        moved = np.where(there, self.goal, self.trajectory + v * _STEP_S)
        self.trajectory = np.where(on, moved, self.position)
        self.trajectory_velocity = np.where(on & ~there, v, 0.0)

    def _supply_and_heat(self, dt_s: float, effort: Array, keep: float) -> None:
        """Compute voltage, temperature and overload after `dt_s` of `effort`, (n,) shares of stall.

        keep: the share of a difference in temperature that is left after `dt_s`. The supply's
        voltage falls with the sum of all currents.
        """
        around = self._environment
        self._effort = effort
        current_a = self._stall_a * effort + around.standby_a
        self.voltage_v = self.supply_v - around.supply_ohm * current_a.sum()
        # The temperature to which this effort would lead in the long run.
        settles = around.ambient_degc + effort * effort * (around.heat_deg_s * around.cooling_s)
        self.temperature = settles + (self.temperature - settles) * keep
        over = effort >= around.overload_share
        self.overload_s = np.where(over, self.overload_s + dt_s, 0.0)

    def hardware_errors(
        self, low_v: Array, high_v: Array, hottest_degc: Array
    ) -> NDArray[np.int64]:
        """Return the hardware error bits that each servo sets now, by load, voltage and heat.

        Parameters
        ----------
        low_v,high_v : Array
            (n_servos,) V.
        hottest_degc : Array
            (n_servos,) degC.

        Returns
        -------
        NDArray[np.int64]
            (n_servos,).
        """
        bits = VOLTAGE_ERROR * ((self.voltage_v < low_v) | (self.voltage_v > high_v))
        bits = bits + HEAT_ERROR * (self.temperature > hottest_degc)
        late = self.overload_s >= self._environment.overload_after_s
        return np.asarray(bits + OVERLOAD_ERROR * late, dtype=np.int64)
