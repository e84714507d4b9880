"""Keep the processes of one face alive, and the face safe while one of them is not.

The processes are the bridge, which drives the servos, and speech.

One loop, one thread, no sleep: it waits for whatever comes first, a heartbeat, an end, a
request, a signal, a deadline. A stop by a person is kept here, so that it outlives every process.

    RUNNING ──dead, or hung and killed──▶ RELEASING ──torque is off──▶ WAITING ──▶ RUNNING
       └──ended as requested──▶ STOPPED ◀──────┘ a person has stopped it      ▲
                                   └──a person starts it──────────────────────┘
    A signal, or a stop that ends the process: over, in place of STOPPED.
"""

import logging
import select
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
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
#: The same for a face that had not come to life: it armed nobody.
_START_TIMEOUT_S: Final = 2.0
#: Longer than any recovery takes that gets on: then systemd may try.
_RECOVERY_S: Final = 60.0
_LONGEST_WAIT_S: Final = 0.25
_REQUESTS_AT_ONCE: Final = 16
_CHILD_END_S: Final = 2.0
#: A stopped face with servos that have not confirmed is let go again this often.
_RELEASE_AGAIN_S: Final = 5.0


class _Phase(Enum):
    """The state of the bridge process; clients get its value as text while no bridge can answer."""

    RUNNING = "the bridge starts"
    RELEASING = "the bridge is down, torque is being switched off"
    WAITING = "the bridge is down and starts again"
    STOPPED = "stopped"  # limp, until a person starts the face


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
    ) -> None:
        """Take control socket and record; `run` or `step` starts the processes.

        Parameters
        ----------
        bridge, speech : the child processes.
        control : the face's control socket, served here while no bridge serves it.
        notice : to systemd.
        record : keeps stops beyond this process, and may hold one from before it.

        """
        self._bridge, self._speech = RestartedChild(bridge), RestartedChild(speech)
        self._control = control
        self._servos = servos
        self._servo_names = tuple(servos.can)
        self._notice = notice
        self._phase = _Phase.WAITING
        self._ran_well = False
        self._last_status = 0
        self._release: FaceRelease | None = None
        self._release_s = 0.0
        self._port_error = ""
        self._record = StopRecord() if record is None else record
        self._stop: StopRequest | None = self._record.stopped
        self._ends = False
        self._comes_back = False  # a person has started it again, and it is not driven yet
        self._start_error = ""
        self._now_s = 0.0
        self._signal_s: float | None = None
        self._n_signals = 0
        self._failed: dict[int, str] = {}
        self._switched_off: set[int] = set()
        self._zero_s: float | None = None
        self._well_s = float("-inf")
        self._stop_report: StopReport | None = None
        self._at_s = 0.0  # when the servos said so, seconds since 1970
        self._release_again_s = float("inf")
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
        self._serve_control(now_s)
        self._watch_speech(speech_status, now_s)
        self._watch_bridge(bridge_status, now_s)
        self._tell_service(now_s)
        return self.report

    def due_s(self, now_s: float) -> float:
        """Return the next time at which `step` must run even without a message."""
        due = [self._bridge.next_s(now_s)] if self._phase is not _Phase.RELEASING else []
        if not (self._ends and self._speech.child.pid is None):
            due.append(self._speech.next_s(now_s))
        if self._release is not None:
            due.append(self._release.next_s)
        if self._phase is _Phase.STOPPED:
            due = [*due[1:], self._release_again_s]
        return min(due, default=now_s + _LONGEST_WAIT_S)

    def status(self) -> dict[str, object]:
        """Return the answer to a status request while no bridge can give one: plain values."""
        stop, report = self._stop, self._stop_report
        return {
            "state": _Phase.STOPPED.value if report is not None else self._phase.value,
            "stopped": None if stop is None else stop.level.value,
            "stopped_by": None if stop is None else stop.requested_by,
            "stop_report": None if report is None else {**report.as_dict(), "at_s": self._at_s},
            "can_start": self._is_kept,
            "torque_on": False if report and report.complete and not report.released else None,
            "troubles": [each for each in (self._port_error, self._start_error) if each],
        }

    @property
    def _is_kept(self) -> bool:
        """Whether the face is stopped and can be started, also while torque off is sent again."""
        return self._stop_report is not None and not self._ends

    @property
    def _level(self) -> StopLevel | None:
        return None if self._stop is None else self._stop.level

    @property
    def _is_ending(self) -> bool:
        """Whether all servos are to be limp: a stop other than a freeze was requested."""
        return self._level in (StopLevel.SOFT, StopLevel.LIMP)

    def _filenos(self) -> list[int]:
        control = [] if self._bridge.serves else self._control.filenos()
        return [*self._bridge.child.filenos(), *self._speech.child.filenos(), *control]

    def _read_messages(self) -> None:
        for message in self._bridge.child.read():
            match message:
                case Stopped(level, ends, requested_by):
                    self._hold_stop(StopRequest(level, requested_by, ends))
                case Started():
                    self._stop = None
                    self._record.stop(None)
                case NotStarted(reason):
                    self._start_error = (
                        f"could not be started: {reason}" if self._comes_back else ""
                    )
                case Failed(index, reason):
                    self._failed[index] = reason
                case Switched(index, on):
                    self._hold_switched(index, on=on)
                case Ready():
                    self._ran_well = True
                    self._comes_back = False
                    self._start_error = ""
                    self._notice.ready()
                case _:
                    pass
        for message in self._speech.child.read():
            if isinstance(message, Began):
                self._zero_s = message.zero_s

    def _hold_stop(self, request: StopRequest) -> None:
        """Keep a stop whatever process dies: soft replaces freeze, and limp replaces any stop."""
        self._ends = self._ends or request.ends
        if not (self._is_ending and request.level is not StopLevel.LIMP):
            self._stop = request
            self._record.stop(request)
        if self._ends:
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
        if self._signal_s is None:
            self._signal_s = now_s
        level = StopLevel.SOFT if n_signals == 1 else StopLevel.LIMP
        _LOG.info("stop requested: %s, by %s", level.value, name)
        self._ends = True
        if not (self._is_ending and level is StopLevel.SOFT):
            # A service manager's end is no person's stop: nothing of it outlives this process.
            self._stop = StopRequest(level, name, ends=True)
        self._speech.child.send(signal.SIGTERM)
        self._bridge.child.send(signal.SIGTERM)

    def _serve_control(self, now_s: float) -> None:
        if self._bridge.serves:
            self._control.send_away()  # a client let in here would wait for ever for an answer
            return
        for _ in range(_REQUESTS_AT_ONCE):
            request = self._control.poll()
            if request is not None:
                self._obey_stop(request)
            self._control.answer(self.status)
            for order in self._control.take_orders():
                if isinstance(order, StartFace):
                    self._obey_start(order, now_s, is_stopped_now=request is not None)
                elif isinstance(order, ServoOrder):
                    self._switched_off.add(self._index_of(order.name))
            if request is None:
                return

    def _obey_stop(self, request: StopRequest) -> None:
        self._hold_stop(request)
        if self._phase is _Phase.STOPPED:
            self._stopped_again()
        else:
            self._bridge.child.send(signal.SIGKILL)  # one that starts does not know of the stop
            if self._level is StopLevel.FREEZE and self._phase is _Phase.RELEASING:
                self._drop_release()
        by = request.requested_by
        _LOG.info("stop requested: %s, by %s; no bridge runs", request.level.value, by)

    def _stopped_again(self) -> None:
        """Obey a stop or signal while the face is limp: end the face, or repeat torque off."""
        report = self._stop_report
        assert report is not None
        if self._ends:
            self._finish(
                report, ExitStatus.ENDED_WELL if report.complete else ExitStatus.UNCONFIRMED
            )
        else:
            self._release_again_s = 0.0

    def _refusal(self, order: Order) -> str:
        """Return in a line why an order is refused while no bridge runs; empty: accepted."""
        match order:
            case StartFace() if self._is_kept:
                return ""
            case StartFace() if self._is_ending:
                return START_WHILE_STOPPING
            case StartFace() if self._level is StopLevel.FREEZE:
                return "the bridge of the frozen face is being replaced: start it in a moment"
            case StartFace():
                return "the face is being started already"
            case ServoOrder(name, ServoSwitch.OFF) if name in self._servo_names:
                return ""  # of a stopped face: it stays off when that is started again
        return f"{self._phase.value}: ask again once the face is driven"

    def _obey_start(self, order: StartFace, now_s: float, *, is_stopped_now: bool) -> None:
        """Start the face's bridge as the order demands, unless the face was stopped in this round.

        is_stopped_now: whether it was. A start of a face that is not stopped is ignored, too.
        """
        if is_stopped_now or not self._is_kept:
            why_not = "not obeyed, a stop came with it"
            _LOG.info("start requested by %s: %s", order.requested_by, why_not)
            return
        _LOG.info("start requested by %s", order.requested_by)
        self._stop, self._stop_report, self._start_error = None, None, ""
        self._comes_back = True
        self._failed.clear()
        self._record.stop(None)
        self._drop_release()
        self._start_bridge(now_s)

    def _index_of(self, name: str) -> int:
        return self._servo_names.index(name)

    def _watch_speech(self, ended: int | None, now_s: float) -> None:
        speech = self._speech
        if ended is not None:
            if not self._ends:
                speech.note_end(ended, now_s)
        elif speech.child.pid is not None:
            speech.kill_if_hung(now_s)
        elif not self._ends and now_s >= speech.due_s:
            zero = [] if self._zero_s is None else ["--zero-s", repr(self._zero_s)]
            speech.start(zero, now_s)

    def _watch_bridge(self, ended: int | None, now_s: float) -> None:
        if ended is not None:
            self._bridge_ended(ended, now_s)
        elif self._phase is _Phase.RUNNING:
            self._bridge.kill_if_hung(now_s)
            if self._signal_s is not None and now_s > self._signal_s + _END_S:
                self._bridge.kill(f"has not ended within {_END_S:g} s")
        elif self._phase is _Phase.RELEASING:
            self._release_on(now_s)
        elif self._phase is _Phase.STOPPED:
            self._watch_stopped(now_s)
        elif self._is_ending:
            self._begin_release(now_s)
        elif now_s >= self._bridge.due_s:
            self._start_bridge(now_s)

    def _watch_stopped(self, now_s: float) -> None:
        """End a stopped face at a signal, or repeat torque off for servos that did not confirm."""
        if self._ends:
            self._stopped_again()
        elif now_s >= self._release_again_s:
            self._begin_release(now_s)

    def _start_bridge(self, now_s: float) -> None:
        arguments = []
        if self._stop is not None:
            arguments += ["--stopped", self._stop.level.value]
            arguments += ["--stopped-by", self._stop.requested_by]
        for index, reason in self._failed.items():
            arguments += ["--failed", f"{index}={reason}"]
        for index in sorted(self._switched_off):
            arguments += ["--switched-off", str(index)]
        self._bridge.start(arguments, now_s)
        self._phase = _Phase.RUNNING

    def _bridge_ended(self, status: int, now_s: float) -> None:
        self._last_status = status
        if status == ExitStatus.ENDED_WELL:
            self._comes_back = False
            self._conclude(let_go_report(self._servos.can, {}), status)
            return
        self._bridge.note_end(status, now_s)
        if self._comes_back and status > 0 and not self._is_ending:
            self._comes_back = False
            self._start_error = self._start_error or f"could not be started (status {status})"
            self._stop = StopRequest(StopLevel.LIMP, "a start that failed")
        if self._level is StopLevel.FREEZE and status != ExitStatus.CRITICAL_SERVO_FAILED:
            self._phase = _Phase.WAITING  # what is held stays held
        else:
            self._begin_release(now_s)

    def _may_restart(self) -> bool:
        """Return whether the bridge may be restarted after its last exit status.

        A bridge that failed at its first start has reported why, and stays down.
        """
        failed_at_start = not self._ran_well and self._last_status > 0
        hopeless = (ExitStatus.CRITICAL_SERVO_FAILED, ExitStatus.UNCONFIRMED)
        return self._last_status not in hopeless and not failed_at_start

    def _begin_release(self, now_s: float) -> None:
        self._phase = _Phase.RELEASING
        self._release = self._servos.make_release(_SERVO_TIMEOUT_S if self._is_ending else 0.0)
        self._release_s = now_s

    def _drop_release(self) -> None:
        if self._release is not None:
            self._release.close()
            self._release = None
        self._phase = _Phase.WAITING

    def _release_on(self, now_s: float) -> None:
        """Run a step of switching torque off by force; then restart the bridge or end the face."""
        assert self._release is not None
        if now_s >= self._release.next_s and self._release.step():
            self._released(self._release)
        elif self._release.port_error:
            if self._release.port_error != self._port_error:
                self._port_error = self._release.port_error
                _LOG.warning("torque cannot be switched off yet: %s", self._port_error)
            if now_s >= self._give_up_s():
                failed = max(self._last_status, 1)
                status = ExitStatus.UNCONFIRMED if self._is_ending else failed
                self._conclude(self._report_of(self._release), status)

    def _give_up_s(self) -> float:
        """Return the monotonic time until which a lost port is waited for; infinity: for ever."""
        if not self._ran_well:
            return self._release_s + _START_TIMEOUT_S
        if not self._is_ending:
            return float("inf") if self._may_restart() else self._release_s + PORT_WAIT_S
        if self._signal_s is None:
            return float("inf")  # who stopped it by the socket can ask how it is, and signal
        return self._signal_s + (PORT_WAIT_S if self._n_signals <= 2 else 0.0)

    def _released(self, release: FaceRelease) -> None:
        self._port_error = ""
        self._drop_release()
        report = self._report_of(release)
        status: int = ExitStatus.UNCONFIRMED if report.unconfirmed else ExitStatus.ENDED_WELL
        if not self._is_ending and self._last_status != ExitStatus.UNCONFIRMED:
            status = self._last_status
        _LOG.log(report.log_level, "%s", report.line())
        if self._is_ending or not self._may_restart():
            self._conclude(report, status)

    def _report_of(self, release: FaceRelease) -> StopReport:
        let_go = {name: self._servos.can[name] for name in release.let_go}
        confirms = any(each.confirmed_limp for each in self._servos.can.values())
        return let_go_report(let_go, release.unconfirmed, confirms=confirms)

    def _conclude(self, report: StopReport, status: int) -> None:
        """Handle the end of switching torque off, with `report`, and `status` to exit with.

        After a person's stop the face waits for a start; otherwise, or if the stop ends the
        process, the face ends.
        """
        if self._ends or not self._is_ending:
            self._finish(report, status)
            return
        self._drop_release()
        self._phase = _Phase.STOPPED
        self._stop_report, self._at_s = report, round(time.time(), 3)
        self._last_status = 0
        self._release_again_s = float("inf") if report.complete else self._now_s + _RELEASE_AGAIN_S
        self._control.report_end({"waits": True, **report.as_dict()})
        waits = "the face waits: `lipservo start` starts it again"
        _LOG.log(report.log_level, "%s; %s", report.text(), waits)
        self._notice.ready()  # a service that came up stopped is up

    def _finish(self, report: StopReport, status: int) -> None:
        self._drop_release()
        self.report, self.exit_status = report, int(status)

    def _tell_service(self, now_s: float) -> None:
        """Notify systemd's watchdog while the face is driven, stopped, or recovering.

        A recovery counts for 60 s, but without limit while it waits for a lost port.
        """
        if self._bridge.serves or self._port_error or self._phase is _Phase.STOPPED:
            self._well_s = now_s
        if now_s - self._well_s < _RECOVERY_S:
            self._notice.alive()
