"""`sim-bus`: simulated servos behind a serial port that any program can open."""

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lipsync.errors import UserError

if TYPE_CHECKING:
    from firmware_bridge.simulator.chain import SimulatedChain
    from firmware_bridge.simulator.faults import Fault

#: Characters.
_LONGEST_SCRIPT = 100_000
#: A face of ten, as `face_sim`.
_N_SERVOS = 10


def sim_bus(
    config: Annotated[
        str | None,
        typer.Option(help="Simulate the servos of this face.", show_default=False),
    ] = None,
    servos: Annotated[int, typer.Option(min=1, max=252, help="How many, without --config.")] = (
        _N_SERVOS
    ),
    model: Annotated[str, typer.Option(help="Which model, without --config.")] = "XL330-M288",
    first_id: Annotated[int, typer.Option(min=0, max=252, help="The others follow.")] = 1,
    baud_rate: Annotated[
        int | None,
        typer.Option(help="Set the servos up for this rate; default: fresh, 57600.", min=9600),
    ] = None,
    faults: Annotated[
        Path | None, typer.Option(help="YAML script of faults.", show_default=False)
    ] = None,
    link: Annotated[
        Path | None,
        typer.Option(help="A path that always leads to the port.", show_default=False),
    ] = None,
    chain_stops: Annotated[
        bool, typer.Option(help="Servos behind a silent one do not answer.")
    ] = False,
    on_time: Annotated[
        bool, typer.Option(help="Ask the computer for real-time scheduling.")
    ] = False,
    until_stdin_closes: Annotated[bool, typer.Option(hidden=True)] = False,
) -> None:
    """Simulate a chain of Dynamixel servos; prints the port, serves it until stopped.

    Any program that speaks to Dynamixels can open the port: lipservo, dynamixel-sdk, others.
    """
    from firmware_bridge.errors import PortError
    from firmware_bridge.process.operating_system import run_on_time
    from firmware_bridge.simulator.ports import PtyHost

    chain = _chain(config, servos, model, first_id, baud_rate, faults, chain_stops=chain_stops)
    try:
        host = PtyHost(chain, link)
    except PortError as error:
        raise UserError(str(error)) from error
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
        host.serve(lambda: stopped, sys.stdin.fileno() if until_stdin_closes else None)
    finally:
        host.close()


def _chain(
    config: str | None,
    n_servos: int,
    model: str,
    first_id: int,
    baud_rate: int | None,
    faults: Path | None,
    *,
    chain_stops: bool,
) -> "SimulatedChain":
    from firmware_bridge.dynamixel.control_table import baud_rates, servo_models
    from firmware_bridge.simulator.chain import SimulatedChain, chain_for
    from firmware_bridge.simulator.wire import WireRules
    from lipservo.runtime.servos.assembly import load_settings, mounted_servos

    if model not in servo_models():
        raise UserError(f"model {model!r} is not known; use one of {', '.join(servo_models())}")
    if baud_rate is not None and baud_rate not in baud_rates().values():
        raise UserError(f"{baud_rate} baud is no rate of these servos")
    if first_id + n_servos - 1 > 252:
        raise UserError(f"ids {first_id}..{first_id + n_servos - 1}: a servo's id is at most 252")
    rules = WireRules(chain_stops=chain_stops)
    if config is not None:
        face, _ = load_settings(config)
        mounted = mounted_servos(face)
        seed, script = _script(faults, len(mounted))
        rate = baud_rate or face.bus.baud_rate
        return chain_for(mounted, rate, faults=script, seed=seed, rules=rules)
    seed, script = _script(faults, n_servos)
    models = [servo_models()[model]] * n_servos
    ids = range(first_id, first_id + n_servos)
    return SimulatedChain(models, ids, baud_rate=baud_rate, faults=script, seed=seed, rules=rules)


def _script(file: Path | None, n_servos: int) -> "tuple[int, tuple[Fault, ...]]":
    """Seed and faults; none without a file."""
    from firmware_bridge.simulator.fault_script import FaultScriptError, read_faults

    if file is None:
        return 0, ()
    try:
        with file.open(encoding="utf-8") as opened:
            text = opened.read(_LONGEST_SCRIPT + 1)
    except OSError as error:
        raise UserError(f"--faults {file}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UserError(f"--faults {file}: is not text in UTF-8") from error
    if len(text) > _LONGEST_SCRIPT:
        raise UserError(f"--faults {file}: is longer than any fault script, {_LONGEST_SCRIPT:,}")
    try:
        return read_faults(text, n_servos)
    except FaultScriptError as error:
        raise UserError(f"--faults {file}: {error}") from error
