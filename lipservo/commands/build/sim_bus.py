"""The command `sim-bus`: simulated servos behind a serial port that any program can open."""

import contextlib
import os
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from lipservo.commands.options import Bus
from lipsync.errors import UserError

#: Characters of a file with faults.
_LONGEST_SCRIPT = 100_000
#: Lines on standard input turn servos, as hands would: so many bytes are read at a time.
_MOST_BYTES = 4096
#: As many as the face `face_sim` has.
_N_SERVOS = 10
#: The kind of servos that is simulated without a face.
_DEFAULT_KIND = "dynamixel"


def sim_bus(
    config: Annotated[
        str | None, typer.Option(help="Face (name or YAML file) whose servos are simulated.")
    ] = None,
    bus: Bus = None,
    kind: Annotated[
        str, typer.Option(help="Without --config: kind of servos: dynamixel, maestro, feetech.")
    ] = _DEFAULT_KIND,
    servos: Annotated[
        int, typer.Option(min=1, max=252, help="Without --config: number of servos.")
    ] = _N_SERVOS,
    model: Annotated[
        str | None,
        typer.Option(help="Without --config: model of the servos; default: XL330-M288 or STS3215."),
    ] = None,
    first_id: Annotated[
        int, typer.Option(min=0, max=252, help="Without --config: id of the first servo.")
    ] = 1,
    baud_rate: Annotated[
        int | None,
        typer.Option(
            min=9600,
            help="Baud rate set in the servos; default: the face's, or as delivered "
            "(Dynamixel: 57600).",
        ),
    ] = None,
    faults: Annotated[
        Path | None, typer.Option(help="YAML file with faults to simulate (docs/simulator.md).")
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(help="File to log pulses in, or torque and goals of Feetech servos."),
    ] = None,
    link: Annotated[
        Path | None, typer.Option(help="Make this path a link to the serial port.")
    ] = None,
    chain_stops: Annotated[
        bool, typer.Option(help="A servo that does not answer also silences those behind it.")
    ] = False,
    on_time: Annotated[
        bool, typer.Option(help="Ask the operating system for real-time scheduling.")
    ] = False,
    until_stdin_closes: Annotated[bool, typer.Option(hidden=True)] = False,
) -> None:
    """Simulate Dynamixel or Feetech servos, or a Maestro, behind a serial port, until stopped.

    The command prints the port. Any program that speaks the servos' protocol can open it: lipservo,
    dynamixel-sdk, others.
    """
    from firmware_bridge.bus_kinds import bus_kind
    from firmware_bridge.errors import BusError
    from firmware_bridge.process.operating_system import run_on_time
    from firmware_bridge.simulation_request import SimulationRequest
    from lipservo.runtime.servos.assembly import load_settings

    face = None if config is None else load_settings(config)[0]
    if face is not None and bus is not None:
        face = face.of_bus(bus)
    simulator = (bus_kind(kind) if face is None else face.bus_kind).simulator()
    script = None if faults is None else _read_script(faults)
    try:
        request = SimulationRequest(servos, first_id, model, baud_rate, script, log, chain_stops)
        host = simulator.serve(None if face is None else face.wiring, link, request)
    except BusError as error:
        raise UserError(str(error)) from error
    except ValueError as error:
        raise UserError(f"--faults {faults}: {error}") from error
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, stop)
    if on_time:
        run_on_time()
    sys.stdout.write(f"{link or host.port}\n")
    sys.stdout.flush()
    try:
        # Serve until a signal. A line on standard input interrupts that, to turn servos; where the
        # input ends, the simulator does.
        stdin = sys.stdin.fileno() if until_stdin_closes else None
        host.serve(lambda: stopped, stdin)
        while stdin is not None and not stopped and (line_bytes := os.read(stdin, _MOST_BYTES)):
            _turn_servos(host, line_bytes.decode("ascii", "replace"))
            host.serve(lambda: stopped, stdin)
    finally:
        host.close()


def _turn_servos(host: Any, lines: str) -> None:
    """Turn a simulated servo as a hand would for each line `INDEX DEG`; ignore other lines.

    host: the simulator.
    """
    for line in lines.splitlines():
        with contextlib.suppress(ValueError):
            index, by_deg = line.split()
            host.turn(int(index), float(by_deg))


def _read_script(file: Path) -> str:
    """Return the text of a fault script. Raises UserError if unreadable, not UTF-8 or too long."""
    try:
        with file.open(encoding="utf-8") as opened:
            text = opened.read(_LONGEST_SCRIPT + 1)
    except OSError as error:
        raise UserError(f"--faults {file}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UserError(f"--faults {file}: is not UTF-8 text") from error
    if len(text) > _LONGEST_SCRIPT:
        raise UserError(f"--faults {file}: is longer than {_LONGEST_SCRIPT:,} characters")
    return text
