"""One tick of the bridge: targets in, one safe goal a servo out. The caller owns loop and clock."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from firmware_bridge.arrays import Array
from firmware_bridge.bus import BusError, PortError, ServoBus
from firmware_bridge.gate.limits import Limited, StaleLevel
from firmware_bridge.health import ServoHealth
from firmware_bridge.joints import Joint
from firmware_bridge.loop.channel import TargetTrack
from firmware_bridge.loop.ease_to_neutral import EaseToNeutral
from firmware_bridge.loop.port_retry import PortRetry
from firmware_bridge.loop.report import BridgeStatus, FaceState, TickReport
from firmware_bridge.loop.servo_group import ServoGroup
from firmware_bridge.loop.servo_supervision import ServoState
from firmware_bridge.loop.settings import BridgeSettings
from firmware_bridge.stopping import StopLevel, StopReport
from firmware_bridge.targets import TargetChannel

#: Looking a member up in its enumeration costs as much as comparing ten; a tick does it often.
_DRIVEN, _SILENT, _FRESH = FaceState.DRIVEN, FaceState.SILENT, StaleLevel.FRESH


class Bridge:
    """Turns targets into goals on a bus that its caller has opened.

    Limp until `start`. A servo in trouble is left out and supervised while the others go on; a
    port that goes is waited for; torque comes on through the `TorqueGate` alone. `stop` is what a
    person asked for: it holds whatever happens to port, servos and speech, until `start`. `tick`
    never raises for them; it goes on after a stop until the state is ENDED.
    """

    def __init__(
        self,
        bus: ServoBus,
        joints: Sequence[Joint],
        channel: TargetChannel,
        settings: BridgeSettings,
    ) -> None:
        """Joints and targets share their order."""
        self._joints = tuple(joints)
        self._channel = channel
        self._settings = settings
        self._stale = settings.stale
        self._track = TargetTrack(len(self._joints))
        self._servos = ServoGroup(bus, joints, settings)
        self._state, self._port = FaceState.STOPPED, PortRetry()
        self._tick_s = 0.0
        self._held_deg = np.zeros(len(self._joints))
        self._easing: EaseToNeutral | None = None
        self._heard_s = 0.0  # display time of the newest target due, or of the start if later
        self._was_spoken_to = False  # since the start
        self._n_ticks = self._n_late = self._n_stale = self._n_armed = 0
        #: Why the face stopped by itself; empty: it did not.
        self.failure = ""

    @property
    def rate_hz(self) -> float:
        """The nominal rate of `tick`."""
        return self._settings.rate_hz

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
        return self._port.is_open

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
            n_unplugged=self._port.n_lost,
            servo_states=tuple(
                ServoState(state) for state in self._servos.supervision.states.tolist()
            ),
        )

    @property
    def n_trouble_changes(self) -> int:
        """Grows whenever `troubles` changes, so that a loop need not look at texts."""
        return self._servos.supervision.n_changes

    @property
    def settled(self) -> bool:
        """Whether every servo is driven, or `troubles` says why not."""
        return self._servos.supervision.settled

    @property
    def given_up(self) -> Mapping[int, str]:
        """Servos that stay limp for good, by index, with the reason."""
        return self._servos.gate.given_up

    @property
    def troubles(self) -> tuple[str, ...]:
        """A line for each servo that is not driven, with the reason; for a log, not for a tick."""
        return self._servos.troubles

    def remarks(self) -> Sequence[str]:
        """What is unusual about the bus, in sentences for a log; they stay and become more."""
        return self._servos.remarks()

    def servo_health(self) -> tuple[ServoHealth, ...]:
        """How every servo was when it was asked last; for a log, not for a tick."""
        return self._servos.health()

    def start(self, may_continue: Callable[[], bool] = lambda: True) -> None:
        """A person starts the face: let everybody go, then let them hold where they stand.

        Nothing moves. Tolerant, the ticks bring up one servo after another; a critical one must be
        able to hold now. Otherwise all hold when this returns, or none: raises ServoError that
        names those who cannot. may_continue: asked in between; False: all are limp, and it returns.
        Raises PortError when the port fails.
        """
        self._servos.gate.open()
        self._servos.disable_all()
        readings = self._servos.read()
        if not self._servos.gate.dry_run:
            indices = range(len(self._joints))
            critical = [i for i in indices if self._joints[i].critical]
            self._servos.check(critical if self._settings.tolerant else indices, may_continue)
            if not self._settings.tolerant:
                self._servos.enable(indices, readings.time_s, may_continue)
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
        if self._port.is_due(time_s):
            self._try_port(time_s)
        self._take_targets(time_s)
        acted = None
        if self._port.is_open:
            try:
                acted = self._act(time_s)
            except PortError:
                self._unplug(time_s)
        wanted_deg, limited = acted or (self._held_deg, self._servos.limiter.unchanged())
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
            self._disable_all()
        else:
            self._state = FaceState.EASING

    def stop_report(self) -> StopReport:
        """What the servos said of the end."""
        at_rest = self._easing is not None and self._easing.arrived
        return self._servos.torque_off.report(at_rest=at_rest, plugged=self._port.is_open)

    def _can_ease(self) -> bool:
        on_its_way = self._state in (FaceState.DRIVEN, FaceState.EASING)
        return on_its_way and self._port.is_open and self._servos.supervision.any_driven

    def _begin(self, present_deg: Array, time_s: float) -> None:
        self._servos.limiter.start_from(present_deg, time_s)
        self._held_deg = present_deg
        self._heard_s = time_s
        self._was_spoken_to = False
        self._easing = None

    def _act(self, time_s: float) -> tuple[Array, Limited]:
        """What this state sends: (wanted, sent)."""
        if self._state is _DRIVEN:
            return self._drive(time_s)
        if self._state is FaceState.EASING:
            return self._ease(time_s)
        if self._state is FaceState.FROZEN:
            return self._held_deg, self._servos.stay_on(time_s)
        if self._state in (FaceState.SILENT, FaceState.LETTING_GO):
            off = self._servos.torque_off
            off.go_on(time_s)
            if self._state is FaceState.LETTING_GO and off.over(time_s):
                self._state = FaceState.ENDED
            self._servos.poll()
        return self._held_deg, self._servos.limiter.unchanged()

    def _drive(self, time_s: float) -> tuple[Array, Limited]:
        silence_s = max(0.0, time_s - self._heard_s)
        level = self._stale.level(silence_s)
        wanted_deg = self._held_deg * self._stale.weight(silence_s)
        if level is StaleLevel.LIMP:
            self._servos.disable_all(time_s)
            self._state = FaceState.SILENT
            return wanted_deg, self._servos.limiter.unchanged()
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
        if self._easing is None:
            self._easing = EaseToNeutral(self._joints, limiter.sent_deg, time_s)
        wanted_deg = self._easing.at(time_s)
        limited = limiter.apply(wanted_deg, time_s)
        self._servos.send(limited, time_s)
        if self._easing.over(limited.positions_deg, time_s):
            self._disable_all()
        return wanted_deg, limited

    def _disable_all(self) -> None:
        """Torque off now, and in every tick until all have confirmed."""
        self._state = FaceState.LETTING_GO
        self._act_now(self._servos.disable_all)

    def _freeze(self) -> None:
        """Stay where every servo stands now; those that are limp stay limp."""
        if self._state is FaceState.FROZEN:
            return
        self._state = FaceState.FROZEN
        self._act_now(self._servos.hold_position)

    def _act_now(self, act: Callable[[float], None]) -> None:
        """Speak to the servos between two ticks, if the port is there."""
        if self._port.is_open:
            try:
                act(self._tick_s)
            except PortError:
                self._unplug(self._tick_s)

    def _unplug(self, time_s: float) -> None:
        self._port.note_lost(time_s)
        self._servos.torque_off.forget()
        self._servos.supervision.mark_all_waiting(time_s, "cannot be reached: the port is gone")
        if self._state is FaceState.EASING:
            self._state = FaceState.LETTING_GO

    def _try_port(self, time_s: float) -> None:
        """Try to open the port again. What a person stopped stays stopped."""
        try:
            self._servos.reopen()
            if self._state is FaceState.FROZEN:
                self._servos.keep_holding(time_s)
            else:
                self._servos.disable_all(time_s)
        except BusError:
            self._port.note_failed(time_s)
            return
        self._port.note_open()
        self._n_armed += self._state is FaceState.DRIVEN

    def _take_targets(self, time_s: float) -> None:
        """Take the targets that came; fresh ones drive a face again that is limp in a silence."""
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
            torque_on=self._servos.supervision.any_driven,
            range_hits=limited.range_hits,
            rate_hits=limited.rate_hits,
            rejected=limited.rejected,
        )


def _by_a_person(level: StopLevel) -> str:
    return f"stopped by a person ({level.value})"
