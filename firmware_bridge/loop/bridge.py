"""One tick of the bridge: targets in, one safe goal a servo out. The caller has loop and clock."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Final

from firmware_bridge.bus import Array, Feedback, ServoBus, ServoHealth, ServoState
from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.errors import BusError, PortError, ServoError
from firmware_bridge.gate.limits import Limited
from firmware_bridge.gate.ramp import EaseToNeutral, StaleLevel
from firmware_bridge.joints import Joint, named
from firmware_bridge.known_torque import KnownTorque, Torque
from firmware_bridge.loop.face_table import (
    FACE_TABLE,
    FaceAction,
    FaceEvent,
    FaceGuard,
    FaceState,
)
from firmware_bridge.loop.report import BridgeSettings, TickReport
from firmware_bridge.loop.servo_group import ServoGroup
from firmware_bridge.loop.single_servos import Jog, SingleServos
from firmware_bridge.loop.targets import FollowedTargets, TargetChannel
from firmware_bridge.loop.tick_counts import TickCounts
from firmware_bridge.stopping import START_WHILE_STOPPING, Order, StartFace, StopLevel, StopReport

#: The first wait before a lost port is tried again, and the longest; it doubles in between.
_FIRST_WAIT_S: Final = 0.1
_LONGEST_WAIT_S: Final = 0.5


class PortRetry:
    """When to open a lost port again, in seconds of tick time.

    due_s: when to try to open it.
    """

    def __init__(self) -> None:
        self.is_open = True
        self._wait_s = self.due_s = 0.0

    def note_lost(self, time_s: float) -> None:
        """Note that the port was lost at `time_s`; the first try is due 0.1 s later."""
        self.is_open = False
        self._wait_s = _FIRST_WAIT_S
        self.due_s = time_s + _FIRST_WAIT_S

    def note_failed(self, time_s: float) -> None:
        """Note that opening the port failed; the wait before the next try doubles, up to 0.5 s."""
        self._wait_s = min(2.0 * self._wait_s, _LONGEST_WAIT_S)
        self.due_s = time_s + self._wait_s

    def note_open(self) -> None:
        """Note that the port is open again: no further try is due."""
        self.is_open = True


#: Looking a member up in its enumeration costs as much as comparing ten; a tick does it often.
_DRIVEN, _SILENT, _FRESH = FaceState.DRIVEN, FaceState.SILENT, StaleLevel.FRESH
_STOPS: Final = {
    StopLevel.SOFT: FaceEvent.SOFT,
    StopLevel.FREEZE: FaceEvent.FREEZE,
    StopLevel.LIMP: FaceEvent.LIMP,
}
#: In which key of an answer a servo is named, by what is known of its torque.
_TORQUE_KEYS: Final = {Torque.ON: "holds", Torque.OFF: "limp", Torque.UNKNOWN: "unknown"}
#: Counts in a status: of `TickCounts`, and of the gate.
_COUNTS: Final = ("n_ticks", "n_late", "n_stale", "n_armed", "n_unplugged")
_GATE_COUNTS: Final = ("range_hits", "rate_hits", "rejected", "prevented")


class Bridge:
    """The servo loop of a face: turns target angles into goals on a bus that its caller has opened.

    Limp until `start`. A servo in trouble is left out and supervised while the others go on; a lost
    port is opened again; torque comes on through the `TorqueGate` alone. `stop` is a person's
    order: it lasts whatever happens to port, servos and speech, until `start`. `tick` never raises
    for port or servos; it is to be called after a stop, too, until the state is ENDED. What an
    event does in each state is `FACE_TABLE`.
    """

    def __init__(
        self,
        bus: ServoBus,
        joints: Sequence[Joint],
        channel: TargetChannel,
        settings: BridgeSettings,
    ) -> None:
        """Make a bridge that drives no servo until `start`; send nothing.

        channel: where target angles come from, in the order of `joints`. bus: opened by the caller.
        """
        self._joints = tuple(joints)
        self._settings = settings
        self._targets = FollowedTargets(channel, len(self._joints), settings.stale)
        self._servos = ServoGroup(bus, joints, settings)
        self._jog = Jog(self._joints, settings.period_s)
        self._single = SingleServos(self._joints, self._servos, self._jog)
        self._state, self._port = FaceState.STOPPED, PortRetry()
        self._level = StopLevel.LIMP  # of the last stop
        self._tick_s = 0.0
        self._easing: EaseToNeutral | None = None
        self.counts = TickCounts(settings.rate_hz)
        #: Why the face stopped by itself; empty: it did not.
        self.failure = ""

    @property
    def rate_hz(self) -> float:
        """The nominal rate of `tick`, in Hz."""
        return self._settings.rate_hz

    @property
    def capabilities(self) -> BusCapabilities:
        """The capabilities of the face's servos."""
        return self._servos.gate.capabilities

    @property
    def state(self) -> FaceState:
        """The state of the face: stopped, driven, frozen, ..."""
        return self._state

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the joints, in the order of all arrays."""
        return tuple(joint.name for joint in self._joints)

    @property
    def plugged(self) -> bool:
        """Whether the port of the servos is open."""
        return self._port.is_open

    @property
    def servo_states(self) -> list[ServoState]:
        """The state of each servo, in the order of `names`."""
        return [ServoState(state) for state in self._servos.supervision.states.tolist()]

    @property
    def feedback(self) -> Feedback | None:
        """The positions read in the last tick; None before the first tick, and without a port."""
        return self._servos.feedback if self._port.is_open else None

    @property
    def jogged(self) -> tuple[str, ...]:
        """The names of the joints that a person is moving singly, by jog commands, now."""
        return tuple(self._joints[index].name for index in self._jog.jogged)

    @property
    def n_trouble_changes(self) -> int:
        """A count that grows with each change of `troubles`, so that loops compare no texts."""
        return self._servos.supervision.n_changes

    @property
    def settled(self) -> bool:
        """Whether the start is complete: every servo is driven or has a reason in `troubles`."""
        return self._servos.supervision.settled

    @property
    def given_up(self) -> Mapping[int, str]:
        """Servos that stay limp for good: reason by index."""
        return self._servos.gate.given_up

    @property
    def troubles(self) -> tuple[str, ...]:
        """A line for each servo that is not driven, with the reason; too slow for every tick."""
        return self._servos.troubles

    def remarks(self) -> Sequence[str]:
        """Return what is unusual about the bus, as sentences for a log; the list only grows."""
        return self._servos.remarks()

    def pulses(self) -> dict[str, dict[str, float | None]]:
        """Return by joint name each hobby servo's `JointPulse` and sent_us, the pulse sent last.

        sent_us is None for a servo that is not known to get one.
        """
        known = self.torque
        rows = zip(self._joints, known.sent_us.tolist(), known.as_json(), strict=True)
        return {
            joint.name: {
                **asdict(joint.pulse),
                "sent_us": round(us, 2) if is_on and math.isfinite(us) else None,
            }
            for joint, us, is_on in rows
            if joint.pulse is not None
        }

    def as_dict(self) -> dict[str, object]:
        """Return the face's status as one object for JSON; too slow for every tick.

        state: a `FaceState`; dry_run: whether the servos are only read; plugged: whether the port
        is open; torque_on: as of `KnownTorque.any_on`; torque: `KnownTorque.records`, their ages at
        the last tick; servos: each `ServoState` in words, `starting` where a servo is to be driven,
        but is not known to have torque yet; troubles: a line for each servo that is not driven, and
        for what comes too late; jogged: joints that a person jogs, by name; health: a `ServoHealth`
        for each servo that was polled, None for what was never read; capabilities: what the bus can
        do; pulses: as from `pulses`; *_total: how often the gate changed a goal, over all joints;
        the other counts are those of `TickCounts`.
        """
        servos, counts, gate = self._servos, self.counts, self._servos.limiter.counts
        return {
            "state": self._state.value,
            "dry_run": servos.gate.dry_run,
            "plugged": self.plugged,
            "torque_on": self.torque.any_on,
            "torque": dict(zip(self.names, self.torque.records(self._tick_s), strict=True)),
            "servos": dict(zip(self.names, servos.words(), strict=True)),
            "troubles": [*self.troubles, *counts.delays()],
            "jogged": list(self.jogged),
            "health": servos.health_records(),
            "capabilities": self.capabilities.as_dict(),
            "pulses": self.pulses(),
            "n_rejected_targets": self._targets.n_rejected,
            **{name: getattr(counts, name) for name in _COUNTS},
            **{f"{name}_total": int(getattr(gate, name).sum()) for name in _GATE_COUNTS},
            "bridge_pid": os.getpid(),
        }

    def servo_health(self) -> tuple[ServoHealth, ...]:
        """Return the last reading of every servo's condition; too slow for every tick."""
        return self._servos.health()

    @property
    def torque(self) -> KnownTorque:
        """What is known of the servos' torque."""
        return self._servos.torque

    def torque_by_name(self) -> dict[str, list[str]]:
        """Return the names of the servos that hold, that are limp, and of which neither is known.

        Keys: holds, limp, unknown.
        """
        known: dict[str, list[str]] = {key: [] for key in _TORQUE_KEYS.values()}
        for name, state in zip(self.names, self.torque.states.tolist(), strict=True):
            known[_TORQUE_KEYS[Torque(state)]].append(name)
        return known

    def start(
        self, may_continue: Callable[[], bool] = lambda: True, *, by_person: bool = False
    ) -> None:
        """Start the face, or end a freeze; nothing moves.

        A limp face: all torque is switched off, then on at the present positions. If `tolerant` in
        the settings, or by_person, the ticks bring up one servo after another, and only critical
        servos must be able to hold now. Otherwise all hold when this returns, or none: raises
        ServoError that names those that cannot. A frozen face: servos with torque keep it; the
        ticks bring up the others. Raises PortError when the port fails.

        may_continue: called before each servo and between tries; False ends the start, and unless a
        stop has acted already, all torque goes off. by_person: servos that were given up are tried
        again.
        """
        servos = self._servos
        if why_not := self._start_refusal(dry_run=False):
            raise ServoError(why_not)
        if by_person:
            servos.try_all_again(self._tick_s)
        self.failure = ""
        self._fire(FaceEvent.START)
        if self._state is not FaceState.STARTING:
            return  # a freeze has ended
        try:
            servos.disable_all()
            self._begin()
            if not servos.gate.dry_run:
                indices = range(len(self._joints))
                critical = [i for i in indices if self._joints[i].critical]
                strict = not (self._settings.tolerant or by_person)
                servos.check(indices if strict else critical, may_continue)
                if strict:
                    servos.enable(indices, self._tick_s, may_continue)
        except BusError:
            self._fire(FaceEvent.NOT_STARTED)
            raise
        # Where a stop came in between, the face is in another state, and this means nothing.
        self._fire(FaceEvent.STARTED if may_continue() else FaceEvent.NOT_STARTED)

    def await_start(self) -> None:
        """Set the state to STOPPED once a stop is over: all is limp until `start`; ticks go on."""
        self._fire(FaceEvent.WAIT)

    def start_frozen(self) -> None:
        """Start as a face that a person froze: hold servos whose torque is on; switch none on."""
        self._level = StopLevel.FREEZE
        self._fire(FaceEvent.KEEP)

    def tick(self, time_s: float, late: int = 0) -> TickReport:
        """Run one tick: send the goals for `time_s`; return its report.

        The report has the goals wanted and sent, the age of the targets, whether torque is on, and
        which limits changed a goal. time_s: the tick's planned time, monotonic. late: how many
        ticks were missed before it. A port that fails is handled here; a ServoError of the bus, as
        when the guard of a PCA9685's OE pin has died, is raised.
        """
        self._tick_s = time_s
        port, targets, servos = self._port, self._targets, self._servos
        if not port.is_open and time_s >= port.due_s:
            self._try_port(time_s)
        if targets.take(time_s):
            if self._state is _SILENT:  # limp because no targets came; they come again
                self._fire(FaceEvent.TARGET)
            if self._state is _DRIVEN:
                targets.follow()
        silence_s = targets.silence_s(time_s)
        level = self._settings.stale.level(silence_s)
        # Only a face that has had a first target since its start can miss one.
        waits = port.is_open and self._state in (_DRIVEN, _SILENT) and targets.was_spoken_to
        self.counts.add(late, is_stale=waits and level is not _FRESH)
        acted = None
        if port.is_open:
            try:
                if self._state is _DRIVEN:
                    acted = self._drive(time_s, targets.wanted(silence_s, level), level)
                else:
                    acted = self._act(time_s)
            except PortError:
                self._unplug(time_s)
        if not port.is_open:
            servos.wait_for_port(time_s, lets_go=self._state is not FaceState.FROZEN)
        # Without an open port nothing was sent: the report repeats the last goals.
        wanted_deg, limited = acted or (targets.held_deg, servos.limiter.unchanged())
        return TickReport(
            time_s=time_s,
            late=late,
            wanted_deg=wanted_deg,
            sent_deg=limited.positions_deg,
            target_age_s=silence_s,
            stale=level,
            torque_on=servos.torque.any_on,
            range_hits=limited.range_hits,
            rate_hits=limited.rate_hits,
            rejected=limited.rejected,
        )

    def stop(self, level: StopLevel) -> None:
        """Stop the face for a person: SOFT to neutral, then limp; LIMP; or FREEZE, held as it is.

        LIMP and FREEZE act at once, in every state but those on the way to limp; SOFT from the next
        tick on. A stop that goes further may follow: SOFT, then LIMP; FREEZE, then either. FREEZE
        of a limp face holds nothing, and of a face that is being started the servos that have
        torque by then. Never raises.
        """
        self._level = level
        self._fire(_STOPS[level])

    def refusal(self, order: Order) -> str:
        """Return why a person's order to servos or face is refused now; empty: it is accepted.

        After a stop nothing but `StartFace` leads to torque again; jogging needs `ArmJog`, and a
        face that is driven.
        """
        if isinstance(order, StartFace):
            return self._start_refusal(dry_run=self._servos.gate.dry_run)
        return self._single.refusal(order, self._state, plugged=self._port.is_open)

    def obey(self, order: Order, time_s: float) -> str:
        """Carry out an order to servos; return why it is refused, "" if it is not. Never raises."""
        why_not = self.refusal(order)
        if not why_not:
            try:
                self._single.note(order, time_s)
            except PortError:
                self._unplug(time_s)
        return why_not

    def stop_report(self) -> StopReport:
        """Return which servos confirmed torque off, and whether the face was at neutral before."""
        at_rest = self._easing is not None and self._easing.arrived
        return self._servos.torque_off.report(at_rest=at_rest, plugged=self._port.is_open)

    def _start_refusal(self, *, dry_run: bool) -> str:
        """Return why a start is refused now; empty: it is accepted.

        dry_run: True refuses a person's start, since no servo gets torque in a dry run; `start`
        passes False, since the program's own start of a dry run only reads the servos.
        """
        if dry_run:
            return self._servos.gate.forbidden
        if self._state in (FaceState.DRIVEN, FaceState.SILENT):
            return "the face is driven already"
        if self._state not in (FaceState.STOPPED, FaceState.FROZEN):
            return START_WHILE_STOPPING
        return "" if self._port.is_open else "the port of the servos is gone: plug it in first"

    def _fire(self, event: FaceEvent) -> None:
        """Set the state by the row of `FACE_TABLE` for `event`, and carry out its actions.

        An event without a row for the present state does nothing.
        """
        row = FACE_TABLE.find(self._state, event, self._holds)
        if row is not None:
            self._state = row.then or self._state
            for action in row.do:
                self._do(action)

    def _holds(self, guard: FaceGuard) -> bool:
        match guard:
            case FaceGuard.CAN_EASE:
                return self._port.is_open and self._servos.supervision.any_driven

    def _do(self, action: FaceAction) -> None:
        """Carry out one action of `FACE_TABLE`.

        BEGIN raises PortError. In all other actions a port that fails is marked as lost.
        """
        servos = self._servos
        match action:
            case FaceAction.ALLOW_TORQUE:
                servos.gate.open()
            case FaceAction.FORBID_TORQUE:
                self._jog.clear()
                servos.gate.close(f"stopped by a person ({self._level.value})")
                self._act_now(servos.drop_waiting)
            case FaceAction.BEGIN:
                self._begin()
            case FaceAction.HOLD:
                self._act_now(servos.hold_position)
            case FaceAction.KEEP_HOLDING:
                self._act_now(servos.keep_holding)
            case FaceAction.LET_GO if self._port.is_open:
                self._jog.clear()
                self._act_now(servos.disable_all)
            case FaceAction.LET_GO | FaceAction.LEAVE_PORT | FaceAction.LEAVE_PORT_HELD:
                servos.lose_port(self._tick_s, lets_go=action is not FaceAction.LEAVE_PORT_HELD)
            case FaceAction.COUNT_START:
                self.counts.n_armed += 1

    def _begin(self) -> None:
        """Read the servos' positions; set them as last goals and as targets. Raises PortError."""
        readings = self._servos.read()
        present_deg, self._tick_s = readings.start_deg(self.capabilities), readings.time_s
        self._servos.limiter.start_from(present_deg, self._tick_s)
        self._targets.begin(present_deg, self._tick_s)
        self._easing = None

    def _act(self, time_s: float) -> tuple[Array, Limited]:
        """Run the tick of a face that does not follow targets; return goals (wanted, after limits).

        By its state: ease it to neutral, hold it frozen, or switch torque off until all servos have
        confirmed. Goals are (n_joints,) degrees. Raises PortError.
        """
        if self._state is FaceState.EASING:
            return self._ease(time_s)
        if self._state is FaceState.FROZEN:
            return self._targets.held_deg, self._servos.stay_on(time_s)
        if self._state in (FaceState.SILENT, FaceState.LETTING_GO, FaceState.STOPPED):
            off = self._servos.torque_off
            off.go_on(time_s)
            if off.over(time_s):
                self._fire(FaceEvent.ALL_OFF)
            self._servos.rest(time_s)
        return self._targets.held_deg, self._servos.limiter.unchanged()

    def _drive(self, time_s: float, wanted_deg: Array, level: StaleLevel) -> tuple[Array, Limited]:
        """Run the tick of a driven face; return the goals (wanted, after limits), (n_joints,) deg.

        wanted_deg: the targets. level: what the age of the targets requires; LIMP switches all
        torque off. The face is stopped if a critical servo has failed. Raises PortError.
        """
        limiter, scale = self._servos.limiter, self._servos.scale
        if level is StaleLevel.LIMP:
            self._fire(FaceEvent.STALE)
            return wanted_deg, limiter.unchanged()
        scaled_deg = wanted_deg * scale  # smaller motion spares hot servos
        if self._jog.is_active:
            wanted_deg = scaled_deg = self._jog.guide(scaled_deg, limiter.sent_deg, scale, time_s)
        limited = self._send(scaled_deg, time_s)
        supervision = self._servos.supervision
        lost = supervision.lost_critical
        if lost is not None:
            why = f"{named(self._joints[lost])} {supervision.reasons[lost]}"
            self.failure = f"critical {why}; the face was stopped"
            self.stop(StopLevel.LIMP)
        return wanted_deg, limited

    def _ease(self, time_s: float) -> tuple[Array, Limited]:
        """Run a tick of a soft stop: send goals towards neutral; torque off there, or after 2 s.

        Return the goals (wanted, after limits), (n_joints,) degrees. Raises PortError.
        """
        driven = self._servos.supervision.driven
        if self._easing is None:  # a limp joint, wherever it hangs, is not waited for
            start_deg = driven * self._servos.limiter.sent_deg
            self._easing = EaseToNeutral(self._joints, start_deg, time_s)
        wanted_deg = self._easing.at(time_s)
        limited = self._send(wanted_deg, time_s)
        if self._easing.over(limited.positions_deg, driven, time_s):
            self._fire(FaceEvent.ARRIVED)
        return wanted_deg, limited

    def _send(self, goals_deg: Array, time_s: float) -> Limited:
        """Send goals, (n_joints,) degrees, through the limiter; return what it made of them.

        A person who jogs a joint may lead it beyond its limits: the range of the limiter follows,
        and shrinks again as the joint comes back. Raises PortError.
        """
        servos = self._servos
        if self._jog.is_active or servos.is_wide:
            servos.widen(*self._jog.reached(servos.limiter.sent_deg))
        limited = servos.limiter.apply(goals_deg, time_s)
        servos.send(limited, time_s)
        return limited

    def _act_now(self, act: Callable[[float], None]) -> None:
        """Call `act` with the last tick's time if the port is open; note a port that fails."""
        if self._port.is_open:
            try:
                act(self._tick_s)
            except PortError:
                self._unplug(self._tick_s)

    def _unplug(self, time_s: float) -> None:
        """Note that a port is lost; switch all torque off, unless a person froze the face."""
        self._port.note_lost(time_s)
        self.counts.n_unplugged += 1
        self._jog.clear()
        self._fire(FaceEvent.PORT_LOST)

    def _try_port(self, time_s: float) -> None:
        """Open the port again, if possible, with all torque off; a frozen face keeps its torque."""
        try:
            self._servos.reopen()
        except BusError:
            self._port.note_failed(time_s)
            return
        self._port.note_open()
        self._fire(FaceEvent.PORT_BACK)
