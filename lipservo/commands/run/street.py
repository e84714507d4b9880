"""`run`, `daemon` and `replay`: the street with one source, three clocks and ends."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from firmware_bridge.clock import ManualClock, MonotonicClock
from lipservo.commands.options import (
    DEFAULT_FACE,
    Config,
    Json,
    Model,
    Quiet,
)
from lipservo.commands.run.motion_flags import takes_manner
from lipservo.commands.run.processes import Control, supervise
from lipservo.face.assembly import load_settings
from lipservo.face.face_life import say
from lipservo.face.face_stopped import exit_status
from lipservo.face.sim_process import servo_port
from lipservo.street.motion_options import Manner
from lipservo.street.run_face import Performance, Played
from lipservo.street.sources import open_source, open_source_or_silence
from lipservo.street.summary import print_summary
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError

Trace = Annotated[
    Path | None, typer.Option(help="Write every tick to this file.", show_default=False)
]
Wav = Annotated[
    Path | None,
    typer.Option(help="Sound file: WAV, FLAC, OGG, any rate.", show_default=False),
]
Mic = Annotated[
    str | None,
    typer.Option(
        metavar="[DEVICE]",
        help="Listen to a microphone: the default one, or a number or part of a name.",
        show_default=False,
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(
        min=30.0, max=200.0, help="Frames a second; default: the face's.", show_default=False
    ),
]

Port = Annotated[
    str | None,
    typer.Option(help="Serial port of the servos, /dev/ttyUSB0 for one.", show_default=False),
]
Sim = Annotated[
    str | None,
    typer.Option(help="`pty`: simulated servos behind a port of their own.", show_default=False),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Read the servos, never move them.")]


@takes_manner
def run(
    *,
    wav: Wav = None,
    mic: Mic = None,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    trace: Trace = None,
    rate_hz: Rate = None,
    manner: Manner,
    port: Port = None,
    sim: Sim = None,
    dry_run: DryRun = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Speech drives the face, live; without --wav or --mic the bundled clip speaks."""
    _refuse_both(wav, mic)
    quiet = quiet or as_json
    with servo_port(port, sim, config) as at_port, open_source(wav, mic) as source:
        performance = Performance(
            config,
            model,
            trace,
            rate_hz,
            live=not quiet,
            quiet=quiet,
            port=at_port,
            dry_run=dry_run,
            manner=manner,
        )
        played = performance.play(source, MonotonicClock())
    _finish(played, as_json=as_json, quiet=quiet)


@takes_manner
def daemon(
    *,
    wav: Wav = None,
    mic: Mic = None,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    trace: Trace = None,
    rate_hz: Rate = None,
    manner: Manner,
    port: Port = None,
    sim: Sim = None,
    control: Control = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run until stopped; with nothing to hear the mouth rests closed. What a service starts.

    With servos at a port, bridge and speech are processes of their own, watched over.
    """
    _refuse_both(wav, mic)
    with servo_port(port, sim, config) as at_port:
        if at_port is None:
            bus = load_settings(config)[0].bus
            at_port = bus.port if bus.kind == "dynamixel" else None
        if at_port is not None:
            if trace is not None:
                raise UserError(
                    "--trace: a face in processes of its own writes none; "
                    "`lipservo run --port PORT --trace FILE` does"
                )
            status = supervise(
                config,
                model,
                at_port,
                wav,
                mic,
                rate_hz,
                manner,
                control,
                as_json=as_json,
                quiet=quiet,
            )
            raise typer.Exit(status)
    performance = Performance(
        config, model, trace, rate_hz, live=False, quiet=quiet, endless=True, manner=manner
    )
    with open_source_or_silence(wav, mic) as source:
        played = performance.play(source, MonotonicClock())
    # A service manager counts anything but 0 as a failure, and stops a daemon by a signal.
    _finish(replace(played, signal_number=None), as_json=as_json, quiet=quiet)


@takes_manner
def replay(
    *,
    sound: Annotated[Path, typer.Argument(help="Sound file to replay.")],
    config: Config = DEFAULT_FACE,
    model: Model = None,
    trace: Trace = None,
    rate_hz: Rate = None,
    manner: Manner,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run the street as fast as it goes, on a clock of its own: same file, same trace."""
    performance = Performance(config, model, trace, rate_hz, live=False, quiet=True, manner=manner)
    with open_source(sound, None) as source:
        played = performance.play(source, ManualClock())
    _finish(played, as_json=as_json, quiet=quiet)


def devices(as_json: Json = False) -> None:
    """List the microphones that `run --mic DEVICE` can listen to."""
    from lipsync.audio.microphone import input_devices

    found = input_devices()
    if as_json:
        print_json({"devices": [asdict(device) for device in found]})
        return
    for device in found:
        mark = "*" if device.is_default else " "
        RESULTS.print(f"{mark} {device.index:3d}  {device.name}, {device.sample_rate_hz} Hz")
    if not found:
        MESSAGES.print("no microphone found")


def _refuse_both(wav: Path | None, mic: str | None) -> None:
    if wav is not None and mic is not None:
        raise typer.BadParameter("give --wav or --mic, not both")


def _finish(played: Played, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        print_json({**played.summary.as_dict(), "stop": played.report.as_dict()})
    elif not quiet:
        print_summary(played.summary, RESULTS)
    status = exit_status(played.report, played.signal_number)
    if not played.report.complete and quiet:
        say(played.report.text())
    if status:
        raise typer.Exit(status)
