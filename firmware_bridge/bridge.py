"""One tick of the bridge: targets in, one safe goal a servo out. The caller owns loop and clock."""

from collections.abc import Sequence
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.arming import check_held, named
from firmware_bridge.bus import BusError, PortGone, ServoBus, ServoError
from firmware_bridge.care import ServoCare, ServoState
from firmware_bridge.channel import TargetTrack
from firmware_bridge.clock import Clock, ticks
from firmware_bridge.coupling import PreventRule
from firmware_bridge.joints import Joint
from firmware_bridge.report import BridgeStatus, TickReport
from firmware_bridge.safety import (
    EASE_PEAK_SLOPE,
    Limited,
    Limiter,
    StaleLevel,
    StaleRule,
    ease,
)
from firmware_bridge.targets import TargetChannel
from firmware_bridge.tracking import TrackingRule

#: Time to neutral when the joints can make it: quick for a person waiting, calm for a face.
_EASE_S = 0.5
#: The joints go limp after this long wherever they are: whoever pressed Ctrl-C is waiting.
_EASE_LIMIT_S = 2.0


#: First wait before a lost port is tried again, and the longest; it doubles in between.
_RETRY_S, _LONGEST_RETRY_S = 0.1, 0.5


class _State(Enum):
    STOPPED = auto()  # limp until armed
    RUNNING = auto()  # torque on, goals sent
    LIMP = auto()  # speech fell silent; arms itself again at the next fresh target
    UNPLUGGED = auto()  # the port is gone; opened and armed again as soon as it is back


class Bridge:
    """Turns targets into goals on a bus that its caller has opened.

    Limp until `arm()`. A servo in trouble is left out and looked after while the others go on; a
    port that goes is waited for. Raises ServoError when a critical servo has failed for good. The
    bus goes limp on leaving its `with` block, whatever happened.
    """

    def __init__(
        self,
        bus: ServoBus,
        joints: Sequence[Joint],
        channel: TargetChannel,
        *,
        rate_hz: float,
        stale: StaleRule | None = None,
        tracking: TrackingRule | None = None,
        prevent: Sequence[PreventRule] = (),
        tolerant: bool = False,
        dry_run: bool = False,
    ) -> None:
        """`rate_hz` is the nominal rate of `tick`; joints and targets share their order.

        tolerant: `arm` wakes the servos that are willing, not all or none.
        dry_run: servos are read and looked after, but never get torque or goals.
        """
        self._bus = bus
        self._joints = tuple(joints)
        self._channel = channel
        self._rate_hz = rate_hz
        self._stale = StaleRule() if stale is None else stale
        self._track = TargetTrack(len(self._joints))
        self._limiter = Limiter(self._joints, period_s=1.0 / rate_hz, prevent=prevent)
        self._care = ServoCare(self._joints, tracking)
        self._tolerant = tolerant
        self._dry_run = dry_run
        self._scale = np.ones(len(self._joints))
        self._retry_at_s = self._retry_wait_s = 0.0
        self._n_unplugged = 0
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
            n_unplugged=self._n_unplugged,
            servo_states=tuple(ServoState(state) for state in self._care.states.tolist()),
        )

    @property
    def troubles(self) -> tuple[str, ...]:
        """A line for each servo that is not driven, with the reason; for a log, not for a tick."""
        reasons = zip(self._joints, self._care.reasons, strict=True)
        return tuple(f"{named(joint)}: {why}" for joint, why in reasons if why)

    def arm(self) -> None:
        """Switch torque on without a jump: every servo is first told to stay where it is.

        Raises ServoError, all limp, when a servo did not answer or refuses to hold its place;
        tolerant, only when none is willing or a critical one is not.
        """
        self.stop()
        if self._dry_run:
            return
        if self._tolerant:
            self._arm_the_willing()
            return
        present_deg = self._bus.read().positions_deg
        self._bus.write_positions(present_deg)
        readings = self._bus.read()
        check_held(self._joints, present_deg, readings.goals_deg)
        self._bus.set_torque(True)
        for index in range(len(self._joints)):
            self._care.woke(index, willing=True, time_s=readings.time_s)
        self._start_from(present_deg, readings.time_s)

    def _arm_the_willing(self) -> None:
        """Wake one servo after another; those that will not are looked after later."""
        present_deg = np.nan_to_num(self._bus.read().positions_deg)
        time_s = 0.0
        for index, joint in enumerate(self._joints):
            willing = self._bus.wake(index)
            time_s = self._bus.feedback().time_s
            self._care.woke(index, willing=willing, time_s=time_s)
            if joint.critical and not willing:
                self._bus.set_torque(False)
                raise ServoError(f"critical {named(joint)} is not willing; run `lipservo doctor`")
        if not self._care.driven.any():
            raise ServoError("no servo is willing to hold its place; run `lipservo doctor`")
        present_deg = np.nan_to_num(self._bus.feedback().positions_deg)
        self._start_from(present_deg, time_s)

    def _start_from(self, present_deg: NDArray[np.float64], time_s: float) -> None:
        self._limiter.start_from(present_deg, time_s)
        self._held_deg = present_deg
        self._heard_s = time_s
        self._was_spoken_to = False
        self._state = _State.RUNNING
        self._n_armed += 1

    def tick(self, time_s: float, late: int = 0) -> TickReport:
        """Send the goals for grid time `time_s`; `late` ticks were missed before it.

        A face that went limp in a silence arms itself again at the next fresh target; while one of
        its servos is unwilling it stays limp and tries again.
        """
        self._n_ticks += 1
        self._n_late += late
        if self._state is _State.UNPLUGGED:
            self._plug_in(time_s)
        try:
            self._listen(time_s)
            return self._drive(time_s, late)
        except PortGone:
            self._unplug(time_s)
            return self._report(time_s, late, self._held_deg, self._nothing_sent())

    def _drive(self, time_s: float, late: int) -> TickReport:
        """Choose and send the goals, then hear how the servos are."""
        silence_s = max(0.0, time_s - self._heard_s)
        level = self._stale.level(silence_s)
        if level is StaleLevel.LIMP and self._state is _State.RUNNING:
            self._bus.set_torque(False)
            self._state = _State.LIMP
        wanted_deg = self._held_deg * self._stale.weight(silence_s)
        limited = self._nothing_sent()
        if self._state is _State.RUNNING:
            self._n_stale += self._was_spoken_to and level is not StaleLevel.FRESH
            limited = self._limiter.apply(wanted_deg * self._scale, time_s)
            self._bus.write_positions(self._driven_only(limited.positions_deg))
            self._look_after(time_s)
        elif self._dry_run:
            self._limiter.start_from(np.nan_to_num(self._bus.feedback().positions_deg), time_s)
            self._bus.look_after()
            limited = self._nothing_sent()
        return self._report(time_s, late, wanted_deg, limited)

    def _driven_only(self, goals_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """NaN, which no bus sends, for servos that are being looked after."""
        driven = self._care.driven
        return goals_deg if driven.all() else np.where(driven, goals_deg, np.nan)

    def _look_after(self, time_s: float) -> None:
        """Hear everybody, treat one at most; an awakened one starts from where it stands."""
        feedback = self._bus.feedback()
        health = self._bus.look_after()
        self._scale = self._care.scale(feedback, health)
        self._care.follow(self._limiter.sent_deg, feedback)
        woken = self._care.look(health, time_s, self._bus)
        if woken is not None:
            self._limiter.start_one(woken, float(self._bus.read().positions_deg[woken]))
        lost = self._care.lost_critical
        if lost is not None:
            self.stop()
            raise ServoError(f"critical {named(self._joints[lost])} has failed; all is limp")

    def _unplug(self, time_s: float) -> None:
        self._state = _State.UNPLUGGED
        self._care.lose_all(time_s)
        self._n_unplugged += 1
        self._retry_wait_s = _RETRY_S
        self._retry_at_s = time_s + _RETRY_S

    def _plug_in(self, time_s: float) -> None:
        """Try the port again, ever more patiently; arm whoever is willing once it is back."""
        if time_s < self._retry_at_s:
            return
        try:
            self._bus.reopen()
            self._bus.set_torque(False)
            self._arm_the_willing()
        except BusError:
            self._retry_wait_s = min(2.0 * self._retry_wait_s, _LONGEST_RETRY_S)
            self._retry_at_s = time_s + self._retry_wait_s

    def _report(
        self, time_s: float, late: int, wanted_deg: NDArray[np.float64], limited: Limited
    ) -> TickReport:
        silence_s = max(0.0, time_s - self._heard_s)
        return TickReport(
            time_s=time_s,
            late=late,
            wanted_deg=wanted_deg,
            sent_deg=limited.positions_deg,
            target_age_s=silence_s,
            stale=self._stale.level(silence_s),
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
        except PortGone:
            self._state = _State.UNPLUGGED
        finally:
            if self._state is not _State.UNPLUGGED:
                self.stop()

    def stop(self) -> None:
        """Let every joint go limp now, and until `arm()`."""
        self._state = _State.STOPPED
        self._bus.set_torque(False)

    def freeze(self) -> None:
        """Let every joint stay where it is, held, and until `arm()`."""
        self._state = _State.STOPPED
        self._bus.write_positions(self._driven_only(self._bus.feedback().positions_deg))

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
            self._bus.write_positions(self._driven_only(sent_deg))
            at_rest = elapsed_s >= duration_s and not sent_deg.any()
            if at_rest or elapsed_s >= _EASE_LIMIT_S:
                return

    def _nothing_sent(self) -> Limited:
        none = self._no_hits
        return Limited(self._limiter.sent_deg, none, none, none, none)
