"""One tick of the bridge: targets in, one safe goal a servo out. The caller owns loop and clock."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import BusError, PortError, ServoBus
from firmware_bridge.gate.coupling import PreventRule
from firmware_bridge.gate.limits import Limited, StaleLevel, StaleRule
from firmware_bridge.gate.tracking import TrackingRule
from firmware_bridge.health import ServoHealth
from firmware_bridge.joints import Joint, named
from firmware_bridge.loop.channel import TargetTrack
from firmware_bridge.loop.report import BridgeStatus, FaceState, TickReport
from firmware_bridge.loop.servo_group import ServoGroup
from firmware_bridge.loop.servo_supervision import ServoState
from firmware_bridge.loop.way_to_rest import WayToRest
from firmware_bridge.stopping import StopLevel, StopReport
from firmware_bridge.targets import TargetChannel

Array = NDArray[np.float64]

#: Looking a member up in its enumeration costs as much as comparing ten; a tick does it often.
_DRIVEN, _SILENT, _FRESH = FaceState.DRIVEN, FaceState.SILENT, StaleLevel.FRESH
#: First wait before a lost port is tried again, and the longest; it doubles in between.
_RETRY_S, _LONGEST_RETRY_S = 0.1, 0.5


class Bridge:
    """Turns targets into goals on a bus that its caller has opened.

    Limp until `start`. A servo in trouble is left out and looked after while the others go on; a
    port that goes is waited for; torque comes on through the `TorqueGate` alone. `stop` is a
    person's word: it holds whatever happens to port, servos and speech, until `start`. `tick` never
    raises for them; it goes on after a stop until the state is ENDED.
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
        given_up: Mapping[int, str] | None = None,
    ) -> None:
        """`rate_hz` is the nominal rate of `tick`; joints and targets share their order.

        tolerant: `start` leaves it to the ticks to bring up whoever can hold; not all or none.
        dry_run: servos are read and looked after, but get neither torque nor goals.
        given_up: reason by index, of servos that an earlier process of this face gave up.
        """
        self._joints = tuple(joints)
        self._channel = channel
        self._stale = StaleRule() if stale is None else stale
        self._track = TargetTrack(len(self._joints))
        self._servos = ServoGroup(
            bus,
            joints,
            period_s=1.0 / rate_hz,
            tracking=tracking,
            prevent=prevent,
            dry_run=dry_run,
            given_up=given_up,
        )
        self._tolerant = tolerant
        self._state = FaceState.STOPPED
        self._plugged = True
        self._retry_at_s = self._retry_wait_s = 0.0
        self._tick_s = 0.0
        self._held_deg = np.zeros(len(self._joints))
        self._way_to_rest: WayToRest | None = None
        self._no_hits = np.zeros(len(self._joints), dtype=np.bool_)
        self._heard_s = 0.0  # display time of the newest target due, or of the start if later
        self._was_spoken_to = False  # since the start
        self._n_ticks = self._n_late = self._n_stale = self._n_armed = self._n_unplugged = 0
        #: Why the face stopped by itself; empty: it did not.
        self.failure = ""

    @property
    def state(self) -> FaceState:
        """What the face is doing."""
        return self._state

    @property
    def names(self) -> tuple[str, ...]:
        """The joints, in the order of everything else."""
        return tuple(joint.name for joint in self._joints)

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._plugged

    @property
    def status(self) -> BridgeStatus:
        """The counts so far."""
        return BridgeStatus(
            state=self._state,
            n_ticks=self._n_ticks,
            n_late=self._n_late,
            n_stale=self._n_stale,
            n_armed=self._n_armed,
            n_rejected_targets=self._track.n_rejected,
            gate=self._servos.limiter.counts,
            n_unplugged=self._n_unplugged,
            servo_states=tuple(ServoState(state) for state in self._servos.care.states.tolist()),
        )

    @property
    def n_trouble_changes(self) -> int:
        """Grows whenever `troubles` changes, so that a loop need not look at texts."""
        return self._servos.care.n_changes

    @property
    def settled(self) -> bool:
        """Whether every servo is driven, or `troubles` says why not."""
        return self._servos.care.settled

    @property
    def given_up(self) -> Mapping[int, str]:
        """Servos that stay limp for good, by index, with the reason."""
        return self._servos.gate.given_up

    @property
    def troubles(self) -> tuple[str, ...]:
        """A line for each servo that is not driven, with the reason; for a log, not for a tick."""
        reasons = zip(self._joints, self._servos.care.reasons, strict=True)
        return tuple(f"{named(joint)} {why}" for joint, why in reasons if why)

    def remarks(self) -> Sequence[str]:
        """What is unusual about the bus, in sentences for a log; they stay and become more."""
        return self._servos.remarks()

    def servo_health(self) -> tuple[ServoHealth, ...]:
        """How every servo was when it was asked last; for a log, not for a tick."""
        return self._servos.health()

    def start(self, goes_on: Callable[[], bool] = lambda: True) -> None:
        """A person starts the face: let everybody go, then let them hold where they stand.

        Nothing moves. Tolerant, the ticks bring up one servo after another; a critical one must be
        able to hold now. Otherwise all hold when this returns, or none: raises ServoError that
        names those who cannot. goes_on: asked in between; False: all are limp, and it returns.
        Raises PortError when the port fails.
        """
        self._servos.gate.open()
        self._servos.let_go()
        readings = self._servos.read()
        if not self._servos.gate.dry_run:
            indices = range(len(self._joints))
            critical = [i for i in indices if self._joints[i].critical]
            self._servos.check(critical if self._tolerant else indices, goes_on)
            if not self._tolerant:
                self._servos.enable(indices, readings.time_s, goes_on)
                readings = self._servos.read()
        self._begin(np.nan_to_num(readings.positions_deg), readings.time_s)
        self._state = FaceState.DRIVEN
        self._n_armed += 1

    def start_frozen(self) -> None:
        """Take over a face that a person froze: what holds goes on holding, nothing else does."""
        readings = self._servos.read()
        self._begin(np.nan_to_num(readings.positions_deg), readings.time_s)
        self._servos.gate.close(_by_a_person(StopLevel.FREEZE))
        self._state = FaceState.FROZEN
        self._servos.keep_holding(readings.time_s)

    def tick(self, time_s: float, late: int = 0) -> TickReport:
        """Send the goals for grid time `time_s`; `late` ticks were missed before it."""
        self._tick_s = time_s
        self._n_ticks += 1
        self._n_late += late
        if not self._plugged:
            self._try_port(time_s)
        self._listen(time_s)
        acted = None
        if self._plugged:
            try:
                acted = self._act(time_s)
            except PortError:
                self._unplug(time_s)
        wanted_deg, limited = acted or (self._held_deg, self._nothing_sent())
        return self._report(time_s, late, wanted_deg, limited)

    def stop(self, level: StopLevel) -> None:
        """A person stops the face. LIMP and FREEZE act at once, SOFT from the next tick on.

        A stop that goes further may follow: SOFT, then LIMP; FREEZE, then either. Never raises.
        """
        if self._state in (FaceState.LETTING_GO, FaceState.ENDED):
            return
        self._servos.gate.close(_by_a_person(level))
        if level is StopLevel.FREEZE:
            self._freeze()
        elif level is StopLevel.LIMP or not self._can_ease():
            self._let_go()
        else:
            self._state = FaceState.EASING

    def stop_report(self) -> StopReport:
        """What the servos said of the end."""
        at_rest = self._way_to_rest is not None and self._way_to_rest.arrived
        return self._servos.torque_off.report(at_rest=at_rest, plugged=self._plugged)

    def _can_ease(self) -> bool:
        on_its_way = self._state in (FaceState.DRIVEN, FaceState.EASING)
        return on_its_way and self._plugged and self._servos.care.any_driven

    def _begin(self, present_deg: Array, time_s: float) -> None:
        self._servos.limiter.start_from(present_deg, time_s)
        self._held_deg = present_deg
        self._heard_s = time_s
        self._was_spoken_to = False
        self._way_to_rest = None

    def _act(self, time_s: float) -> tuple[Array, Limited]:
        """What this state sends: (wanted, sent)."""
        if self._state is _DRIVEN:
            return self._drive(time_s)
        if self._state is FaceState.EASING:
            return self._ease(time_s)
        if self._state is FaceState.FROZEN:
            self._servos.stay_on()
        limited = self._nothing_sent()
        if self._state is FaceState.FROZEN:
            self._servos.send(limited, time_s)
        elif self._state in (FaceState.SILENT, FaceState.LETTING_GO):
            off = self._servos.torque_off
            off.go_on(time_s)
            if self._state is FaceState.LETTING_GO and off.over(time_s):
                self._state = FaceState.ENDED
            self._servos.hear()
        return self._held_deg, limited

    def _drive(self, time_s: float) -> tuple[Array, Limited]:
        silence_s = max(0.0, time_s - self._heard_s)
        level = self._stale.level(silence_s)
        wanted_deg = self._held_deg * self._stale.weight(silence_s)
        if level is StaleLevel.LIMP:
            self._servos.let_go(time_s)
            self._state = FaceState.SILENT
            return wanted_deg, self._nothing_sent()
        self._n_stale += self._was_spoken_to and level is not _FRESH
        limited = self._servos.limiter.apply(wanted_deg * self._servos.scale, time_s)
        self._servos.send(limited, time_s)
        lost = self._servos.lost_critical
        if lost:
            self.failure = f"critical {lost}; all is limp"
            self.stop(StopLevel.LIMP)
        return wanted_deg, limited

    def _ease(self, time_s: float) -> tuple[Array, Limited]:
        """Towards neutral; there, or when it has taken too long, torque goes off."""
        limiter = self._servos.limiter
        if self._way_to_rest is None:
            self._way_to_rest = WayToRest(self._joints, limiter.sent_deg, time_s)
        wanted_deg = self._way_to_rest.at(time_s)
        limited = limiter.apply(wanted_deg, time_s)
        self._servos.send(limited, time_s)
        if self._way_to_rest.over(limited.positions_deg, time_s):
            self._let_go()
        return wanted_deg, limited

    def _let_go(self) -> None:
        """Torque off now, and in every tick until all have confirmed."""
        self._state = FaceState.LETTING_GO
        if self._plugged:
            try:
                self._servos.let_go(self._tick_s)
            except PortError:
                self._unplug(self._tick_s)

    def _freeze(self) -> None:
        """Stay where every servo stands now; those that are limp stay limp."""
        if self._state is FaceState.FROZEN:
            return
        self._state = FaceState.FROZEN
        if self._plugged:
            try:
                self._servos.stay(self._tick_s)
            except PortError:
                self._unplug(self._tick_s)

    def _unplug(self, time_s: float) -> None:
        self._plugged = False
        self._servos.torque_off.forget()
        self._servos.care.lose_all(time_s, "cannot be reached: the port is gone")
        self._n_unplugged += 1
        self._retry_wait_s = _RETRY_S
        self._retry_at_s = time_s + _RETRY_S
        if self._state is FaceState.EASING:
            self._state = FaceState.LETTING_GO

    def _try_port(self, time_s: float) -> None:
        """Try the port again, ever more patiently. What a person stopped stays stopped."""
        if time_s < self._retry_at_s:
            return
        try:
            self._servos.reopen()
            if self._state is FaceState.FROZEN:
                self._servos.keep_holding(time_s)
            else:
                self._servos.let_go(time_s)
        except BusError:
            self._retry_wait_s = min(2.0 * self._retry_wait_s, _LONGEST_RETRY_S)
            self._retry_at_s = time_s + self._retry_wait_s
            return
        self._plugged = True
        self._n_armed += self._state is FaceState.DRIVEN

    def _listen(self, time_s: float) -> None:
        """Take what the speech side sent; a face limp in a silence wakes at fresh targets."""
        self._track.push(self._channel.drain())
        target_deg, age_s = self._track.at(time_s)
        if target_deg is None or self._stale.level(age_s) is not _FRESH:
            return
        if self._state is _SILENT:
            self._state = _DRIVEN
            self._n_armed += 1
        if self._state is _DRIVEN:
            self._heard_s = max(self._heard_s, time_s - age_s)
            self._held_deg = target_deg
            self._was_spoken_to = True

    def _report(self, time_s: float, late: int, wanted_deg: Array, limited: Limited) -> TickReport:
        silence_s = max(0.0, time_s - self._heard_s)
        return TickReport(
            time_s=time_s,
            late=late,
            wanted_deg=wanted_deg,
            sent_deg=limited.positions_deg,
            target_age_s=silence_s,
            stale=self._stale.level(silence_s),
            torque_on=self._servos.care.any_driven,
            range_hits=limited.range_hits,
            rate_hits=limited.rate_hits,
            rejected=limited.rejected,
        )

    def _nothing_sent(self) -> Limited:
        none = self._no_hits
        return Limited(self._servos.limiter.sent_deg, none, none, none, none)


def _by_a_person(level: StopLevel) -> str:
    return f"stopped by a person ({level.value})"
