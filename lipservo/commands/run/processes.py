"""`bridge-process` and `speech-process`: what `daemon` starts, each with the whole request."""

import os
import signal
import socket
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.lifeline import inherited_lifeline
from firmware_bridge.process.log_lines import LogLines
from firmware_bridge.process.scheduling import die_with_parent, write_from_background
from firmware_bridge.stop_signals import SignalCounter
from firmware_bridge.stopping import StopLevel, StopRequest
from lipservo.commands.run.supervision import no_log
from lipservo.status.status_board import StatusBoard
from lipservo.street.run_commands import shared_commands
from lipservo.street.run_request import about_run, request_of_json
from lipsync.errors import UserError

Fd = Annotated[int, typer.Option(hidden=True)]
Request = Annotated[str, typer.Option(help="What is run, whole: docs/architecture.md.")]

#: The speech side says so often how it is.
_STATUS_EVERY_S = 0.5


def bridge_process(
    channel: Fd,
    lifeline: Fd,
    control: Fd,
    control_path: Annotated[Path, typer.Option(hidden=True)],
    board: Fd,
    live: Fd,
    request: Request,
    stopped: StopLevel | None = None,
    stopped_by: str = "",
    failed: Annotated[list[str] | None, typer.Option(metavar="INDEX=REASON")] = None,
    switched_off: Annotated[list[int] | None, typer.Option(metavar="INDEX")] = None,
) -> None:
    """Own the port and drive the servos; targets come through a socket. Started by `daemon`."""
    die_with_parent(signal.SIGTERM)
    write_from_background()
    alive = inherited_lifeline(lifeline)
    from firmware_bridge.clock import MonotonicClock
    from firmware_bridge.process.bridge_process import run_bridge
    from firmware_bridge.process.socket_channel import SocketTargetChannel
    from lipservo.face.assembly import load_settings, settings_at_port
    from lipservo.face.servos import bridge_for, bus_for
    from lipservo.health.health_log import health_log
    from lipservo.status.live_board import LiveBoard
    from lipservo.status.servo_board import ServoBoard

    asked = request_of_json(request)
    if asked.port is None:
        raise UserError(
            "request.port: is missing; only servos at a port have processes of their own"
        )
    settings = settings_at_port(load_settings(asked.config)[0], asked.port)
    rate = asked.rate_hz or settings.rate_hz
    about = {**about_run(asked), "name": settings.name, "port": asked.port}
    with ExitStack() as stack:
        lines = stack.enter_context(LogLines(prefix="bridge: "))
        say = no_log if asked.quiet else lines
        end = stack.enter_context(socket.socket(fileno=channel))
        shared = stack.enter_context(StatusBoard.adopt(board))
        watched = stack.enter_context(LiveBoard.adopt(live))
        commands = shared_commands(asked, settings, shared)
        listener = stack.enter_context(
            ControlSocket.adopt(
                control, control_path, about, commands, shared.describe, watched.fileno()
            )
        )
        bus = bus_for(settings, MonotonicClock(), strict=False)
        targets = SocketTargetChannel(end)
        given_up = dict(_failed_servos(failed or ()))
        bridge = bridge_for(
            settings,
            bus,
            targets,
            rate_hz=rate,
            tolerant=True,
            given_up=given_up,
            switched_off=switched_off or (),
        )
        for index, reason in given_up.items():
            say(f"stays limp: {settings.joints()[index].name}: {reason}")
        healths = health_log(settings.name, asked.port, lines, os.environ)
        if healths is not None:
            stack.enter_context(healths)
        status = run_bridge(
            bus,
            bridge,
            control=listener,
            lifeline=alive,
            stopped=None if stopped is None else StopRequest(stopped, stopped_by),
            log=say,
            on_health=None if healths is None else healths.offer,
            on_tick=ServoBoard(watched, bridge).tell,
        )
    raise typer.Exit(status)


def speech_process(
    channel: Fd,
    lifeline: Fd,
    board: Fd,
    live: Fd,
    request: Request,
    control_path: Annotated[Path, typer.Option(hidden=True)],
    agents: Annotated[int | None, typer.Option(hidden=True)] = None,
    zero_s: float | None = None,
) -> None:
    """Hear, recognise, and publish targets through a socket. Started by `daemon`.

    agents: the socket where voice agents connect. zero_s: monotonic time at which the sound began;
    a file is taken up where it is by now.
    """
    die_with_parent(signal.SIGTERM)
    write_from_background()
    alive = inherited_lifeline(lifeline)
    from firmware_bridge.clock import MonotonicClock, ticks
    from firmware_bridge.process.socket_channel import SocketTargetChannel
    from lipservo.face.assembly import assemble_face
    from lipservo.speech.delay import PUBLISH_PERIOD_S
    from lipservo.speech.speech_board import SpeechBoard
    from lipservo.speech.speech_side import make_speech_side
    from lipservo.status.live_board import LiveBoard
    from lipservo.street.avatar_stream import entered_avatars
    from lipservo.street.motion_options import make_recognizer, make_synthesizer
    from lipservo.street.speech_status import speech_status
    from lipservo.street.spoken_sound import entered_sound
    from lipservo.street.voice_agents import voice_agents
    from lipsync.face.frame import Frame

    asked = request_of_json(request)
    face = assemble_face(asked.config, asked.model)
    with ExitStack() as stack:
        signals = stack.enter_context(SignalCounter())
        say = no_log if asked.quiet else stack.enter_context(LogLines(prefix="speech: "))
        end = stack.enter_context(socket.socket(fileno=channel))
        shared = stack.enter_context(StatusBoard.adopt(board))
        clock = MonotonicClock()
        is_file = asked.sound.kind == "file"
        start_s = 0.0 if zero_s is None or not is_file else max(0.0, clock.now() - zero_s)
        source = stack.enter_context(entered_sound(asked, start_s))
        motion = asked.motion
        recognizer = make_recognizer(
            motion.engine, time.perf_counter, motion.weights, motion.recognizer_latency_s
        )
        synthesizer = make_synthesizer(face.model, asked.motion, asked.model)
        targets = SocketTargetChannel(end)
        avatars = entered_avatars(asked.avatars, asked.model, stack, say)
        side = make_speech_side(face, source, recognizer, synthesizer, targets, has_soft_start=True)
        watched = stack.enter_context(LiveBoard.adopt(live))
        side.board = SpeechBoard(watched, face.model.rest)
        if zero_s is None or not start_s:
            zero_s = clock.now()
        else:
            say(f"{source.name} goes on at {start_s:.1f} s")
        # What the robot says is on a timeline of its own, which begins anew with each process.
        side.begin(zero_s if asked.voice is None else clock.now())
        alive.began(zero_s)
        listener = None if agents is None else socket.socket(fileno=agents)
        serving = voice_agents(listener, side, asked.voice, face.model, control_path, say)
        url = stack.enter_context(serving)
        n_servo_ticks = 0
        settings: dict[str, float] = {}
        tell_at_s = float("-inf")
        for time_s, _ in ticks(clock, 1.0 / PUBLISH_PERIOD_S):
            alive.beat()
            if signals.count or alive.closed:
                return
            side.follow_stop(time_s, is_stopped=shared.is_stopped())
            if (wanted := shared.settings()) != settings:
                side.change(wanted)
                settings, tell_at_s = wanted, time_s
            for number, servos in watched.servos_since(n_servo_ticks):
                side.note_servos(float(servos["time_s"]), servos["encoder_deg"])
                n_servo_ticks = number
            side.advance(time_s)
            if avatars is not None:
                sound_s = side.speech.sound_time_s(time_s)
                frame = side.speech.shown_at(max(0.0, sound_s))[1]
                at_rest = Frame(sound_s, face.model.rest)
                avatars.show(time_s, sound_s, at_rest if side.speech.is_cut_off else frame)
            for change in recognizer.take_changes():
                say(change)
            if time_s >= tell_at_s:
                tell_at_s = time_s + _STATUS_EVERY_S
                told = speech_status(asked.motion, source, recognizer, side.speech, settings, url)
                shared.write_speech(told)


def _failed_servos(given: Sequence[str]) -> list[tuple[int, str]]:
    """`INDEX=REASON` as the supervisor gives it. Raises UserError for anything else."""
    found = []
    for each in given:
        index, mark, reason = each.partition("=")
        if not mark or not index.isdigit():
            raise UserError(f"--failed {each}: give INDEX=REASON")
        found.append((int(index), reason))
    return found
