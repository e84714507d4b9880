"""One tick of the bridge: targets in, one safe goal a servo out. The caller owns loop and clock."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import ServoBus, ServoError
from firmware_bridge.channel import TargetTrack
from firmware_bridge.clock import Clock, ticks
from firmware_bridge.joints import Joint
from firmware_bridge.safety import (
    EASE_PEAK_SLOPE,
    GateCounts,
    Limited,
    Limiter,
    StaleLevel,
    StaleRule,
    ease,
)
from firmware_bridge.targets import TargetChannel

#: A goal read back may differ from the one written by one encoder step, 360 / 4096 deg.
_ENCODER_STEP_DEG = 360.0 / 4096.0
#: Time to neutral when the joints can make it: quick for a person waiting, calm for a face.
_EASE_S = 0.5
#: The joints go limp after this long wherever they are: whoever pressed Ctrl-C is waiting.
_EASE_LIMIT_S = 2.0


class _State(Enum):
    STOPPED = auto()  # limp until armed
    RUNNING = auto()  # torque on, goals sent
    LIMP = auto()  # speech fell silent; arms itself again at the next fresh target


@dataclass(frozen=True, slots=True)
class TickReport:
    """What one tick wanted, sent and noticed. Every array is (n_servos,).

    wanted_deg is what reached the last gate; sent_deg what the bus got. While `torque_on` is False
    nothing is sent, sent_deg repeats the last goals, and no limit counts as hit.
    target_age_s counts from the newest target due, or from arming when that is later.
    late is how many ticks were missed before this one.
    """

    time_s: float
    late: int
    wanted_deg: NDArray[np.float64]
    sent_deg: NDArray[np.float64]
    target_age_s: float
    stale: StaleLevel
    torque_on: bool
    range_hits: NDArray[np.bool_]
    rate_hits: NDArray[np.bool_]
    rejected: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class BridgeStatus:
    """Counts since the bridge was made, for a status line or a dashboard.

    n_stale: ticks with torque on whose target was no longer fresh; waiting for the first one after
    arming does not count. n_not_armed: ticks that tried to wake a limp face and found a servo
    unwilling.
    """

    n_ticks: int
    n_late: int
    n_stale: int
    n_armed: int
    n_not_armed: int
    n_rejected_targets: int
    gate: GateCounts


class Bridge:
    """Turns targets into goals on a bus that its caller has opened.

    Limp until `arm()`. Every method raises BusError when the bus fails; the bus goes limp on
    leaving its `with` block, whatever happened.
    """

    def __init__(
        self,
        bus: ServoBus,
        joints: Sequence[Joint],
        channel: TargetChannel,
        *,
        rate_hz: float,
        stale: StaleRule | None = None,
    ) -> None:
        """`rate_hz` is the nominal rate of `tick`; joints and targets share their order."""
        self._bus = bus
        self._joints = tuple(joints)
        self._channel = channel
        self._rate_hz = rate_hz
        self._stale = StaleRule() if stale is None else stale
        self._track = TargetTrack(len(self._joints))
        self._limiter = Limiter(self._joints, period_s=1.0 / rate_hz)
        self._state = _State.STOPPED
        self._held_deg = np.zeros(len(self._joints))
        self._no_hits = np.zeros(len(self._joints), dtype=np.bool_)
        self._heard_s = 0.0  # display time of the newest target due, or when armed if later
        self._was_spoken_to = False  # since arming
        self._n_ticks = self._n_late = self._n_stale = self._n_armed = self._n_not_armed = 0

    @property
    def status(self) -> BridgeStatus:
        """The counts so far."""
        return BridgeStatus(
            n_ticks=self._n_ticks,
            n_late=self._n_late,
            n_stale=self._n_stale,
            n_armed=self._n_armed,
            n_not_armed=self._n_not_armed,
            n_rejected_targets=self._track.n_rejected,
            gate=self._limiter.counts,
        )

    def arm(self) -> None:
        """Switch torque on without a jump: every servo is first told to stay where it is.

        Raises ServoError, all limp, when a servo did not answer or refuses to hold its place.
        """
        self.stop()
        present_deg = self._bus.read().positions_deg
        self._bus.write_positions(present_deg)
        readings = self._bus.read()
        _check_held(self._joints, present_deg, readings.goals_deg)
        self._limiter.start_from(present_deg, readings.time_s)
        self._held_deg = present_deg
        self._heard_s = readings.time_s
        self._was_spoken_to = False
        self._bus.set_torque(True)
        self._state = _State.RUNNING
        self._n_armed += 1

    def tick(self, time_s: float, late: int = 0) -> TickReport:
        """Send the goals for grid time `time_s`; `late` ticks were missed before it.

        A face that went limp in a silence arms itself again at the next fresh target; while one of
        its servos is unwilling it stays limp and tries again.
        """
        self._n_ticks += 1
        self._n_late += late
        self._listen(time_s)
        silence_s = max(0.0, time_s - self._heard_s)
        level = self._stale.level(silence_s)
        if level is StaleLevel.LIMP and self._state is _State.RUNNING:
            self._bus.set_torque(False)
            self._state = _State.LIMP
        wanted_deg = self._held_deg * self._stale.weight(silence_s)
        limited = self._nothing_sent()
        if self._state is _State.RUNNING:
            self._n_stale += self._was_spoken_to and level is not StaleLevel.FRESH
            limited = self._limiter.apply(wanted_deg, time_s)
            self._bus.write_positions(limited.positions_deg)
        return TickReport(
            time_s=time_s,
            late=late,
            wanted_deg=wanted_deg,
            sent_deg=limited.positions_deg,
            target_age_s=silence_s,
            stale=level,
            torque_on=self._state is _State.RUNNING,
            range_hits=limited.range_hits,
            rate_hits=limited.rate_hits,
            rejected=limited.rejected,
        )

    def ease_to_neutral(self, clock: Clock) -> None:
        """Bring the face to rest and let go: in half a second, or as long as its speeds need.

        Blocks. Targets are no longer looked at. Torque goes off at neutral, after two seconds at
        the latest, and at once when interrupted.
        """
        try:
            if self._state is _State.RUNNING:
                self._ease(clock)
        finally:
            self.stop()

    def stop(self) -> None:
        """Let every joint go limp now, and until `arm()`."""
        self._state = _State.STOPPED
        self._bus.set_torque(False)

    def _listen(self, time_s: float) -> None:
        """Take what the speech side sent; wake a limp face when some of it is fresh."""
        self._track.push(self._channel.drain())
        target_deg, age_s = self._track.at(time_s)
        if target_deg is None or self._stale.level(age_s) is not StaleLevel.FRESH:
            return
        if self._state is _State.LIMP:
            try:
                self.arm()
            except ServoError:
                self._state = _State.LIMP
                self._n_not_armed += 1
        self._heard_s = max(self._heard_s, time_s - age_s)
        self._held_deg = target_deg
        self._was_spoken_to = True

    def _ease(self, clock: Clock) -> None:
        start_s, start_deg = clock.now(), self._limiter.sent_deg
        needed_s = max(
            EASE_PEAK_SLOPE * abs(start) / joint.max_speed_deg_s
            for joint, start in zip(self._joints, start_deg, strict=True)
        )
        duration_s = max(_EASE_S, needed_s)
        for time_s, _ in ticks(clock, self._rate_hz):
            elapsed_s = time_s - start_s
            wanted_deg = start_deg * (1.0 - ease(elapsed_s / duration_s))
            sent_deg = self._limiter.apply(wanted_deg, time_s).positions_deg
            self._bus.write_positions(sent_deg)
            at_rest = elapsed_s >= duration_s and not sent_deg.any()
            if at_rest or elapsed_s >= _EASE_LIMIT_S:
                return

    def _nothing_sent(self) -> Limited:
        return Limited(self._limiter.sent_deg, self._no_hits, self._no_hits, self._no_hits)


def _check_held(
    joints: Sequence[Joint], present_deg: NDArray[np.float64], goals_deg: NDArray[np.float64]
) -> None:
    """Raise ServoError for the first servo whose goal is not where it stands."""
    for joint, stands_deg, goal_deg in zip(joints, present_deg, goals_deg, strict=True):
        servo = f"servo {joint.name!r} (id {joint.servo_id})"
        if np.isnan(stands_deg):
            raise ServoError(f"{servo} does not answer; check its power and cable")
        if not abs(goal_deg - stands_deg) <= _ENCODER_STEP_DEG:
            raise ServoError(
                f"{servo} stands at {stands_deg:.1f} deg and will not hold there; move it into "
                f"{joint.min_deg:g}..{joint.max_deg:g} deg by hand"
            )
