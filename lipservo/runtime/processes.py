"""A face in three processes: one drives the servos, one recognises and speaks, one supervises."""

import logging
import os
import socket
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from firmware_bridge.errors import BusError
from firmware_bridge.loop.report import TickReport
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.lifeline import Began, Lifeline, NotStarted, Ready
from firmware_bridge.process.logs import face_logs
from firmware_bridge.stop_signals import SignalCounter
from firmware_bridge.stopping import ExitStatus, StopRequest
from lipservo.runtime.requested_face import RequestedFace
from lipservo.runtime.run_request import RunRequest, request_json
from lipservo.runtime.servos.driven_face import (
    DrivenFace,
    DriveOptions,
    Supervised,
    driven_face,
    guarded,
)
from lipservo.runtime.status.face_status import Status, whole_status
from lipservo.runtime.status.live_board import LiveBoard, ServoBoard
from lipservo.runtime.status.status_board import StatusBoard
from lipservo.terminal.output import print_json
from lipsync.errors import UserError
from lipsync.output_file import check_output

if TYPE_CHECKING:
    from firmware_bridge.process.supervisor import Supervisor

_LOG: Final = logging.getLogger(__name__)
#: The speech process writes its status so often.
_STATUS_EVERY_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class Handed:
    """The descriptors and the lifeline that a child process inherits from the supervisor.

    channel: descriptor of the socket that carries servo targets. board: of the shared memory of the
    `StatusBoard`. live: of the `LiveBoard`, which watching programs may read. lifeline: the
    socket by which the child reports that it works, and notices that the supervisor has died.
    """

    channel: int
    board: int
    live: int
    lifeline: Lifeline


def run_bridge_process(
    request: RunRequest,
    inherited: Handed,
    control: int,
    *,
    stopped: StopRequest | None,
    given_up: Mapping[int, str],
    switched_off: list[int],
) -> int:
    """Drive the servos at the port by targets from a socket until stopped; return the exit status.

    inherited: from the supervisor. control: descriptor of the face's control socket.
    stopped: a person's stop that was in force when the previous bridge process died. given_up:
    reasons for servos that stay limp, by servo index. switched_off: indices of servos that a person
    switched off. Raises UserError without a port, and BusError if port or servos cannot be used.
    """
    from firmware_bridge.clock import MonotonicClock
    from firmware_bridge.loop.targets import SocketTargetChannel
    from firmware_bridge.process.operating_system import run_on_time

    if request.port is None:
        raise UserError(
            "request.port is missing; give the port, where the servo process finds its servos"
        )
    try:
        face = RequestedFace(request)
    except UserError as error:
        inherited.lifeline.tell(NotStarted(" ".join(str(error).split())))
        raise
    with ExitStack() as stack:
        stack.enter_context(face_logs(face.settings.name, "bridge", quiet=request.quiet))
        targets_end = stack.enter_context(socket.socket(fileno=inherited.channel))
        notes = stack.enter_context(StatusBoard.adopt(inherited.board))
        live = stack.enter_context(LiveBoard.adopt(inherited.live))
        trace = None
        if request.trace is not None:
            from lipservo.runtime.supervised_trace import SupervisedTrace

            trace = stack.enter_context(SupervisedTrace(face, notes, live, inherited.lifeline.beat))
        if inherited.lifeline.is_cut():
            return ExitStatus.ENDED_WELL  # the supervisor died before it could be noticed
        drive_options = DriveOptions(
            rate_hz=face.rate_hz,
            control=face.control(face.commands(notes.add_settings), notes.describe, live),
            supervised=Supervised(
                inherited.lifeline, control, stopped, given_up, switched_off, notes.not_kept
            ),
        )
        channel = SocketTargetChannel(targets_end)
        driven: DrivenFace | None = None
        run_on_time()  # real-time priority, also for the threads that a bus starts
        try:
            with driven_face(face.settings, MonotonicClock(), channel, drive_options) as driven:
                observers = [ServoBoard(live, driven.bridge).tell]
                if trace is not None:
                    observers.append(trace.observe)
                _tick_until_stopped(driven, inherited.lifeline, observers)
        except BusError as error:
            if driven is None or not driven.bridge.failure:
                inherited.lifeline.tell(NotStarted(" ".join(str(error).split())))
                raise
            _LOG.warning("%s", error)
            return ExitStatus.CRITICAL_SERVO_FAILED
    assert driven.life.report is not None
    return ExitStatus.ENDED_WELL if driven.life.report.complete else ExitStatus.UNCONFIRMED


def _tick_until_stopped(
    driven: DrivenFace, lifeline: Lifeline, observers: Sequence[Callable[[TickReport], None]]
) -> None:
    """Switch torque on and tick until stopped; report `ready` once the servos have started.

    A servo has started when it is driven, or its fault is reported. observers: get each tick's
    report.
    """
    driven.life.start()
    began = False
    for time_s, late in driven.life.ticks():
        report = driven.bridge.tick(time_s, late)
        for observe in observers:
            observe(report)
        if not began and driven.bridge.settled:
            began = True
            lifeline.tell(Ready())


def run_speech_process(
    request: RunRequest, inherited: Handed, agents: int | None, zero_s: float | None
) -> None:
    """Recognise the request's sound and send servo targets through a socket until a signal arrives.

    It also ends when the supervisor dies. inherited: from it. agents: descriptor of the
    socket to which voice agents connect; None: no agents are served. zero_s: monotonic time at
    which the sound first began, None for a first start; a sound file is continued at the position
    that it has reached by now.
    """
    from firmware_bridge.clock import MonotonicClock, ticks
    from firmware_bridge.loop.targets import SocketTargetChannel
    from lipservo.runtime.avatar_stream import entered_avatars
    from lipservo.runtime.face_speech import FaceSpeech
    from lipservo.runtime.sound import entered_sound
    from lipservo.runtime.speech.speech import PUBLISH_PERIOD_S
    from lipservo.runtime.voice_agents import voice_agents

    requested = RequestedFace(request)
    with ExitStack() as stack:
        signals = stack.enter_context(SignalCounter())
        stack.enter_context(face_logs(requested.settings.name, "speech", quiet=request.quiet))
        targets_end = stack.enter_context(socket.socket(fileno=inherited.channel))
        notes = stack.enter_context(StatusBoard.adopt(inherited.board))
        live = stack.enter_context(LiveBoard.adopt(inherited.live))
        clock = MonotonicClock()
        is_file = request.sound.kind == "file"
        start_s = 0.0 if zero_s is None or not is_file else max(0.0, clock.now() - zero_s)
        source = stack.enter_context(entered_sound(request, start_s))
        channel = SocketTargetChannel(targets_end)
        speech = FaceSpeech(requested, source, channel, board=live, timer_s=time.perf_counter)
        side = speech.side
        avatars = entered_avatars(request.avatars, request.model, stack)
        # A file that the face only listens to continues on the old timeline; the face's own speech
        # begins a new timeline in each process.
        if zero_s is None or not start_s:
            zero_s = side.start(clock.now())
        else:
            _LOG.info("%s goes on at %.1f s", source.name, start_s)
            side.begin(zero_s if request.voice is None else clock.now())
        inherited.lifeline.tell(Began(zero_s))
        listener = None if agents is None else socket.socket(fileno=agents)
        url = stack.enter_context(voice_agents(listener, side, requested))
        n_servo_ticks = 0
        settings: dict[str, float] = {}
        status_due_s = float("-inf")
        for time_s, _ in ticks(clock, 1.0 / PUBLISH_PERIOD_S):
            inherited.lifeline.beat()
            if signals.count or inherited.lifeline.closed:
                return
            is_stopped, requested_settings = notes.is_stopped(), notes.settings()
            # At rest `hold` publishes the last goals; nothing else needs to be done in this tick.
            has_news = is_stopped or requested_settings != settings or avatars is not None
            if not side.hold(time_s, has_news=has_news):
                side.follow_stop(time_s, is_stopped=is_stopped)
                if requested_settings != settings:
                    side.change(requested_settings)
                    settings, status_due_s = requested_settings, time_s
                for number, servos in live.servos_since(n_servo_ticks):
                    side.note_servos(float(servos["time_s"]), servos["encoder_deg"])
                    n_servo_ticks = number
                side.advance(time_s)
            if avatars is not None:
                sound_s, _, frame = side.shown(time_s)
                avatars.show(time_s, sound_s, frame)
            if time_s >= status_due_s:
                status_due_s = time_s + _STATUS_EVERY_S
                notes.write_speech(speech.status(settings, url))


def supervise(request: RunRequest, agents: socket.socket | None = None) -> int:
    """Run the bridge and speech processes of a face until it is stopped; return the exit status.

    agents: bound socket to which voice agents connect, open even while no speech process runs;
    None: no agents are served. Raises an error, before any torque is on, for settings, sound,
    avatars or servos that cannot be used.
    """
    from firmware_bridge.loop.targets import channel_pair
    from firmware_bridge.process.child import Child, HeartbeatTimeouts
    from firmware_bridge.process.operating_system import ServiceNotice
    from firmware_bridge.process.stop_record import StopRecord
    from firmware_bridge.process.supervisor import SupervisedServos, Supervisor
    from firmware_bridge.process.torque_release import FaceRelease, TorqueRelease
    from lipservo.health.health_log import stop_record_path
    from lipservo.runtime.servos.assembly import check_servos
    from lipservo.runtime.sound import check_sound
    from lipservo.traces.trace_file import is_trace
    from lipsync.recognition.recognizers import recognizer_kind

    if request.trace is not None:
        check_output(request.trace, replaces=is_trace, kind="trace")
    requested = RequestedFace(request)
    face, settings = requested.face, requested.settings
    port = settings.servo_port
    assert port is not None
    check_sound(request)
    recognizer_kind(request.motion.engine)
    request = requested.with_resolved_avatars()
    port_releases = [
        (
            one.bus_kind.port_release(at, one.wiring),
            {joint.servo_id: joint.name for joint in one.joints()},
        )
        for one in settings.alone.values()
        if (at := one.servo_port) is not None
    ]
    for opener, _ in port_releases:
        opener().close()  # raises for a port that another face holds
    check_servos(face)
    about, can = requested.about, settings.capabilities

    def release(timeout_s: float) -> FaceRelease:
        """Return a release, to be stepped, that switches torque off at all ports of the face."""
        releases = [
            (TorqueRelease(opener, list(names), timeout_s=timeout_s), names)
            for opener, names in port_releases
        ]
        return FaceRelease(releases)

    with ExitStack() as stack:
        signals = stack.enter_context(SignalCounter())
        stack.enter_context(face_logs(settings.name, "supervisor", quiet=request.quiet))
        _LOG.info("%s", request.motion)
        for line in can.warnings():
            _LOG.warning("%s", line)
        board = stack.enter_context(StatusBoard.create())
        live = stack.enter_context(requested.live_board())
        path, commands = requested.control_path, requested.commands(board.add_settings)
        listener = ControlSocket(path, about, commands, board.describe_stopped, live.fileno())
        stack.enter_context(listener)
        record = StopRecord(
            stop_record_path(settings.name, port, os.environ),
            started_by_person=sys.stdin is not None and sys.stdin.isatty(),
            drives_after_power_cut=settings.start_after_power_cut,
            on_change=lambda stop: board.write_stopped(is_stopped=stop is not None),
        )
        stack.callback(record.close)
        board.write_stopped(is_stopped=record.stopped is not None)
        if record.stopped is not None:
            _LOG.warning("not driven until `lipservo start`: %s", record.why)
        # The processes' command lines; each `{...}` becomes the number of an inherited descriptor.
        writer, reader = channel_pair()
        command = [sys.executable, "-P", "-m", "lipservo"]
        request_text = request_json(
            replace(request, control=listener.path, servos=requested.servos)
        )
        arguments = ["--request", request_text, "--lifeline", "{lifeline}"]
        arguments += ["--board", "{board}", "--live", "{live}", "--channel", "{channel}"]
        bridge = [*command, "bridge-process", *arguments, "--control", "{control}"]
        of_bridge = {"{control}": listener.fileno(), "{channel}": reader.fileno()}
        for number, alive in enumerate(stack.enter_context(guarded(settings))):
            of_bridge[f"{{guard {number}}}"] = alive  # by which a guard sees that the bridge lives
        speech = [*command, "speech-process", *arguments]
        of_speech = {"{channel}": writer.fileno()}
        if agents is not None:
            speech += ["--agents", "{agents}"]
            of_speech["{agents}"] = agents.fileno()
        # Descriptors that both processes inherit.
        ours = {"{board}": board.fileno(), "{live}": live.fileno()}
        supervisor = Supervisor(
            # Where a process gets no processor time: a bridge whose servos get no goals lets go of
            # them after 5 s, and a person can stop it at the port; speech is waited for, a minute.
            Child(
                "bridge", bridge, {**of_bridge, **ours}, HeartbeatTimeouts(30.0, 1.0, patience=5.0)
            ),
            Child(
                "speech", speech, {**of_speech, **ours}, HeartbeatTimeouts(60.0, 3.0, patience=20.0)
            ),
            listener,
            SupervisedServos(
                {name: can.of(index) for index, name in enumerate(settings.servos)}, release
            ),
            notice=ServiceNotice(),
            record=record,
            tell_kept=board.write_not_kept,
        )
        supervisor.run(signals)
        _report_end(request, supervisor, whole_status({**about, "state": "ended"}, board.speech()))
    return supervisor.exit_status


def _report_end(request: RunRequest, supervisor: "Supervisor", status: Status) -> None:
    """Print how a supervised face has ended as JSON, or log it.

    The log line is an error unless all servos confirmed torque off. status: the last one of the
    face, for the JSON.
    """
    report = supervisor.report
    assert report is not None
    if request.as_json:
        ended = {"exit_status": supervisor.exit_status, **report.as_dict()}
        print_json({**ended, "face_status": status.as_dict()})
    else:
        level = logging.INFO if report.complete else logging.ERROR
        _LOG.log(level, "ended; %s", report.line())
