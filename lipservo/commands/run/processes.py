"""`bridge-process`, `speech-process`, and the supervisor of both: a face in several processes."""

import os
import signal
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.lifeline import inherited_lifeline
from firmware_bridge.process.log_lines import LogLines
from firmware_bridge.process.scheduling import StopSignals, die_with_parent, write_from_background
from firmware_bridge.stopping import StopLevel
from lipservo.commands.options import (
    DEFAULT_FACE,
    Config,
    Model,
    Quiet,
)
from lipservo.commands.run.motion_flags import manner_arguments, takes_manner
from lipservo.street.motion_options import Manner
from lipservo.terminal.output import MESSAGES, print_json
from lipsync.errors import UserError

Fd = Annotated[int, typer.Option(hidden=True)]
Port = Annotated[str, typer.Option(help="Serial port of the servos.")]
Control = Annotated[
    Path | None, typer.Option(help="Socket that the face listens on.", show_default=False)
]

#: Targets are published at 100 Hz: firmware_bridge's reader interpolates.
_PUBLISH_S = 0.010


def supervise(
    config: str,
    model: Path | None,
    port: str,
    wav: Path | None,
    mic: str | None,
    rate_hz: float | None,
    manner: Manner,
    control: Path | None,
    *,
    as_json: bool = False,
    quiet: bool = False,
) -> int:
    """Run bridge and speech as processes until stopped; the exit status.

    What cannot be used, sound and servos included, is refused before anything is armed.
    """
    from firmware_bridge.process.child import Child, Patience
    from firmware_bridge.process.last_resort import TorqueRelease
    from firmware_bridge.process.runtime_folder import socket_path
    from firmware_bridge.process.service_notice import ServiceNotice
    from firmware_bridge.process.socket_channel import channel_pair
    from firmware_bridge.process.supervisor import Supervisor
    from lipservo.face.assembly import assemble_face, at_port, check_servos
    from lipservo.face.servos import port_opener
    from lipservo.street.sources import open_source

    face = at_port(assemble_face(config, model), port)
    if wav is not None:
        open_source(wav, None)
    check_servos(face)
    settings = face.settings
    opener = port_opener(port, settings.bus.baud_rate)
    servo_names = {joint.servo_id: joint.name for joint in settings.joints()}
    about = {"name": settings.name, "port": port}
    with ExitStack() as stack:
        signals = stack.enter_context(StopSignals())
        say = _no_log if quiet else stack.enter_context(LogLines())
        listener = ControlSocket.bind(control or socket_path(settings.name), about)
        stack.enter_context(listener)
        writer, reader = channel_pair()
        inherited = {"{channel}": reader.fileno(), "{control}": listener.fileno()}
        common = [sys.executable, "-m", "lipservo"]
        shared = ["--config", config, "--lifeline", "{lifeline}", *(["--quiet"] if quiet else [])]
        bridge = [*common, "bridge-process", *shared, "--port", port, "--channel", "{channel}"]
        bridge += ["--control", "{control}", "--control-path", str(listener.path)]
        bridge += [] if rate_hz is None else ["--rate-hz", str(rate_hz)]
        speech = [*common, "speech-process", *shared, "--channel", "{channel}"]
        speech += manner_arguments(manner)
        speech += [] if model is None else ["--model", str(model)]
        speech += [] if wav is None else ["--wav", str(wav)]
        speech += [] if mic is None else ["--mic", mic]
        report = Supervisor(
            Child("bridge", bridge, inherited, Patience(start_s=30.0, run_s=1.0)),
            Child("speech", speech, {"{channel}": writer.fileno()}, Patience(60.0, 3.0)),
            listener,
            lambda patience_s: TorqueRelease(opener, list(servo_names), patience_s=patience_s),
            servo_names=servo_names,
            say=say,
            notice=ServiceNotice(say),
        ).run(signals)
    if as_json:
        print_json(report.as_dict())
    elif not quiet or report.unconfirmed:
        MESSAGES.print(f"ended; {report.text()}", soft_wrap=True, highlight=False)
    return report.status


def bridge_process(
    channel: Fd,
    lifeline: Fd,
    control: Fd,
    control_path: Annotated[Path, typer.Option(hidden=True)],
    port: Port,
    config: Config = DEFAULT_FACE,
    rate_hz: float | None = None,
    stopped: StopLevel | None = None,
    failed: Annotated[list[str] | None, typer.Option(metavar="INDEX=REASON")] = None,
    quiet: Quiet = False,
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

    settings = settings_at_port(load_settings(config)[0], port)
    rate = rate_hz or settings.rate_hz
    about = {"name": settings.name, "port": port}
    with ExitStack() as stack:
        say = _no_log if quiet else stack.enter_context(LogLines(prefix="bridge: "))
        end = stack.enter_context(socket.socket(fileno=channel))
        listener = stack.enter_context(ControlSocket.adopt(control, control_path, about))
        bus = bus_for(settings, MonotonicClock(), strict=False)
        targets = SocketTargetChannel(end)
        given_up = dict(_failed_servos(failed or ()))
        bridge = bridge_for(settings, bus, targets, rate_hz=rate, tolerant=True, given_up=given_up)
        for index, reason in given_up.items():
            say(f"stays limp: {settings.joints()[index].name}: {reason}")
        healths = health_log(settings.name, port, say, os.environ)
        if healths is not None:
            stack.enter_context(healths)
        status = run_bridge(
            bus,
            bridge,
            rate_hz=rate,
            control=listener,
            lifeline=alive,
            stopped=stopped,
            log=say,
            on_health=None if healths is None else healths.offer,
        )
    raise typer.Exit(status)


@takes_manner
def speech_process(
    *,
    channel: Fd,
    lifeline: Fd,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    wav: Path | None = None,
    mic: str | None = None,
    zero_s: float | None = None,
    manner: Manner,
    quiet: Quiet = False,
) -> None:
    """Hear, recognise, and publish targets through a socket. Started by `daemon`.

    zero_s: monotonic time at which the sound began; a file is taken up where it is by now.
    """
    die_with_parent(signal.SIGTERM)
    write_from_background()
    alive = inherited_lifeline(lifeline)
    from firmware_bridge.clock import MonotonicClock, ticks
    from firmware_bridge.process.socket_channel import SocketTargetChannel
    from lipservo.face.assembly import assemble_face
    from lipservo.street.motion_options import make_recognizer, make_synthesizer
    from lipservo.street.sources import open_source_or_silence
    from lipservo.street.speech import Speech

    face = assemble_face(config, model)
    with ExitStack() as stack:
        signals = stack.enter_context(StopSignals())
        say = _no_log if quiet else stack.enter_context(LogLines(prefix="speech: "))
        end = stack.enter_context(socket.socket(fileno=channel))
        clock = MonotonicClock()
        start_s = 0.0 if zero_s is None or wav is None else max(0.0, clock.now() - zero_s)
        source = stack.enter_context(open_source_or_silence(wav, mic, start_s))
        recognizer = make_recognizer(manner.engine, time.perf_counter, manner.weights)
        synthesizer = make_synthesizer(face.model, manner, model)
        targets = SocketTargetChannel(end)
        speech = Speech(source, recognizer, synthesizer, face.calibration, targets)
        if zero_s is None or not start_s:
            zero_s = clock.now()
        else:
            say(f"{source.name} goes on at {start_s:.1f} s")
        alive.began(zero_s)
        n_said = 0
        for time_s, _ in ticks(clock, 1.0 / _PUBLISH_S):
            alive.beat()
            if signals.count or alive.closed:
                return
            speech.advance(time_s, zero_s)
            for reason in recognizer.reasons[n_said:]:
                say(f"recogniser left: {reason}")
            n_said = len(recognizer.reasons)


def _failed_servos(given: Sequence[str]) -> list[tuple[int, str]]:
    """`INDEX=REASON` as the supervisor gives it. Raises UserError for anything else."""
    found = []
    for each in given:
        index, mark, reason = each.partition("=")
        if not mark or not index.isdigit():
            raise UserError(f"--failed {each}: give INDEX=REASON")
        found.append((int(index), reason))
    return found


def _no_log(_line: str) -> None:
    """What --quiet asks for."""
