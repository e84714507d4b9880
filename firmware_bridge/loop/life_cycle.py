"""From the first torque to the last: start, ticks, stops from every source, and the end."""

import contextlib
import logging
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import FrameType
from typing import Final, Protocol, Self

from firmware_bridge.bus import ServoHealth
from firmware_bridge.clock import Clock, ticks
from firmware_bridge.errors import BusError, ServoError
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.change_log import ChangeLog
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.life_table import (
    HURRIED,
    LIFE_TABLE,
    NOT_STOPPED,
    LifeAction,
    LifeEvent,
    LifeGuard,
    LifeState,
)
from firmware_bridge.process.lifeline import Message, Started, Stopped, Switched
from firmware_bridge.stop_signals import PreviousHandlers, install_handler, restore_handlers
from firmware_bridge.stopping import (
    PORT_WAIT_S,
    Order,
    ServoOrder,
    ServoSwitch,
    StartFace,
    StopLevel,
    StopReport,
    StopRequest,
)


class Control(Protocol):
    """The source of a person's stops and other orders: `ControlSocket`."""

    def poll(self) -> StopRequest | None:
        """Return the stop requested since the last call, None if none was; never waits.

        Sends no client an answer: `answer` does.
        """

    def answer(
        self,
        status: Callable[[], Mapping[str, object]],
        of_stop: Callable[[], Mapping[str, object]],
    ) -> None:
        """Answer the requests received, once a stop was acted on; never waits.

        status: makes the status, for clients that request it. of_stop: makes what the answer to a
        stop says of the servos.
        """

    def attend(self, refusal: Callable[[Order], str]) -> None:
        """Accept orders to servos and face from now on.

        refusal: returns for an order why it is refused now, or an empty text to accept it.
        """

    def take_orders(self) -> Sequence[Order]:
        """Return the orders accepted since the last call, oldest first; never waits."""

    def report_end(self, report: Mapping[str, object]) -> None:
        """Send the clients that requested a stop the report of how it ended."""


class Heartbeat(Protocol):
    """The sender of reports to a supervisor: `Lifeline`."""

    def beat(self) -> None:
        """Report that the loop is alive."""

    def tell(self, message: Message) -> None:
        """Report what must outlive this process: a stop, a start, a switched or failed servo."""


@dataclass(frozen=True, slots=True)
class LifeCycleLinks:
    """Optional connections of a `LifeCycle` to the outside; None: there is none.

    control: a person's stops and orders. lifeline: reports to a supervisor. status: returns the
    face's status for clients of the control socket. on_health: called every 10 s with all servos'
    condition; must return at once. not_kept: returns why a stop cannot be kept beyond this process,
    one line; empty: it can.
    """

    control: Control | None = None
    lifeline: Heartbeat | None = None
    status: Callable[[], Mapping[str, object]] = dict
    on_health: Callable[[tuple[ServoHealth, ...]], None] | None = None
    not_kept: Callable[[], str] = str


_LOG: Final = logging.getLogger(__name__)
#: So long torque off is repeated after a second signal or an error; servos that have not confirmed
#: by then are reported.
_LAST_TRIES_S: Final = 0.5
_OVER: Final = "the program is over: the next stop ends it"
#: Orders to servos that the supervisor is told, since a restarted bridge must keep to them.
_KEPT: Final = (ServoSwitch.OFF, ServoSwitch.ON)


class ImmediateStop(BaseException):
    """Raised by a second signal: torque is switched off now, whatever the program is doing."""


class LifeCycle:
    """The context manager around all ticks of a `Bridge`, so that torque is off however it is left.

    ::

        with bus, LifeCycle(bridge, clock) as life:
            life.start()
            for time_s, late in life.ticks():
                bridge.tick(time_s, late)

    However the block is left, the face is brought to rest first, and `report` has what each servo
    confirmed. A first signal (INT, TERM, HUP, QUIT) stops softly, a second one switches torque off
    at once; after an error of servos or port nothing is eased. While the port is lost, a stop by a
    signal waits for the port for half a minute, or until a third signal; a stop through the control
    socket waits without limit.
    """

    def __init__(
        self,
        bridge: Bridge,
        clock: Clock,
        links: LifeCycleLinks | None = None,
        *,
        stopped: StopRequest | None = None,
        waits: bool = False,
    ) -> None:
        """Set up the life cycle of `bridge`; nothing is switched on.

        Parameters
        ----------
        stopped : a person's stop of this face in an earlier process of the operating system; None:
            the face is to start. FREEZE: servos with torque keep it, no other gets it. Any other
            stop: torque off; the face waits for a start if `waits`.
        waits : whether a soft or limp stop by the control socket leaves a face that waits, limp,
            for a start; otherwise every stop but FREEZE ends the ticks.
        """
        self._bridge = bridge
        self._clock = clock
        self._grid = ticks(clock, bridge.rate_hz)
        self._links = links or LifeCycleLinks()
        self._log = ChangeLog(bridge, clock.now(), self._links.lifeline, self._links.on_health)
        self.waits = waits
        self._state = LifeState.NOT_STARTED
        self._request = stopped
        self._level = StopLevel.SOFT if stopped is None else stopped.level
        self._n_signals = self._n_obeyed = 0
        self._give_up_s = float("inf")
        self._previous_handlers: PreviousHandlers = {}
        self._stop_report: StopReport | None = None
        self._at_s = 0.0  # when the servos said so, seconds since 1970
        #: The first signal that came, if any.
        self.signal_number: int | None = None
        #: What is known of the servos; after the block.
        self.report: StopReport | None = None

    @property
    def state(self) -> LifeState:
        """Where the face is between its first torque and its last."""
        return self._state

    @property
    def stopping(self) -> bool:
        """Whether a stop was requested, with no start since."""
        return self._state not in NOT_STOPPED

    @property
    def stopped_by_person(self) -> bool:
        """Whether a person requested the end, by a signal or through the control socket."""
        return bool(self._n_signals) or self._request is not None

    def start(self) -> None:
        """Start the face, or keep it as an earlier process stopped it. Raises as `Bridge.start`."""
        if self._request is None:
            self._fire(LifeEvent.START)
        elif self._request.level is StopLevel.FREEZE:
            self._fire(LifeEvent.KEEP)
        else:
            self._fire(LifeEvent.STOP)

    def stop(self, level: StopLevel = StopLevel.SOFT) -> None:
        """Stop the face at the end of the program; `ticks` goes on until the face is at rest."""
        if self._state in NOT_STOPPED:
            self._level = level
        self._fire(LifeEvent.PROGRAM_END)

    def ticks(self) -> Iterator[tuple[float, int]]:
        """Yield (time, ticks missed before it) on the grid, until the face is limp after a stop."""
        for time_s, late in self._grid:
            self._obey_orders(time_s, is_stopped_now=self._hear())
            self._log.look(time_s)
            if self._bridge.state is FaceState.ENDED:
                self._fire(LifeEvent.LIMP)
            elif time_s >= self._port_due_s(time_s):
                self._fire(LifeEvent.GIVE_UP)
            if self._state is LifeState.OVER:
                return
            yield time_s, late

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._previous_handlers = install_handler(self._on_signal)
        if self._links.control is not None:
            self._links.control.attend(self._refusal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: object
    ) -> bool:
        """Bring the face to rest, switch torque off, report it, and restore the signal handlers.

        A frozen face is held here until another stop. Raises ServoError if the face stopped because
        a critical servo failed. Returns True for ImmediateStop, which ends here; to any other
        exception the report is added if a servo did not confirm.
        """
        control, lifeline = self._links.control, self._links.lifeline
        try:
            with contextlib.suppress(ImmediateStop):
                self._end(kind)
            if self._bridge.state is not FaceState.ENDED:
                self._disable_all()
        finally:
            self._fire(LifeEvent.LEFT)
            self.report = self._bridge.stop_report()
            # With a servo unconfirmed, whoever asked is told by the supervisor, which goes on.
            if control is not None and (self.report.complete or lifeline is None):
                control.report_end(self._end_of_stop(self.report, waits=self._is_kept))
            _LOG.log(self.report.log_level, "%s", self.report.text())
            restore_handlers(self._previous_handlers)
        if error is not None and not self.report.complete:
            error.add_note(self.report.text())
        if kind is None and self._bridge.failure:
            raise ServoError(self._bridge.failure)
        return kind is ImmediateStop

    def _end(self, kind: type[BaseException] | None) -> None:
        """Stop the face and run ticks until it is limp; a frozen face is held until a next stop.

        A driven face is eased to neutral first. Does nothing for a face that never started, after
        `ImmediateStop`, or after an error of servos or port. kind: the type of the exception that
        ends the `with` block; None: there is none.
        """
        if kind is not None and issubclass(kind, (ImmediateStop, BusError)):
            return
        if self._bridge.state is FaceState.STOPPED:
            return  # limp: never started, or waiting for a start
        self.stop()
        if self._state is LifeState.FROZEN_LAST:
            _LOG.info("frozen: held until the next stop")
        for time_s, late in self.ticks():
            self._bridge.tick(time_s, late)

    def _disable_all(self) -> None:
        """Switch torque off now; run ticks for up to half a second until all servos confirm.

        After a second signal a lost port is waited for 30 s more, or until one more signal.
        """
        self._fire(LifeEvent.DISABLE)
        self._bridge.stop(StopLevel.LIMP)
        until_s, n_signals = self._clock.now() + _LAST_TRIES_S, self._n_signals
        if n_signals > 1 and not self._bridge.plugged:
            until_s += PORT_WAIT_S
            _LOG.warning(
                "the port is gone: once it is back, the servos are let go; "
                "one more signal leaves them as they are"
            )
        # A grid of its own: an exception may have struck inside the other one.
        for time_s, late in ticks(self._clock, self._bridge.rate_hz):
            if self._bridge.state is FaceState.ENDED or time_s >= until_s:
                return
            if self._n_signals > n_signals and not self._bridge.plugged:
                return
            self._bridge.tick(time_s, late)

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        """Count a signal, which the next tick obeys, so that no tick is left half done.

        Raises ImmediateStop at the second signal.
        """
        self._n_signals += 1
        if self.signal_number is None:
            self.signal_number = number
        if self._n_signals > 1 and self._state not in HURRIED:
            self._fire(LifeEvent.DISABLE)
            raise ImmediateStop

    def _fire(self, event: LifeEvent) -> bool:
        """Set the state by the row of `LIFE_TABLE` for `event`, and carry out its actions.

        Return False, having done nothing, if the present state has no such row.
        """
        row = LIFE_TABLE.find(self._state, event, self._holds)
        if row is None:
            return False
        self._state = row.then or self._state
        for action in row.do:
            self._do(action)
        return True

    def _holds(self, guard: LifeGuard) -> bool:
        match guard:
            case LifeGuard.WAITS:
                return self.waits
            case LifeGuard.CAN_FREEZE:
                return self._bridge.state is FaceState.EASING

    def _do(self, action: LifeAction) -> None:
        """Carry out one action of `LIFE_TABLE`. ARM, ARM_AGAIN and KEEP may raise BusError."""
        match action:
            case LifeAction.ARM | LifeAction.ARM_AGAIN:
                by_person = action is LifeAction.ARM_AGAIN
                self._bridge.start(self._may_continue, by_person=by_person)
                _LOG.debug("armed: %s", self._bridge.torque_by_name())
                self._fire(LifeEvent.STARTED)
            case LifeAction.KEEP:
                self._bridge.start_frozen()
            case LifeAction.STOP:
                self._bridge.stop(self._level)
            case LifeAction.STOP_SOFTLY:
                self._bridge.stop(StopLevel.SOFT)
            case LifeAction.LET_GO:
                self._bridge.stop(StopLevel.LIMP)
            case LifeAction.TELL_WAITING:
                self._tell_waiting()

    def _may_continue(self) -> bool:
        """Act on stops while the face is started; return whether the start may go on."""
        self._hear()
        return self._state is LifeState.STARTING

    def _hear(self) -> bool:
        """Send a heartbeat and act on signals; return whether a client requested a stop.

        The stop is carried out first, and only then clients are answered.
        """
        control, lifeline = self._links.control, self._links.lifeline
        if lifeline is not None:
            lifeline.beat()
        if self._n_signals != self._n_obeyed:  # a freeze after the last signal stays
            self._n_obeyed = self._n_signals
            if self._fire(LifeEvent.SIGNAL):
                _LOG.info("stopping: %s", signal.Signals(self.signal_number or 0).name)
        if control is None:
            return False
        request = control.poll()
        if request is not None:
            self._obey_stop(request)
        control.answer(self._described, self._of_stop)
        return request is not None

    def _obey_stop(self, request: StopRequest) -> None:
        """Carry out a person's stop: tell the supervisor process of it, then stop the servos.

        The supervisor keeps the stop if this process dies. A freeze for which
        the table has no row, as after a stop that made the face limp, changes nothing and is not
        reported.
        """
        level, before = request.level, self._request
        _LOG.info("stop requested: %s, by %s", level.value, request.requested_by)
        event = LifeEvent.STOP_AND_END if request.ends else LifeEvent.STOP
        event = LifeEvent.FREEZE if level is StopLevel.FREEZE else event
        # A row of the table means that the event changes something in the present state.
        is_meant = LIFE_TABLE.find(self._state, event, self._holds) is not None
        if self._links.lifeline is not None and (is_meant or level is not StopLevel.FREEZE):
            self._links.lifeline.tell(Stopped(level, request.ends, request.requested_by))
        if is_meant:
            self._level = level
            self._fire(event)
            ends = request.ends or (before is not None and before.ends)
            self._request = replace(request, ends=ends)

    @property
    def _is_kept(self) -> bool:
        """Whether a supervisor keeps the stopped face, limp, for a start."""
        request = self._request
        has_end = request is None or request.ends or self._n_signals or self._bridge.failure
        return self._links.lifeline is not None and not has_end

    def _tell_waiting(self) -> None:
        """Report the end of the stop, and let the limp face wait until a person starts it."""
        report = self._stop_report = self._bridge.stop_report()
        self._at_s = round(time.time(), 3)
        if self._links.control is not None:
            self._links.control.report_end(self._end_of_stop(report, waits=True))
        waits = "it waits: `lipservo start` starts it again"
        _LOG.log(report.log_level, "%s; %s", report.text(), waits)
        self._bridge.await_start()

    def _described(self) -> dict[str, object]:
        """Return the face's status for clients, with the last stop and its stop report."""
        stopped, report = self._request, self._stop_report
        return {
            **self._links.status(),
            "stopped": None if stopped is None else stopped.level.value,
            "stopped_by": None if stopped is None else stopped.requested_by,
            "stop_report": None if report is None else {**report.as_dict(), "at_s": self._at_s},
            "can_start": not self._refusal(StartFace()),
        }

    def _of_stop(self) -> dict[str, object]:
        """Return what the answer to a stop says: which servos hold, and whether it is kept."""
        return {**self._bridge.torque_by_name(), **self._kept()}

    def _end_of_stop(self, report: StopReport, *, waits: bool) -> dict[str, object]:
        """Return what clients that requested a stop get about its end."""
        return {"waits": waits, **report.as_dict(), **self._kept()}

    def _kept(self) -> dict[str, object]:
        return {"not_kept": why} if (why := self._links.not_kept()) else {}

    def _refusal(self, order: Order) -> str:
        """Return why an order is refused now; empty: it is accepted."""
        can_start = LIFE_TABLE.find(self._state, LifeEvent.START, self._holds) is not None
        is_last = isinstance(order, StartFace) and not can_start
        return self._bridge.refusal(order) or (_OVER if is_last else "")

    def _obey_start(self) -> str:
        """Drive the face again for a person; return why not, "" if it is started."""
        if why_not := self._refusal(StartFace()):
            return why_not
        before, self._request = self._request, None
        try:
            self._fire(LifeEvent.START)
        except BusError as error:
            self._request = self._request or before
            self._fire(LifeEvent.NOT_STARTED)
            return str(error)
        if self._request is not None:
            return f"stopped meanwhile by {self._request.requested_by}"
        if self.stopping:
            return "stopped meanwhile by a signal"
        self._stop_report = None
        if self._links.lifeline is not None:
            self._links.lifeline.tell(Started())
        return ""

    def _obey_orders(self, time_s: float, *, is_stopped_now: bool) -> None:
        """Carry out the orders that clients sent; log starts and orders to servos.

        Servos switched off or on are reported to the supervisor, for a restarted bridge. time_s:
        the tick's. is_stopped_now: whether a stop came in this tick; then starts are refused.
        """
        control, lifeline = self._links.control, self._links.lifeline
        for order in () if control is None else control.take_orders():
            if isinstance(order, StartFace):
                why_not = "a stop came with it" if is_stopped_now else self._obey_start()
                then = why_not or "the face starts"
                _LOG.info("start requested by %s: %s", order.requested_by, then)
                continue
            why_not = self._bridge.obey(order, time_s)
            if isinstance(order, ServoOrder):
                _LOG.info("%s: %s", order, why_not or f"asked by {order.requested_by}")
                if not why_not and lifeline is not None and order.switch in _KEPT:
                    index = self._bridge.names.index(order.name)
                    lifeline.tell(Switched(index, on=order.switch is ServoSwitch.ON))

    def _port_due_s(self, time_s: float) -> float:
        """Return the monotonic time at which a stop gives up waiting for a lost port.

        30 s after the first tick in which the port is lost, the face is being let go, and the
        process ends (state LEAVING: by a signal, or the program's end); infinity otherwise.
        """
        is_lost = not self._bridge.plugged and self._bridge.state is FaceState.LETTING_GO
        if not is_lost or self._state is not LifeState.LEAVING:
            self._give_up_s = float("inf")
        elif self._give_up_s == float("inf"):
            self._give_up_s = time_s + PORT_WAIT_S
            _LOG.warning(
                "the port is gone: once it is back, the servos are let go; "
                "the third signal leaves them as they are"
            )
        return self._give_up_s
