"""From the first torque to the last: start, ticks, stops from every source, and the end."""

import contextlib
import logging
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Final, Protocol, Self

from firmware_bridge.bus import ServoHealth
from firmware_bridge.clock import Clock, ticks
from firmware_bridge.errors import BusError, ServoError
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import FaceState
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

    def answer(self, status: Callable[[], Mapping[str, object]]) -> None:
        """Answer the requests received, once a stop was acted on; never waits.

        status: makes the status, for clients that request it.
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

    def stopped(self, level: StopLevel, *, ends: bool = False, requested_by: str = "") -> None:
        """Report that a person stopped the face; ends: the operating-system process ends with it.

        requested_by: a description of the client that requested the stop.
        """

    def started(self) -> None:
        """Report that a person started the face again."""

    def failed(self, index: int, reason: str) -> None:
        """Report to the supervisor that servo number `index` was given up for good, and why."""

    def switched(self, index: int, *, on: bool) -> None:
        """Report that a person switched servo number `index` off, or `on` again."""


def _no_record(_stop: StopRequest | None) -> None:
    """Do nothing: a face that ends with its stop needs no record of the stop."""


@dataclass(frozen=True, slots=True)
class LifeCycleLinks:
    """Optional connections of a `LifeCycle` to the outside; None: there is none.

    control: a person's stops and orders. lifeline: reports to a supervisor. status: makes what the
    control socket answers. on_health: called every 10 s with all servos' condition. on_stopped:
    called with a person's stop, for what must outlive this process, or with None once a person has
    started the face again. Both must return at once.
    """

    control: Control | None = None
    lifeline: Heartbeat | None = None
    status: Callable[[], Mapping[str, object]] = dict
    on_health: Callable[[tuple[ServoHealth, ...]], None] | None = None
    on_stopped: Callable[[StopRequest | None], None] = _no_record


_LOG: Final = logging.getLogger(__name__)
#: The end after a second signal or an error: whoever has not confirmed by then is reported.
_LAST_TRIES_S: Final = 0.5
#: A trouble is told when it has lasted so long; a servo that misses one answer is none.
_TROUBLE_LASTS_S: Final = 1.0
_HEALTH_EVERY_S: Final = 10.0
_REMARKS_EVERY_S: Final = 1.0
#: What a supervisor must know of, as the next bridge has to.
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
        links = links or LifeCycleLinks()
        self._bridge = bridge
        self._clock = clock
        self._grid = ticks(clock, bridge.rate_hz)
        self._control = links.control
        self._lifeline = links.lifeline
        self._status = links.status
        self._on_health = links.on_health
        self._on_stopped = links.on_stopped
        self._stopped = stopped
        self.waits = waits
        self._ends = False
        self._n_signals = 0
        self._is_disabling = False
        self._requested_level: StopLevel | None = None
        self._by_signal = self._bounded = False
        self._give_up_s: float | None = None
        self._previous_handlers: PreviousHandlers = {}
        self._n_changes_sent = bridge.n_trouble_changes
        self._trouble_since_s: float | None = None
        self._has_sent_trouble = False
        self._was_plugged, self._was_silent = True, False
        self._n_given_up = len(bridge.given_up)
        self._health_due_s = clock.now() + _HEALTH_EVERY_S
        self._n_remarks = 0
        self._remarks_due_s = clock.now() + _REMARKS_EVERY_S
        self._stop_report: StopReport | None = None
        self._at_s = 0.0  # when the servos said so, seconds since 1970
        #: The first signal that came, if any.
        self.signal_number: int | None = None
        #: Whether a person asked for the end, by a signal or through the control socket.
        self.stopped_by_person = False
        #: What is known of the servos; after the block.
        self.report: StopReport | None = None

    @property
    def stopping(self) -> bool:
        """Whether a stop was requested, with no start since."""
        return self._requested_level is not None

    def start(self) -> None:
        """Start the face, or keep it as an earlier process stopped it. Raises as `Bridge.start`."""
        if self._stopped is None:
            self._bridge.start(self._may_continue)
            _LOG.debug("torque is on")
        elif self._stopped.level is StopLevel.FREEZE:
            self._bridge.start_frozen()
        else:
            self._stop(self._stopped.level)

    def stop(self, level: StopLevel = StopLevel.SOFT) -> None:
        """Stop the face at the end of the program; `ticks` goes on until the face is at rest."""
        self._bounded = True
        self._stop(level)

    def ticks(self) -> Iterator[tuple[float, int]]:
        """Yield (time, ticks missed before it) on the grid, until the face is limp after a stop."""
        for time_s, late in self._grid:
            self._do_tick_duties(time_s)
            if self._bridge.state is FaceState.ENDED and self._may_wait:
                self._await_start()
            if self._bridge.state is FaceState.ENDED or self._port_is_lost(time_s):
                return
            yield time_s, late

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._previous_handlers = install_handler(self._on_signal, leave_ignored=True)
        if self._control is not None:
            self._control.attend(self._bridge.refusal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: object
    ) -> bool:
        try:
            with contextlib.suppress(ImmediateStop):
                self._end(kind)
            if self._bridge.state is not FaceState.ENDED:
                self._disable_all()
        finally:
            self._is_disabling = True  # from here on a signal has nothing left to hurry
            self.report = self._bridge.stop_report()
            # With a servo unconfirmed, whoever asked is told by the supervisor, which goes on.
            if self._control is not None and (self.report.complete or self._lifeline is None):
                self._control.report_end({"waits": self._is_kept, **self.report.as_dict()})
            _LOG.log(self.report.log_level, "%s", self.report.text())
            restore_handlers(self._previous_handlers)
        if error is not None and not self.report.complete:
            error.add_note(self.report.text())
        if kind is None and self._bridge.failure:
            raise ServoError(self._bridge.failure)
        return kind is ImmediateStop

    def _end(self, kind: type[BaseException] | None) -> None:
        """Run ticks until the face is limp, eased to neutral; hold a frozen face until a stop.

        Does nothing for a face that never started, after `ImmediateStop`, or an error of servos or
        port. kind: the type of the exception that ends the block; None: there is none.
        """
        if kind is not None and issubclass(kind, (ImmediateStop, BusError)):
            return
        if self._bridge.state is FaceState.STOPPED:
            return  # never started: nothing was switched on
        if self._bridge.state is FaceState.FROZEN:
            _LOG.info("frozen: held until the next stop")  # a program's end undoes no person's stop
        elif self._requested_level is None:
            self.stop()
        self._bounded = True
        for time_s, late in self.ticks():
            self._bridge.tick(time_s, late)

    def _disable_all(self) -> None:
        """Switch torque off now, with ticks for half a second for servos that do not confirm."""
        self._is_disabling = True
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
        self.stopped_by_person = True
        if self.signal_number is None:
            self.signal_number = number
        if self._n_signals > 1 and not self._is_disabling:
            self._is_disabling = True
            raise ImmediateStop

    def _may_continue(self) -> bool:
        """Return whether a start may go on to the next servo: False once a stop was requested."""
        if self._lifeline is not None:
            self._lifeline.beat()
        if self._requested_level is None:
            self._poll_control()
        return self._requested_level is None and not self._n_signals

    def _do_tick_duties(self, time_s: float) -> None:
        """Send a heartbeat, carry out stops and orders, and log changes, before each tick."""
        if self._lifeline is not None:
            self._lifeline.beat()
        if self._n_signals and not self._by_signal:
            self._by_signal = True
            _LOG.info("stopping: %s", signal.Signals(self.signal_number or 0).name)
            self.stop()
        is_stopped_now = self._poll_control()
        self._obey_orders(time_s, is_stopped_now=is_stopped_now)
        self._log_changes(time_s)
        if self._on_health is not None and time_s >= self._health_due_s:
            self._health_due_s = time_s + _HEALTH_EVERY_S
            self._on_health(self._bridge.servo_health())
        if time_s >= self._remarks_due_s:
            self._remarks_due_s = time_s + _REMARKS_EVERY_S
            for remark in self._bridge.remarks()[self._n_remarks :]:
                self._n_remarks += 1
                _LOG.warning("%s", remark)

    def _poll_control(self) -> bool:
        """Act on a requested stop, and only then answer clients; return whether one came."""
        if self._control is None:
            return False
        request = self._control.poll()
        if request is not None:
            self._obey_stop(request)
        self._control.answer(self._described)
        return request is not None

    def _obey_stop(self, request: StopRequest) -> None:
        """Carry out a stop: report it to the supervisor process, which keeps it; then stop servos.

        The report lets the stop outlive this process. A face that is limp and waits has nothing to
        freeze: that is reported, but changes nothing.
        """
        if self._lifeline is not None:
            self._lifeline.stopped(
                request.level, ends=request.ends, requested_by=request.requested_by
            )
        self.stopped_by_person = True
        self._ends = self._ends or request.ends
        if request.level is not StopLevel.FREEZE or self._bridge.state is not FaceState.STOPPED:
            self._stopped = request
            self._stop(request.level)
        self._on_stopped(self._stopped)
        _LOG.info("stop requested: %s, by %s", request.level.value, request.requested_by)

    @property
    def _may_wait(self) -> bool:
        """Whether the limp face waits for a start after this stop; otherwise the ticks end."""
        by_person = self._stopped is not None and not (self._n_signals or self._bounded)
        return self.waits and by_person and not (self._ends or self._bridge.failure)

    @property
    def _is_kept(self) -> bool:
        """Whether a supervisor keeps the stopped face, limp, for a start."""
        has_end = self._ends or self._n_signals or self._bridge.failure
        return self._lifeline is not None and self._stopped is not None and not has_end

    def _await_start(self) -> None:
        """Report the end of the stop, and let the limp face wait until a person starts it."""
        self._stop_report, self._at_s = self._bridge.stop_report(), round(time.time(), 3)
        if self._control is not None:
            self._control.report_end({"waits": True, **self._stop_report.as_dict()})
        waits = "it waits: `lipservo start` starts it again"
        _LOG.log(self._stop_report.log_level, "%s; %s", self._stop_report.text(), waits)
        self._bridge.await_start()

    def _described(self) -> dict[str, object]:
        """Return the face's status for clients, with the last stop and the report of its end."""
        stopped, report = self._stopped, self._stop_report
        return {
            **self._status(),
            "stopped": None if stopped is None else stopped.level.value,
            "stopped_by": None if stopped is None else stopped.requested_by,
            "stop_report": None if report is None else {**report.as_dict(), "at_s": self._at_s},
            "can_start": not self._bridge.refusal(StartFace()),
        }

    def _obey_start(self) -> str:
        """Drive the face again for a person; return why not, "" if it is driven or starting."""
        if why_not := self._bridge.refusal(StartFace()):
            return why_not
        was_stopped, self._stopped = self._stopped, None
        self._requested_level = None
        try:
            if self._bridge.state is FaceState.FROZEN:
                self._bridge.resume()
            else:
                self._bridge.start(self._may_continue)
        except BusError as error:
            self._stopped = was_stopped
            self._stop(StopLevel.LIMP)
            return str(error)
        if self._stopped is None:  # nobody has stopped it in between
            self.stopped_by_person, self._stop_report = False, None
            self._on_stopped(None)
            if self._lifeline is not None:
                self._lifeline.started()
        return ""

    def _obey_orders(self, time_s: float, *, is_stopped_now: bool) -> None:
        """Carry out a person's orders; log each.

        is_stopped_now: a stop came in this tick; it comes before a start, and voids it.
        """
        for order in () if self._control is None else self._control.take_orders():
            if isinstance(order, StartFace):
                why_not = "a stop came with it" if is_stopped_now else self._obey_start()
                then = why_not or "driven again"
                _LOG.info("start requested by %s: %s", order.requested_by, then)
                continue
            why_not = self._bridge.obey(order, time_s)
            if isinstance(order, ServoOrder):
                _LOG.info("%s: %s", order, why_not or f"asked by {order.requested_by}")
                if not why_not and self._lifeline is not None and order.switch in _KEPT:
                    index = self._bridge.names.index(order.name)
                    self._lifeline.switched(index, on=order.switch is ServoSwitch.ON)

    def _stop(self, level: StopLevel) -> None:
        self._requested_level = level
        self._bridge.stop(level)

    def _port_is_lost(self, time_s: float) -> bool:
        """Return whether a stop has waited long enough for a lost port, so that the ticks end.

        A stop that a person requested through the control socket waits without limit.
        """
        if self._bridge.plugged or not self._bounded:
            self._give_up_s = None
            return False
        if self._bridge.state is not FaceState.LETTING_GO:
            return False
        if self._give_up_s is None:
            self._give_up_s = time_s + PORT_WAIT_S
            _LOG.warning(
                "the port is gone: once it is back, the servos are let go; "
                "two more signals leave them as they are"
            )
        return time_s >= self._give_up_s

    def _log_changes(self, time_s: float) -> None:
        """Log changes of port, servos and missing targets; report given-up servos to the parent.

        Texts are made only when something changed. The parent process: the supervisor.
        """
        bridge = self._bridge
        if bridge.plugged is not self._was_plugged:
            self._was_plugged = bridge.plugged
            if bridge.plugged:
                _LOG.info("the port is back")
            else:
                _LOG.warning("the port of the servos is gone")
        if bridge.state is FaceState.SILENT and not self._was_silent:
            self._was_silent = True
            _LOG.warning(
                "no motion comes from speech (the computer is too busy, or it hangs): "
                "the servos are let go until it comes"
            )
        elif bridge.state is FaceState.DRIVEN and self._was_silent:
            self._was_silent = False
            _LOG.info("motion comes again")
        if len(bridge.given_up) != self._n_given_up:
            for index, why in list(bridge.given_up.items())[self._n_given_up :]:
                if self._lifeline is not None:
                    self._lifeline.failed(index, why)
            self._n_given_up = len(bridge.given_up)
        if bridge.n_trouble_changes != self._n_changes_sent:
            self._n_changes_sent = bridge.n_trouble_changes
            self._trouble_since_s = time_s
        since_s = self._trouble_since_s
        if since_s is None or time_s - since_s < _TROUBLE_LASTS_S or not bridge.plugged:
            return
        self._trouble_since_s = None
        troubles = bridge.troubles
        if troubles:
            _LOG.warning("%s", "; ".join(troubles))
        elif self._has_sent_trouble:
            _LOG.info("every servo is driven again")
        self._has_sent_trouble = bool(troubles)
