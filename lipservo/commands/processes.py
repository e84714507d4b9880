"""`bridge-process`, `speech-process`, `stop`: a face in several processes."""

import os
import signal
import socket
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from firmware_bridge.bus import BusError
from firmware_bridge.control_socket import StopLevel, ask, default_path
from firmware_bridge.process import die_with_parent
from lipservo.commands.manner_options import manner_arguments, takes_manner
from lipservo.commands.options import (
    DEFAULT_FACE,
    Config,
    Json,
    Model,
)
from lipservo.manner import Manner
from lipservo.output import MESSAGES, print_json
from lipsync.errors import UserError

Fd = Annotated[int, typer.Option(hidden=True)]
Port = Annotated[str, typer.Option(help="Serial port of the servos.")]
Control = Annotated[
    Path | None, typer.Option(help="Socket the bridge listens on.", show_default=False)
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
) -> int:
    """Run bridge and speech as processes until stopped; the exit status."""
    from firmware_bridge.last_resort import make_limp
    from firmware_bridge.service_notice import ServiceNotice
    from firmware_bridge.socket_channel import channel_pair
    from firmware_bridge.supervisor import Supervisor
    from lipservo.assembly import assemble_face, at_port, check_servos
    from lipservo.daemon import stopped_by_signals
    from lipservo.servos import port_opener

    face = at_port(assemble_face(config, model), port)
    check_servos(face)
    settings = face.settings
    opener = port_opener(port, settings.bus.baud_rate)
    ids = [joint.servo_id for joint in settings.joints()]

    def limp_by_force() -> str:
        try:
            stiff = make_limp(opener, ids)
        except BusError as error:
            return f"torque state unknown: {error}"
        if stiff:
            return f"torque off was not confirmed by ids {stiff}"
        return f"torque off confirmed by all {len(ids)} servos"

    common = [sys.executable, "-m", "lipservo"]
    bridge = [*common, "bridge-process", "--config", config, "--port", port, "--fd", "{fd}"]
    control = control or default_path()
    bridge += ["--control", str(control)]
    bridge += [] if rate_hz is None else ["--rate-hz", str(rate_hz)]
    speech = [*common, "speech-process", "--config", config, "--fd", "{fd}"]
    speech += manner_arguments(manner)
    speech += [] if model is None else ["--model", str(model)]
    speech += [] if wav is None else ["--wav", str(wav)]
    speech += [] if mic is None else ["--mic", mic]
    with stopped_by_signals() as stop:
        return Supervisor(
            bridge,
            speech,
            channel_pair(),
            after_bridge_death=limp_by_force,
            say=_say,
            alive=ServiceNotice(control),
        ).run(stop.is_set)


def _say(line: str) -> None:
    MESSAGES.print(line, soft_wrap=True, highlight=False)


def bridge_process(
    fd: Fd,
    port: Port,
    config: Config = DEFAULT_FACE,
    control: Control = None,
    rate_hz: float | None = None,
) -> None:
    """Own the port and drive the servos; targets come through a socket. Started by `daemon`."""
    parent = os.getppid()
    die_with_parent(signal.SIGTERM)
    from firmware_bridge.bridge_process import run_bridge
    from firmware_bridge.clock import MonotonicClock
    from firmware_bridge.socket_channel import SocketTargetChannel
    from lipservo.assembly import load_settings, settings_at_port
    from lipservo.daemon import stopped_by_signals
    from lipservo.servos import bridge_for, bus_for

    settings = settings_at_port(load_settings(config)[0], port)
    with stopped_by_signals() as stop, socket.socket(fileno=fd) as end:
        rate = rate_hz or settings.rate_hz
        bus = bus_for(settings, MonotonicClock(), strict=False)
        channel = SocketTargetChannel(end)
        bridge = bridge_for(settings, bus, channel, rate_hz=rate, tolerant=True)
        run_bridge(
            bus,
            bridge,
            rate_hz=rate,
            control=control or default_path(),
            stopped=stop.is_set,
            parent=parent,
            say=_say,
        )


@takes_manner
def speech_process(
    *,
    fd: Fd,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    wav: Path | None = None,
    mic: str | None = None,
    manner: Manner,
) -> None:
    """Hear, recognise, and publish targets through a socket. Started by `daemon`."""
    parent = os.getppid()
    die_with_parent(signal.SIGTERM)
    from firmware_bridge.clock import MonotonicClock, ticks
    from firmware_bridge.process import parent_is_alive
    from firmware_bridge.socket_channel import SocketTargetChannel
    from lipservo.assembly import assemble_face
    from lipservo.daemon import stopped_by_signals
    from lipservo.manner import make_recognizer, make_synthesizer
    from lipservo.pipeline import Speech
    from lipservo.sources import open_source_or_silence

    face = assemble_face(config, model)
    with (
        stopped_by_signals() as stop,
        socket.socket(fileno=fd) as end,
        open_source_or_silence(wav, mic) as source,
    ):
        recognizer = make_recognizer(manner.engine, time.perf_counter)
        synthesizer = make_synthesizer(face.model, manner)
        channel = SocketTargetChannel(end)
        speech = Speech(source, recognizer, synthesizer, face.calibration, channel)
        clock = MonotonicClock()
        zero_s = clock.now()
        for time_s, _ in ticks(clock, 1.0 / _PUBLISH_S):
            if stop.is_set() or not parent_is_alive(parent):
                return
            speech.advance(time_s, zero_s)


def stop(
    limp: Annotated[bool, typer.Option("--limp", help="Let go at once, wherever it is.")] = False,
    freeze: Annotated[
        bool, typer.Option("--freeze", help="Stay where it is, held, until the next stop.")
    ] = False,
    control: Control = None,
    as_json: Json = False,
) -> None:
    """Stop a running face: to rest and limp. Works although the speech side is dead."""
    level = StopLevel.LIMP if limp else StopLevel.FREEZE if freeze else StopLevel.SOFT
    path = control or default_path()
    try:
        status = ask(path, level.value)
    except OSError as error:
        raise UserError(f"{path}: no bridge answers there; is a face running?") from error
    if as_json:
        print_json(status)
    else:
        MESSAGES.print(f"stopping: {level.value}")
