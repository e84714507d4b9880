"""A bus of servos simulated in memory, which a clock moves."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import GOAL_OUT_OF_RANGE, Array, Feedback, Health, Readings, check_shape
from firmware_bridge.capabilities import IN_MEMORY, BusCapabilities
from firmware_bridge.clock import Clock
from firmware_bridge.errors import PortError
from firmware_bridge.joints import SERVO_LIMIT_MARGIN_DEG, Joint
from firmware_bridge.known_torque import KnownTorque

#: XL330-M288-T without load at 5 V: 103 rev/min;
#: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#specifications
XL330_TOP_SPEED_DEG_S = 618.0


@dataclass(frozen=True, slots=True)
class Motion:
    """The goals and positions of all servos just after one write, (n_servos,) degrees."""

    time_s: float
    goals_deg: Array
    positions_deg: Array


class SimulatedBus:
    """A `ServoBus` in memory, whose servos run to their goals at constant top speed.

    As real servos do, they keep their old goal when a new one is outside their range (and show
    the error until the next goal they take), take goals while limp, stay where they are when torque
    goes off, and run to the last goal they were given when it comes on.

    With fewer capabilities they move likewise, and report less, as hobby servos do.

    Not simulated: acceleration, load, gravity, backlash, encoder steps, current, temperature,
    supply voltage, time on the wire, lost or damaged packets, a servo falling out.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        clock: Clock,
        *,
        start_deg: Array | None = None,
        top_speed_deg_s: float = XL330_TOP_SPEED_DEG_S,
        n_remembered: int = 20_000,
        capabilities: BusCapabilities = IN_MEMORY,
    ) -> None:
        """Start with limp servos at `start_deg`, (n_servos,) degrees; None: in neutral.

        clock: the servos move as its time passes. capabilities: of the servos; values that they
        cannot measure are reported as NaN. n_remembered: how many of the newest writes stay in
        `history`; by default more than ten minutes at 30 Hz, and 7 MB with ten servos.
        """
        n_servos = len(joints)
        self.capabilities = capabilities
        self._nothing = np.zeros(n_servos)
        can = [capabilities.of(index) for index in range(n_servos)]
        self._has_place = np.array([each.place for each in can], dtype=np.bool_)
        self._has_heat = np.array([each.heat for each in can], dtype=np.bool_)
        self._effort = np.where([each.load for each in can], 0.0, np.nan)
        self._voltage_v = np.where([each.voltage for each in can], 5.0, np.nan)
        self._clock = clock
        self._min_deg = np.array([joint.min_deg for joint in joints]) - SERVO_LIMIT_MARGIN_DEG
        self._max_deg = np.array([joint.max_deg for joint in joints]) + SERVO_LIMIT_MARGIN_DEG
        self._narrow_deg = self._min_deg, self._max_deg
        self._reach_deg = np.array([_reach_deg(joint) for joint in joints]).T
        self._top_speed_deg_s = top_speed_deg_s
        self._positions_deg = np.zeros(n_servos) if start_deg is None else start_deg.copy()
        self._goals_deg = np.zeros(n_servos)
        self._errors = np.zeros(n_servos, dtype=np.uint8)
        self._torque_on = np.zeros(n_servos, dtype=np.bool_)
        self.torque = KnownTorque(n_servos)
        pulses = [(p.neutral_us, p.us_per_deg) if (p := j.pulse) else (np.nan,) * 2 for j in joints]
        self._neutral_us, self._us_per_deg = np.array(pulses).reshape(-1, 2).T
        self._is_open = False
        self._moved_until_s = clock.now()
        self._history: deque[Motion] = deque(maxlen=n_remembered)

    @property
    def history(self) -> tuple[Motion, ...]:
        """The goals and positions at each write, oldest first, the newest `n_remembered`."""
        return tuple(self._history)

    def write_positions(self, positions_deg: Array) -> None:
        """Set every goal that is inside its servo's range; other servos keep theirs, also for NaN.

        Parameters
        ----------
        positions_deg : Array
            (n_servos,) joint degrees.

        Raises
        ------
        ValueError
            positions_deg has another shape.
        """
        check_shape(positions_deg, self._goals_deg.shape)
        self._move()
        taken = (self._min_deg <= positions_deg) & (positions_deg <= self._max_deg)
        self._set_goals(np.where(taken, positions_deg, self._goals_deg))
        self._errors = np.where(taken, 0, GOAL_OUT_OF_RANGE).astype(np.uint8)
        self._history.append(Motion(self._moved_until_s, self._goals_deg, self._positions_deg))

    def widen(self, joints: NDArray[np.bool_]) -> None:
        """Let goals of the given hobby servos go as far as their pulses reach; reset all others.

        Parameters
        ----------
        joints : NDArray[np.bool_]
            (n_servos,): True for servos that may go beyond.
        """
        self._min_deg, self._max_deg = np.where(joints, self._reach_deg, self._narrow_deg)

    def read(self) -> Readings:
        """Return the readings of all servos at the clock's present time."""
        self._move()
        return Readings(
            time_s=self._moved_until_s,
            positions_deg=self._places_deg,
            goals_deg=self._goals_deg,
            torque=self._tell_torque(),
            errors=self._errors,
            age_s=np.zeros(self._goals_deg.shape),
        )

    def feedback(self) -> Feedback:
        """Return the positions of all servos at the clock's present time; effort is 0 or NaN."""
        self._move()
        now_s, places_deg, errors = self._moved_until_s, self._places_deg, self._errors
        return Feedback(now_s, places_deg, self._effort, errors, self._nothing)

    def remarks(self) -> Sequence[str]:
        """Return no remarks: simulated servos have nothing unusual."""
        return ()

    def look_after(self) -> Health:
        """Return the health of all servos, which are always well."""
        n_servos = len(self._goals_deg)
        return Health(
            silent_s=self._nothing,
            torque=self._tell_torque(),
            watchdog_tripped=np.zeros(n_servos, dtype=np.bool_),
            hardware_errors=np.zeros(n_servos, dtype=np.uint8),
            temperature_degc=np.where(self._has_heat, 25.0, np.nan),
            room_degc=np.where(self._has_heat, 45.0, np.inf),
            voltage_v=self._voltage_v,
            effort=self._effort,
            current_ma=self._effort,
            n_unanswered=np.zeros(n_servos, dtype=np.int64),
        )

    def obstacle(self, index: int) -> str:
        """Return why a servo may not get torque (position unknown, out of range); empty: it may."""
        self._move()
        place_deg = self._positions_deg[index]
        if np.isnan(place_deg):
            return "does not answer"
        if self._min_deg[index] <= place_deg <= self._max_deg[index]:
            return ""
        return (
            f"stands at {place_deg:.1f} deg, outside its own range; move it into "
            f"{self._min_deg[index]:g}..{self._max_deg[index]:g} deg by hand"
        )

    def forgive(self, _index: int) -> None:
        """Do nothing: what is wrong with such a servo is read from it each time."""

    def enable_torque(self, index: int) -> str:
        """Switch a servo's torque on, to hold its position; return "", or why it stays off.

        The goal becomes the present position first, so that nothing moves.
        """
        obstacle = self.obstacle(index)
        if not obstacle:
            here = np.arange(len(self._goals_deg)) == index
            self._set_goals(np.where(here, self._positions_deg, self._goals_deg))
            self._set_torque_of(index, on=True)
        return obstacle

    def keep_torque(self, index: int) -> bool:
        """Keep a servo's torque on at its present position; return whether it was and stays on."""
        self._move()
        return bool(self._torque_on[index]) and not self.enable_torque(index)

    def disable_torque(self, index: int) -> bool:
        """Switch one servo's torque off; return True."""
        self._move()
        self._set_torque_of(index, on=False)
        return True

    def disable_all(self) -> NDArray[np.bool_]:
        """Switch the torque of every servo off.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,), all True.
        """
        self._move()
        self._torque_on = np.zeros(self._goals_deg.shape, dtype=np.bool_)
        self._tell_torque()
        return np.ones(self._goals_deg.shape, dtype=np.bool_)

    def reboot(self, index: int) -> None:
        """Restart a servo, which comes back limp."""
        self.disable_torque(index)

    def reopen(self) -> None:
        """Forget what is known of torque, as every bus does; memory is never unplugged."""
        self.torque.forget()

    @property
    def _places_deg(self) -> Array:
        """The positions as reported, in degrees: NaN for servos that report none."""
        return np.where(self._has_place, self._positions_deg, np.nan)

    def _set_goals(self, goals_deg: Array) -> None:
        self._goals_deg = goals_deg
        self.torque.sent_us[:] = self._neutral_us + self._us_per_deg * goals_deg

    def _set_torque_of(self, index: int, *, on: bool) -> None:
        self._torque_on = self._torque_on.copy()
        self._torque_on[index] = on
        self.torque.note(index, self._clock.now(), on=on)

    def _tell_torque(self) -> NDArray[np.int8]:
        """Store in `torque` that every servo's torque was read now; return its states.

        (n_servos,) numbers of `Torque`.
        """
        now_s = self._clock.now()
        for index, on in enumerate(self._torque_on.tolist()):
            self.torque.note(index, now_s, on=on)
        return self.torque.states

    def push_by_hand(self, positions_deg: Array) -> None:
        """Move limp joints to these positions, as by hand; joints with torque on stay.

        Parameters
        ----------
        positions_deg : Array
            (n_joints,) degrees.
        """
        self._move()
        self._positions_deg = np.where(self._torque_on, self._positions_deg, positions_deg)

    def __enter__(self) -> Self:
        self._is_open = True
        return self

    def __exit__(self, *exc: object) -> None:
        self.disable_all()
        self._is_open = False

    def _move(self) -> None:
        """Compute the positions at the clock's present time from the goals set before it.

        Arrays are replaced, never written, since readings and history share them. Raises PortError
        outside the `with` block.
        """
        if not self._is_open:
            raise PortError("the bus is used outside its `with` block")
        now_s = self._clock.now()
        if self._torque_on.any():
            reach_deg = self._top_speed_deg_s * (now_s - self._moved_until_s)
            moved_deg = np.clip(
                self._goals_deg, self._positions_deg - reach_deg, self._positions_deg + reach_deg
            )
            self._positions_deg = np.where(self._torque_on, moved_deg, self._positions_deg)
        self._moved_until_s = now_s


def _reach_deg(joint: Joint) -> tuple[float, float]:
    low, high = (joint.min_deg, joint.max_deg) if joint.pulse is None else joint.pulse.reach_deg
    return low - SERVO_LIMIT_MARGIN_DEG, high + SERVO_LIMIT_MARGIN_DEG
