"""One tick of the bridge: targets in, one safe goal a servo out. The caller owns loop and clock."""

from collections.abc import Callable

import numpy as np

from firmware_bridge.arrays import Array
from firmware_bridge.bus import BusError, PortError
from firmware_bridge.gate.limits import Limited, StaleLevel
from firmware_bridge.loop.bridge_parts import BridgeParts
from firmware_bridge.loop.ease_to_neutral import EaseToNeutral
from firmware_bridge.loop.report import FaceState, TickReport
from firmware_bridge.orders import Order, StartFace
from firmware_bridge.stopping import START_WHILE_STOPPING, StopLevel, StopReport

#: Looking a member up in its enumeration costs as much as comparing ten; a tick does it often.
_DRIVEN, _SILENT, _FRESH = FaceState.DRIVEN, FaceState.SILENT, StaleLevel.FRESH


class Bridge(BridgeParts):
    """Turns targets into goals on a bus that its caller has opened.

    Limp until `start`. A servo in trouble is left out and supervised while the others go on; a
    port that goes is waited for; torque comes on through the `TorqueGate` alone. `stop` is what a
    person asked for: it holds whatever happens to port, servos and speech, until `start`. `tick`
    never raises for them; it goes on after a stop until the state is ENDED.
    """

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
        if self._state is not FaceState.STOPPED:
            return  # a stop came in between, and holds
        self._begin(np.nan_to_num(readings.positions_deg), readings.time_s)
        self._state = FaceState.DRIVEN
        self._n_armed += 1

    def resume(self) -> None:
        """A person takes a freeze back: the face goes on from where its servos stand.

        Those that hold go on holding; those that lost their torque meanwhile are brought up one by
        one, as after a replug. Raises PortError when the port fails.
        """
        self._begin(np.nan_to_num(self._servos.read().positions_deg), self._tick_s)
        self._servos.gate.open()
        self._state = FaceState.DRIVEN
        self._n_armed += 1

    def await_start(self) -> None:
        """Stay limp after the end of a stop: ticks go on, and `start` brings the face back."""
        self._state = FaceState.STOPPED

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
        wanted_deg, limited = acted or (self._targets.held_deg, self._servos.limiter.unchanged())
        return self._report(time_s, late, wanted_deg, limited)

    def stop(self, level: StopLevel) -> None:
        """A person stops the face. LIMP and FREEZE act at once, SOFT from the next tick on.

        A stop that goes further may follow: SOFT, then LIMP; FREEZE, then either. Never raises.
        """
        if self._state in (FaceState.LETTING_GO, FaceState.ENDED):
            return
        self._jog.clear()
        self._servos.gate.close(_by_a_person(level))
        if level is StopLevel.FREEZE:
            self._freeze()
        elif level is StopLevel.LIMP or not self._can_ease():
            self._disable_all()
        else:
            self._state = FaceState.EASING

    def refusal(self, order: Order) -> str:
        """Why an order of a person to single servos is refused now, in one line; empty: it is not.

        After a stop nothing but `StartFace` leads to torque again; jogging needs `ArmJog`, and a
        face that is driven.
        """
        if isinstance(order, StartFace):
            return self._start_refusal()
        return self._single.refusal(order, self._state, plugged=self._port.is_open)

    def obey(self, order: Order, time_s: float) -> str:
        """Carry an order out from the tick of `time_s` on; why not, as `refusal`. Never raises."""
        why_not = self.refusal(order)
        if not why_not:
            try:
                self._single.note(order, time_s)
            except PortError:
                self._unplug(time_s)
        return why_not

    def stop_report(self) -> StopReport:
        """What the servos said of the end."""
        at_rest = self._easing is not None and self._easing.arrived
        return self._servos.torque_off.report(at_rest=at_rest, plugged=self._port.is_open)

    def _start_refusal(self) -> str:
        if self._servos.gate.dry_run:
            return self._servos.gate.forbidden
        if self._state in (FaceState.DRIVEN, FaceState.SILENT):
            return "the face is driven already"
        if self._state not in (FaceState.STOPPED, FaceState.FROZEN):
            return START_WHILE_STOPPING
        return "" if self._port.is_open else "the port of the servos is gone: plug it in first"

    def _can_ease(self) -> bool:
        on_its_way = self._state in (FaceState.DRIVEN, FaceState.EASING)
        return on_its_way and self._port.is_open and self._servos.supervision.any_driven

    def _begin(self, present_deg: Array, time_s: float) -> None:
        self._servos.limiter.start_from(present_deg, time_s)
        self._targets.begin(present_deg, time_s)
        self._easing = None

    def _act(self, time_s: float) -> tuple[Array, Limited]:
        """What this state sends: (wanted, sent)."""
        if self._state is _DRIVEN:
            return self._drive(time_s)
        if self._state is FaceState.EASING:
            return self._ease(time_s)
        if self._state is FaceState.FROZEN:
            return self._targets.held_deg, self._servos.stay_on(time_s)
        if self._state in (FaceState.SILENT, FaceState.LETTING_GO, FaceState.STOPPED):
            off = self._servos.torque_off
            off.go_on(time_s)
            if self._state is FaceState.LETTING_GO and off.over(time_s):
                self._state = FaceState.ENDED
            self._servos.rest(time_s)
        return self._targets.held_deg, self._servos.limiter.unchanged()

    def _drive(self, time_s: float) -> tuple[Array, Limited]:
        wanted_deg, level = self._targets.wanted(time_s)
        limiter, scale = self._servos.limiter, self._servos.scale
        if level is StaleLevel.LIMP:
            self._jog.clear()
            self._servos.disable_all(time_s)
            self._state = FaceState.SILENT
            return wanted_deg, limiter.unchanged()
        self._n_stale += self._targets.was_spoken_to and level is not _FRESH
        scaled_deg = wanted_deg * scale
        if self._jog.is_active:
            wanted_deg = scaled_deg = self._jog.guide(scaled_deg, limiter.sent_deg, scale, time_s)
        limited = limiter.apply(scaled_deg, time_s)
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
        self._jog.clear()
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
        if not self._targets.take(time_s):
            return
        if self._state is _SILENT:
            self._state = _DRIVEN
            self._n_armed += 1
        if self._state is _DRIVEN:
            self._targets.follow()

    def _report(self, time_s: float, late: int, wanted_deg: Array, limited: Limited) -> TickReport:
        silence_s = self._targets.silence_s(time_s)
        return TickReport(
            time_s=time_s,
            late=late,
            wanted_deg=wanted_deg,
            sent_deg=limited.positions_deg,
            target_age_s=silence_s,
            stale=self._settings.stale.level(silence_s),
            torque_on=self._servos.supervision.any_driven,
            range_hits=limited.range_hits,
            rate_hits=limited.rate_hits,
            rejected=limited.rejected,
        )


def _by_a_person(level: StopLevel) -> str:
    return f"stopped by a person ({level.value})"
