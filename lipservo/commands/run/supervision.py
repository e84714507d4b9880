"""The supervisor of a face in several processes: one that owns the port, one that hears."""

import os
import sys
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.log_lines import LogLines
from firmware_bridge.stop_signals import SignalCounter
from lipservo.status.face_status import Status, whole_status
from lipservo.status.status_board import StatusBoard
from lipservo.street.run_commands import shared_commands
from lipservo.street.run_request import RunRequest, about_run, request_json
from lipservo.street.spoken_sound import check_sound
from lipservo.terminal.output import MESSAGES, print_json
from lipsync.errors import UserError

if TYPE_CHECKING:
    import socket

    from firmware_bridge.process.supervisor import Supervisor


def supervise(request: RunRequest, agents: "socket.socket | None" = None) -> int:
    """Run bridge and speech as processes until stopped; the exit status.

    agents: where voice agents connect, which outlives the process that serves them.

    What cannot be used, sound and servos included, is refused before anything is armed.
    """
    from firmware_bridge.process.child import Child, HeartbeatTimeouts
    from firmware_bridge.process.runtime_folder import socket_path
    from firmware_bridge.process.service_notice import ServiceNotice
    from firmware_bridge.process.socket_channel import channel_pair
    from firmware_bridge.process.stop_record import StopRecord
    from firmware_bridge.process.supervisor import Supervisor
    from firmware_bridge.process.torque_release import TorqueRelease
    from lipservo.face.assembly import assemble_face, at_port, check_servos
    from lipservo.face.servos import port_opener
    from lipservo.health.health_places import stop_record_path
    from lipservo.speech.face_expression import check_expression
    from lipservo.status.live_board import LiveBoard
    from lipservo.street.avatar_stream import resolved_avatars
    from lipservo.street.watched import board_layout

    if request.trace is not None:
        raise UserError(
            "--trace: a face in processes of its own writes none, since no process sees both "
            "sound and servos; `lipservo run --port PORT --trace FILE` does"
        )
    face = at_port(assemble_face(request.config, request.model), request.port)
    port = face.settings.servo_port
    assert port is not None
    check_sound(request)
    request = replace(request, avatars=resolved_avatars(request.avatars))
    check_expression(face.settings, face.folder)
    opener = port_opener(port, face.settings.bus.baud_rate)
    opener().close()  # one that another face holds is refused before anything is started
    check_servos(face)
    settings = face.settings
    servo_names = {joint.servo_id: joint.name for joint in settings.joints()}
    about = {**about_run(request), "name": settings.name, "port": port}
    with ExitStack() as stack:
        signals = stack.enter_context(SignalCounter())
        say = no_log if request.quiet else stack.enter_context(LogLines())
        say(str(request.motion))
        board = stack.enter_context(StatusBoard.create())
        rate_hz = request.rate_hz or settings.rate_hz
        live = stack.enter_context(LiveBoard.create(board_layout(face, request.config, rate_hz)))
        path = request.control or socket_path(settings.name)
        commands = shared_commands(request, settings, board)
        listener = ControlSocket.bind(path, about, commands, board.describe_stopped, live.fileno())
        stack.enter_context(listener)
        record = StopRecord(
            stop_record_path(settings.name, port, os.environ),
            started_by_person=sys.stdin is not None and sys.stdin.isatty(),
            drives_after_power_cut=settings.start_after_power_cut,
            on_change=lambda stop: board.write_stopped(is_stopped=stop is not None),
            say=say,
        )
        stack.callback(record.close)
        board.write_stopped(is_stopped=record.stopped is not None)
        if record.stopped is not None:
            say(f"starts limp, and `lipservo start` drives it: {record.why}")
        writer, reader = channel_pair()
        command = [sys.executable, "-m", "lipservo"]
        shared = ["--request", request_json(request), "--lifeline", "{lifeline}"]
        shared += ["--board", "{board}", "--live", "{live}", "--channel", "{channel}"]
        bridge = [*command, "bridge-process", *shared, "--control", "{control}"]
        bridge += ["--control-path", str(listener.path)]
        of_bridge = {"{control}": listener.fileno(), "{channel}": reader.fileno()}
        speech = [*command, "speech-process", *shared, "--control-path", str(listener.path)]
        of_speech = {"{channel}": writer.fileno()}
        if agents is not None:
            speech += ["--agents", "{agents}"]
            of_speech["{agents}"] = agents.fileno()
        ours = {"{board}": board.fileno(), "{live}": live.fileno()}
        supervisor = Supervisor(
            Child(
                "bridge", bridge, {**of_bridge, **ours}, HeartbeatTimeouts(start_s=30.0, run_s=1.0)
            ),
            Child(
                "speech",
                speech,
                {**of_speech, **ours},
                HeartbeatTimeouts(60.0, 3.0),
            ),
            listener,
            lambda timeout_s: TorqueRelease(opener, list(servo_names), timeout_s=timeout_s),
            servo_names=servo_names,
            say=say,
            notice=ServiceNotice(say),
            record=record,
        )
        supervisor.run(signals)
        _tell_end(request, supervisor, whole_status({**about, "state": "ended"}, board.speech()))
    return supervisor.exit_status


def no_log(_line: str) -> None:
    """What --quiet asks for."""


def _tell_end(request: RunRequest, supervisor: "Supervisor", status: Status) -> None:
    report = supervisor.report
    assert report is not None
    if request.as_json:
        ended = {"exit_status": supervisor.exit_status, **report.as_dict()}
        print_json({**ended, "face_status": status.as_dict()})
    elif not request.quiet or report.unconfirmed:
        MESSAGES.print(f"ended; {report.line()}", soft_wrap=True, highlight=False)
