"""Keep the processes of one face alive, and the face safe while one of them is not.

The processes are the bridge, which drives the servos, and speech.

One loop, one thread, no sleep: it waits for whatever comes first, a heartbeat, an end, a
request, a signal, a deadline. A stop by a person is kept here, so that it outlives every process.
What follows what is `SUPERVISOR_TABLE`.
"""

import logging
import select
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.process.child import Child, RestartedChild
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.lifeline import (
    Began,
    Failed,
    NotStarted,
    Ready,
    Started,
    Stopped,
    Switched,
)
from firmware_bridge.process.operating_system import ServiceNotice
from firmware_bridge.process.stop_record import StopRecord
from firmware_bridge.process.supervisor_table import (
    SUPERVISOR_TABLE,
    Phase,
    Requested,
    SupervisorAction,
    SupervisorEvent,
)
from firmware_bridge.process.torque_release import FaceRelease
from firmware_bridge.stop_signals import SignalCounter
from firmware_bridge.stopping import (
    PORT_WAIT_S,
    START_WHILE_STOPPING,
    ExitStatus,
    Order,
    ServoOrder,
    ServoSwitch,
    StartFace,
    StopLevel,
    StopReport,
    StopRequest,
    let_go_report,
)

_LOG: Final = logging.getLogger(__name__)
#: Easing to neutral takes two seconds at most, limp a few packets more.
_END_S: Final = 5.0
#: How long any end waits for servos that are silent.
_SERVO_TIMEOUT_S: Final = 3.0
#: How long a lost port is waited for where no bridge can have switched torque on: none has served.
_START_TIMEOUT_S: Final = 2.0
#: Longer than any recovery that succeeds takes; after that systemd may restart the service.
_RECOVERY_S: Final = 60.0
_LONGEST_WAIT_S: Final = 0.25
_REQUESTS_AT_ONCE: Final = 16
_CHILD_END_S: Final = 2.0
#: The answer to a stop, sent after the stop has acted, waits so long for the disk, since it says
#: whether the stop is kept for a restart.
_RECORD_S: Final = 0.1
#: A stopped face with servos that have not confirmed is let go again this often.
_RELEASE_AGAIN_S: Final = 5.0


#: A bridge that ends with one of these is not started again.
_HOPELESS: Final = (ExitStatus.CRITICAL_SERVO_FAILED, ExitStatus.UNCONFIRMED)
#: Levels of a stop after which all servos are to be limp.
_LIMP_LEVELS: Final = (StopLevel.SOFT, StopLevel.LIMP)


@dataclass(frozen=True, slots=True)
class SupervisedServos:
    """The data of a face's servos that are needed while no bridge drives them.

    can: the capabilities of each servo, by name. make_release: a function that returns a
    `FaceRelease`, given for how many seconds silent servos are polled again.
    """

    can: Mapping[str, BusCapabilities]
    make_release: Callable[[float], FaceRelease]


class Supervisor:
    """The parent of a face's processes bridge (servos) and speech: restarts one that dies or hangs.

    It keeps a person's stops, and which servos failed or were switched off, for a restarted bridge.
    """

    def __init__(
        self,
        bridge: Child,
        speech: Child,
        control: ControlSocket,
        servos: SupervisedServos,
        *,
        notice: ServiceNotice,
        record: StopRecord | None = None,
        tell_kept: Callable[[str], None] = lambda _why_not: None,
    ) -> None:
        """Take control socket and record; `run` or `step` starts the processes.

        Parameters
        ----------
        bridge, speech : the child processes.
        control : the face's control socket, served here while no bridge serves it.
        notice : to systemd.
        record : keeps stops beyond this process, and may hold one from before it.
        tell_kept : informs the process that answers clients; called, whenever that changes, with
            why a stop cannot be kept, empty: it is kept.

        """
        self._bridge, self._speech = RestartedChild(bridge), RestartedChild(speech)
        self._control = control
        self._servos = servos
        self._servo_names = tuple(servos.can)
        self._notice = notice
        self._record = StopRecord() if record is None else record
        self._tell_kept, self._known_problem = tell_kept, ""
        self._phase = Phase.WAITING
        self._request: StopRequest | None = self._record.stopped
        self._n_ready = 0
        self._bridge_status = 0  # of the bridge that ended last
        self._release: FaceRelease | None = None
        self._release_s = 0.0
        self._release_again_s = float("inf")
        self._port_error = self._start_error = ""
        self._now_s = 0.0
        self._signal_s = float("inf")
        self._n_signals = 0
        self._failed: dict[int, str] = {}
        self._switched_off: set[int] = set()
        self._zero_s: float | None = None
        self._well_s = float("-inf")
        self._stop_report: StopReport | None = None  # of a stop that is over
        self._end_report = StopReport()  # of torque off, whatever it was for
        self._at_s = 0.0  # when the servos said so, seconds since 1970
        control.attend(self._refusal)
        self.report: StopReport | None = None
        #: With what the process should end; once there is a report.
        self.exit_status = int(ExitStatus.ENDED_WELL)

    def run(self, signals: SignalCounter) -> StopReport:
        """Run until the face has ended for good; end all children, and return the stop report.

        A stop that only makes the face wait, limp, for a start does not end it; `signals` do.
        """
        try:
            while (report := self.step(time.monotonic(), signals.count, signals.last)) is None:
                now_s = time.monotonic()
                wait_s = min(max(0.0, self.due_s(now_s) - now_s), _LONGEST_WAIT_S)
                select.select([signals.fileno(), *self._filenos()], [], [], wait_s)
                signals.forget_wake_up()
        finally:
            self._speech.child.end(_CHILD_END_S)
            self._bridge.child.end(_END_S)
        self._control.report_end({"exit_status": self.exit_status, **report.as_dict()})
        return report

    def step(self, now_s: float, n_signals: int = 0, signal_name: str = "") -> StopReport | None:
        """Do all that is due at monotonic `now_s`; return the report, None: the face has not ended.

        n_signals: how many signals to end the program have come so far. signal_name: name of the
        last one.
        """
        self._now_s = now_s
        bridge_status, speech_status = self._bridge.child.ended(), self._speech.child.ended()
        self._read_messages()
        self._handle_signals(n_signals, signal_name, now_s)
        self._serve_control()
        self._watch_speech(speech_status, now_s)
        self._watch_bridge(bridge_status, now_s)
        self._tell_service(now_s)
        if self._record.problem != self._known_problem:
            self._known_problem = self._record.problem
            self._tell_kept(self._known_problem)
        return self.report

    def due_s(self, now_s: float) -> float:
        """Return the next time at which `step` must run even without a message."""
        due = []
        if not (self._holds(Requested.END) and self._speech.child.pid is None):
            due.append(self._speech.next_s(now_s))
        if self._release is not None:
            due.append(self._release.next_s)
        elif self._phase is Phase.STOPPED:
            due.append(self._release_again_s)
        else:
            due.append(self._bridge.next_s(now_s))
        return min(due)

    def status(self) -> dict[str, object]:
        """Return the answer to a status request while no bridge can give one: plain values."""
        stop, report = self._request, self._stop_report
        return {
            "state": Phase.STOPPED.value if report is not None else self._phase.value,
            "stopped": None if stop is None else stop.level.value,
            "stopped_by": None if stop is None else stop.requested_by,
            "stop_report": None if report is None else {**report.as_dict(), "at_s": self._at_s},
            "can_start": self._holds(Requested.KEPT),
            "torque_on": False if report and report.complete and not report.released else None,
            "troubles": [each for each in (self._port_error, self._start_error) if each],
        }

    def _of_stop(self) -> dict[str, object]:
        """Return the part of the answer to a stop that says which servos are limp, for JSON.

        `not_kept`: why the stop is not kept for a restart; missing: it is.
        """
        limp = [] if self._stop_report is None else list(self._stop_report.confirmed)
        unknown = [name for name in self._servo_names if name not in limp]
        return {"holds": [], "limp": limp, "unknown": unknown, **self._kept()}

    def _kept(self) -> dict[str, object]:
        not_kept = self._record.problem_after(_RECORD_S)
        return {"not_kept": not_kept} if not_kept else {}

    def _fire(self, event: SupervisorEvent) -> bool:
        """Set the phase by the row of `SUPERVISOR_TABLE` for `event`, and carry out its actions.

        Return False, having done nothing, if the present phase has no such row.
        """
        row = SUPERVISOR_TABLE.find(self._phase, event, self._holds)
        if row is None:
            return False
        self._phase = row.then or self._phase
        for action in row.do:
            self._do(action)
        return True

    def _holds(self, requested: Requested) -> bool:
        """Return whether the condition `requested` of a row of `SUPERVISOR_TABLE` holds now."""
        request = self._request
        match requested:
            case Requested.END:
                return request is not None and request.ends
            case Requested.STOP:
                return request is not None and request.level in _LIMP_LEVELS
            case Requested.FREEZE:
                return request is not None and request.level is StopLevel.FREEZE
            case Requested.FIRST:
                return self._n_ready == 0
            case Requested.KEPT:
                return self._stop_report is not None and not self._holds(Requested.END)

    def _do(self, action: SupervisorAction) -> None:
        """Carry out one action of `SUPERVISOR_TABLE`."""
        match action:
            case SupervisorAction.START_BRIDGE:
                self._start_bridge()
            case SupervisorAction.START_ANEW:
                self._request = self._stop_report = None
                self._port_error = self._start_error = ""
                self._failed.clear()
                self._record.stop(None)
                self._start_bridge()
            case SupervisorAction.KILL_BRIDGE:
                self._bridge.child.send(signal.SIGKILL)
            case SupervisorAction.LET_GO:
                timeout_s = _SERVO_TIMEOUT_S if self._holds(Requested.STOP) else 0.0
                self._release = self._servos.make_release(timeout_s)
                self._release_s = self._now_s
            case SupervisorAction.DROP_RELEASE:
                self._drop_release()
            case SupervisorAction.STOP_SINCE_FAILED:
                status = self._bridge_status
                self._start_error = self._start_error or f"could not be started (status {status})"
                self._request = StopRequest(StopLevel.LIMP, "a start that failed")
                self._record.stop(self._request)
            case SupervisorAction.TELL_READY:
                self._n_ready += 1
                self._start_error = ""
                self._notice.ready()
            case SupervisorAction.TELL_STOPPED:
                self._tell_stopped()
            case SupervisorAction.TELL_END:
                self._drop_release()
                self.report = self._end_report

    def _filenos(self) -> list[int]:
        control = [] if self._bridge.serves else self._control.filenos()
        return [*self._bridge.child.filenos(), *self._speech.child.filenos(), *control]

    def _read_messages(self) -> None:
        """Store or act on what bridge and speech have reported since the last step."""
        for message in self._bridge.child.read():
            match message:
                case Stopped(level, ends, requested_by):
                    self._hold_stop(StopRequest(level, requested_by, ends), is_in_force=True)
                case Started():
                    self._request = self._stop_report = None
                    self._failed.clear()
                    self._record.stop(None)
                case NotStarted(reason) if self._phase is Phase.RETURNING:
                    self._start_error = f"could not be started: {reason}"
                case Failed(index, reason):
                    self._failed[index] = reason
                case Switched(index, on):
                    self._hold_switched(index, on=on)
                case Ready():
                    self._fire(SupervisorEvent.READY)
        for message in self._speech.child.read():
            if isinstance(message, Began):
                self._zero_s = message.zero_s

    def _hold_stop(self, request: StopRequest, *, is_in_force: bool = False) -> None:
        """Store a person's stop, so that it outlives every process of the face.

        Soft replaces a freeze, limp any stop; a lesser stop changes nothing but whether the process
        ends. If it is to end, speech is ended now. is_in_force: the bridge obeys it already; a
        freeze then holds also a face that was on its way to its end.
        """
        ends = request.ends or self._holds(Requested.END)
        freezes = is_in_force and request.level is StopLevel.FREEZE
        if freezes:
            self._signal_s = float("inf")  # it ends by the next stop or signal
        if freezes or not self._holds(Requested.STOP) or request.level is StopLevel.LIMP:
            self._request = replace(request, ends=ends)
            self._record.stop(request)
        elif self._request is not None:
            self._request = replace(self._request, ends=ends)
        if ends:
            self._speech.child.send(signal.SIGTERM)

    def _hold_switched(self, index: int, *, on: bool) -> None:
        """Remember that servo `index` is switched off, for later bridges; `on`: forget that."""
        if on:
            self._switched_off.discard(index)
            self._failed.pop(index, None)
        else:
            self._switched_off.add(index)

    def _handle_signals(self, n_signals: int, name: str, now_s: float) -> None:
        """Obey a new signal: a soft stop at the first, limp at the second; then the process ends.

        n_signals: how many have come so far, name: of the last one. From the third on no lost port
        is waited for.
        """
        if n_signals == self._n_signals:
            return
        self._n_signals = n_signals
        self._signal_s = min(self._signal_s, now_s)
        level = StopLevel.SOFT if n_signals == 1 else StopLevel.LIMP
        _LOG.info("stop requested: %s, by %s", level.value, name)
        if level is StopLevel.SOFT and self._request is not None and self._holds(Requested.STOP):
            self._request = replace(self._request, ends=True)
        else:
            # A service manager's end is no person's stop: nothing of it outlives this process.
            self._request = StopRequest(level, name, ends=True)
        self._speech.child.send(signal.SIGTERM)
        self._bridge.child.send(signal.SIGTERM)
        self._fire(SupervisorEvent.SIGNAL)

    def _serve_control(self) -> None:
        """Answer clients, and carry out their stops and orders, while no bridge does so."""
        if self._bridge.serves:
            self._control.send_away()  # a client connected here would never get an answer
            return
        for _ in range(_REQUESTS_AT_ONCE):
            request = self._control.poll()
            if request is not None:
                self._obey_stop(request)
            self._control.answer(self.status, self._of_stop)
            for order in self._control.take_orders():
                if isinstance(order, StartFace):
                    self._obey_start(order, is_stopped_now=request is not None)
                elif isinstance(order, ServoOrder):
                    index = self._servo_names.index(order.name)
                    self._hold_switched(index, on=order.switch is ServoSwitch.ON)
            if request is None:
                return

    def _obey_stop(self, request: StopRequest) -> None:
        """Keep a client's stop for later bridges, and act on it; a second freeze does nothing."""
        was_frozen = self._holds(Requested.FREEZE)
        self._hold_stop(request)
        if request.level is not StopLevel.FREEZE:
            self._fire(SupervisorEvent.STOP)
        elif not was_frozen:  # a bridge that starts frozen is left to start
            self._fire(SupervisorEvent.FREEZE)
        by = request.requested_by
        _LOG.info("stop requested: %s, by %s; no bridge runs", request.level.value, by)

    def _refusal(self, order: Order) -> str:
        """Return in a line why an order is refused while no bridge runs; empty: accepted."""
        match order:
            case StartFace() if self._holds(Requested.KEPT):
                return ""
            case StartFace() if self._holds(Requested.STOP):
                return START_WHILE_STOPPING
            case StartFace() if self._holds(Requested.FREEZE):
                return "the bridge of the frozen face is being replaced: start it in a moment"
            case StartFace():
                return "the face is being started already"
            case ServoOrder(name, ServoSwitch.OFF | ServoSwitch.ON) if name in self._servo_names:
                # The next bridge is told; one that starts has been told already.
                starts = self._bridge.child.pid is not None
                return "the bridge is being started: ask again in a moment" if starts else ""
        return f"{self._phase.value}: ask again once the face is driven"

    def _obey_start(self, order: StartFace, *, is_stopped_now: bool) -> None:
        """Start the face's bridge as `order` demands, and log it.

        is_stopped_now: whether a stop came in the same round, which voids the start. A start of a
        face that is not stopped does nothing.
        """
        is_obeyed = not is_stopped_now and self._fire(SupervisorEvent.START)
        why_not = "a stop came with it" if is_stopped_now else self._refusal(order)
        then = "" if is_obeyed else f": not obeyed, {why_not}"
        _LOG.info("start requested by %s%s", order.requested_by, then)

    def _watch_speech(self, ended: int | None, now_s: float) -> None:
        """Note the end of the speech process, kill it if it hangs, or start it when due.

        Once the face's processes are to end it is not started again. ended: its exit status if it
        has just ended; None otherwise.
        """
        speech = self._speech
        if ended is not None:
            if not self._holds(Requested.END):
                speech.note_end(ended, now_s)
        elif speech.child.pid is not None:
            speech.kill_if_hung(now_s)
        elif not self._holds(Requested.END) and now_s >= speech.due_s:
            zero = [] if self._zero_s is None else ["--zero-s", repr(self._zero_s)]
            speech.start(zero, now_s)

    def _watch_bridge(self, ended: int | None, now_s: float) -> None:
        """Do what is due about the bridge: note its end, start or kill it, or switch torque off.

        Torque is switched off from here, at the ports, only while no bridge runs. ended: the exit
        status of a bridge that has just ended; None otherwise. now_s: monotonic.
        """
        if ended is not None:
            self._bridge_ended(ended, now_s)
        elif self._release is not None:
            self._release_on(self._release, now_s)
        elif self._bridge.child.pid is not None:
            self._bridge.kill_if_hung(now_s)
            if now_s > self._signal_s + _END_S:
                self._bridge.kill(f"has not ended within {_END_S:g} s")
        elif self._phase is Phase.STOPPED:
            if now_s >= self._release_again_s:
                self._fire(SupervisorEvent.AGAIN)
        elif self._holds(Requested.STOP) or now_s >= self._bridge.due_s:
            self._fire(SupervisorEvent.DUE)

    def _start_bridge(self) -> None:
        """Start the bridge; its arguments are the stop and the servos that must stay limp."""
        arguments = []
        if self._request is not None:
            arguments += ["--stopped", self._request.level.value]
            arguments += ["--stopped-by", self._request.requested_by]
        for index, reason in self._failed.items():
            arguments += ["--failed", f"{index}={reason}"]
        for index in sorted(self._switched_off):
            arguments += ["--switched-off", str(index)]
        self._bridge.start(arguments, self._now_s)

    def _bridge_ended(self, status: int, now_s: float) -> None:
        """Store the exit status of a bridge that has ended, and fire the event that it means.

        status: negative if a signal killed it.
        """
        self._bridge_status = status
        if status == ExitStatus.ENDED_WELL:
            self._conclude(let_go_report(self._servos.can, {}), status)
            self._fire(SupervisorEvent.ENDED_WELL)
            return
        self._bridge.note_end(status, now_s)
        if status in _HOPELESS:
            self._fire(SupervisorEvent.HOPELESS)
        else:
            self._fire(SupervisorEvent.DIED if status < 0 else SupervisorEvent.FAILED)

    def _drop_release(self) -> None:
        if self._release is not None:
            self._release.close()
            self._release = None

    def _release_on(self, release: FaceRelease, now_s: float) -> None:
        """Run a step of switching torque off at the ports, and fire an event when that is over.

        RELEASED: every servo confirmed or was polled for long enough. PORT_STUCK: a lost port did
        not come back in time. The report and the exit status for either are stored first.
        """
        if now_s >= release.next_s and release.step():
            self._port_error = ""
            report = self._report_of(release)
            _LOG.log(report.log_level, "%s", report.line())
            unconfirmed = ExitStatus.UNCONFIRMED if report.unconfirmed else ExitStatus.ENDED_WELL
            # After a stop the exit status says what servos confirmed, else how the bridge ended.
            is_own = self._holds(Requested.STOP) or self._bridge_status == ExitStatus.UNCONFIRMED
            self._conclude(report, unconfirmed if is_own else self._bridge_status)
            self._fire(SupervisorEvent.RELEASED)
        elif release.port_error:
            if release.port_error != self._port_error:
                self._port_error = release.port_error
                _LOG.warning("torque cannot be switched off yet: %s", self._port_error)
            if now_s >= self._give_up_s():
                failed = max(self._bridge_status, 1)
                status = ExitStatus.UNCONFIRMED if self._holds(Requested.STOP) else failed
                self._conclude(self._report_of(release), status)
                self._fire(SupervisorEvent.PORT_STUCK)

    def _give_up_s(self) -> float:
        """Return the monotonic time until which a lost port is waited for; infinity: for ever.

        2 s if the first bridge ended before it served, 30 s if it served but was never ready, so
        that some servos may hold; 30 s after a signal (none after the third), or for a bridge that
        gave up; no limit for a face that recovers or was stopped by its control socket.
        """
        if self._n_signals > 2:
            return self._signal_s
        if self._n_ready == 0:
            may_hold = self._bridge.child.has_beaten
            return self._release_s + (PORT_WAIT_S if may_hold else _START_TIMEOUT_S)
        if not self._holds(Requested.STOP):
            is_over = self._phase is Phase.GIVING_UP
            return self._release_s + PORT_WAIT_S if is_over else float("inf")
        # Without a signal `_signal_s` is infinite: whoever stopped the face through its socket can
        # query it there, and signal.
        return self._signal_s + PORT_WAIT_S

    def _report_of(self, release: FaceRelease) -> StopReport:
        let_go = {name: self._servos.can[name] for name in release.let_go}
        confirms = any(each.confirmed_limp for each in self._servos.can.values())
        return let_go_report(let_go, release.unconfirmed, confirms=confirms)

    def _conclude(self, report: StopReport, status: int) -> None:
        """Store the report of torque off, and the exit status that the process would have now."""
        self._end_report, self._at_s = report, round(time.time(), 3)
        self.exit_status = int(status)

    def _tell_stopped(self) -> None:
        """Report the end of a stop to waiting clients; the face waits, limp, for a start."""
        self._drop_release()
        report = self._stop_report = self._end_report
        self._bridge_status = 0
        self.exit_status = ExitStatus.ENDED_WELL if report.complete else ExitStatus.UNCONFIRMED
        self._release_again_s = float("inf") if report.complete else self._now_s + _RELEASE_AGAIN_S
        self._control.report_end({"waits": True, **report.as_dict(), **self._kept()})
        waits = "the face waits: `lipservo start` starts it again"
        _LOG.log(report.log_level, "%s; %s", report.text(), waits)
        self._notice.ready()  # to systemd a face that starts stopped is up, too

    def _tell_service(self, now_s: float) -> None:
        """Tell systemd that the face is looked after: it is driven, stopped, or recovering.

        A recovery counts for 60 s, but without limit while it waits for a lost port.
        """
        if self._bridge.serves or self._port_error or self._phase is Phase.STOPPED:
            self._well_s = now_s
        if now_s - self._well_s < _RECOVERY_S:
            self._notice.alive()
