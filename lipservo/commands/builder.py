"""`doctor`, `setup-servos`, `jog`, `neutral`, `new-face`: a builder's first hour."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lipservo.commands.options import DEFAULT_FACE, Config, Json
from lipservo.output import MESSAGES, RESULTS, print_json, say_simulated
from lipsync.errors import UserError

if TYPE_CHECKING:
    from firmware_bridge.dynamixel.mounting import MountedServo

Port = Annotated[
    str | None,
    typer.Option(help="Serial port of the servos; default: the face's.", show_default=False),
]


def doctor(port: Port = None, config: Config = DEFAULT_FACE, as_json: Json = False) -> None:
    """Examine port, adapter and every servo; say what is wrong and what to do. Changes nothing.

    Exit status 1 when something is bad.
    """
    from firmware_bridge.dynamixel.doctor import Severity, examine
    from firmware_bridge.dynamixel.line import Line
    from firmware_bridge.dynamixel.serial_transport import latency_timer_ms, open_port
    from lipservo.assembly import load_settings
    from lipservo.servos import mounted_servos

    settings, _ = load_settings(config)
    name = _port(port, settings.bus.port)
    transport = open_port(name, settings.bus.baud_rate)
    try:
        findings = []
        line = Line(transport)
        for finding in examine(
            line, mounted_servos(settings), settings.rate_hz, latency_timer_ms(name)
        ):
            findings.append(finding)
            if not as_json:
                mark = {0: "ok  ", 1: "warn", 2: "BAD "}[finding.severity]
                remedy = f" -> {finding.remedy}" if finding.remedy else ""
                RESULTS.print(f"{mark} {finding.what}{remedy}", soft_wrap=True, highlight=False)
    finally:
        transport.close()
    n_bad = sum(finding.severity is Severity.BAD for finding in findings)
    if as_json:
        listed = [
            {"severity": f.severity.name.lower(), "what": f.what, "remedy": f.remedy}
            for f in findings
        ]
        print_json({"bad": n_bad, "findings": listed})
    if n_bad:
        raise typer.Exit(1)


def setup_servos(
    joints: Annotated[
        list[str] | None, typer.Argument(help="Joints to set up; default: all, one by one.")
    ] = None,
    port: Port = None,
    config: Config = DEFAULT_FACE,
) -> None:
    """Give each servo its id, rate and limits. Connect one servo at a time.

    Without JOINTS it asks for one after another; with one joint it asks nothing.
    """
    from lipservo.assembly import load_settings
    from lipservo.servos import mounted_servos

    settings, _ = load_settings(config)
    servos = {servo.joint.name: servo for servo in mounted_servos(settings)}
    unknown = [name for name in joints or () if name not in servos]
    if unknown:
        raise UserError(f"no joint {unknown[0]!r} in this face; it has {', '.join(servos)}")
    name = _port(port, settings.bus.port)
    for joint in joints or list(servos):
        if joints is None or len(joints) > 1:
            typer.prompt(
                f"Connect the servo of {joint!r} alone, then press Enter", "", show_default=False
            )
        _set_up_one(name, settings.bus.baud_rate, servos[joint])


def _set_up_one(port: str, baud_rate: int, servo: "MountedServo") -> None:
    """Find the one servo there is, whatever its id and rate, and set it up."""
    from firmware_bridge.dynamixel.control_table import model_by_number
    from firmware_bridge.dynamixel.line import Line
    from firmware_bridge.dynamixel.provisioning import SCANNED_RATES, scan, set_up, wanted_settings
    from firmware_bridge.dynamixel.serial_transport import open_port

    transport = open_port(port, baud_rate)
    try:
        line = Line(transport)
        scanned = scan(line, [baud_rate, *SCANNED_RATES])
        rate, found = next((each for each in scanned if each[1]), (0, {}))
        if not found:
            raise UserError(f"{port}: no servo answers; check its power and cable")
        if len(found) > 1:
            raise UserError(
                f"{port}: {len(found)} servos answer (ids {sorted(found)}); connect one at a time"
            )
        ((servo_id, number),) = found.items()
        known = model_by_number(number)
        if known is None or known.name != servo.model.name:
            it_is = known.name if known else f"of unknown model {number}"
            raise UserError(
                f"the servo found is {it_is}, {servo.joint.name!r} needs {servo.model.name}"
            )
        line.baud_rate = rate
        changes = set_up(line, servo_id, servo.model, wanted_settings(servo, baud_rate))
    finally:
        transport.close()
    for change in changes:
        RESULTS.print(f"{servo.joint.name}: {change.name} {change.found} -> {change.wanted}")
    RESULTS.print(f"{servo.joint.name}: set up as id {servo.joint.servo_id}")


def jog(
    joint: Annotated[str, typer.Argument(help="Which joint.")],
    deg: Annotated[float, typer.Argument(help="Where to, joint degrees.")],
    port: Port = None,
    config: Config = DEFAULT_FACE,
    hold_s: Annotated[float, typer.Option(min=0.0, max=60.0, help="How long to stay.")] = 1.0,
) -> None:
    """Move one joint, the others held, through the safety gate; then all go limp."""
    from lipservo.moving import move_to

    _say_if_simulated(port, config)
    reached_deg = move_to(config, port, {joint: deg}, hold_s)
    RESULTS.print(f"{joint} stands at {reached_deg[joint]:.1f} deg")


def neutral(port: Port = None, config: Config = DEFAULT_FACE) -> None:
    """Bring every joint to its neutral, through the safety gate; then all go limp."""
    from lipservo.moving import move_to

    _say_if_simulated(port, config)
    reached_deg = move_to(config, port, None, 0.5)
    for name, angle_deg in reached_deg.items():
        RESULTS.print(f"{name} stands at {angle_deg:.1f} deg")


def new_face(
    output: Annotated[Path, typer.Option("--output", "-o", help="The YAML to write.")],
    port: Annotated[str, typer.Option(help="Serial port of the servos.")],
    baud_rate: Annotated[int, typer.Option(help="Try this rate first.")] = 1_000_000,
    ranges: Annotated[
        Path | None,
        typer.Option(help="LeRobot range file: names and limits by id.", show_default=False),
    ] = None,
) -> None:
    """Find the servos, move each by 3 degrees, ask for its name and direction, write the YAML.

    With --ranges, put the face into its neutral by hand before: that is where 0 degrees will be.
    """
    from calibration.lerobot_ranges import by_id, read_ranges
    from lipservo.new_face import FoundJoint, face_yaml, find_servos, nudge
    from lipservo.settings import load_face

    if output.exists():
        raise UserError(f"{output}: exists already; choose another name")
    recorded = {} if ranges is None else by_id(read_ranges(ranges))
    rate, found = find_servos(port, baud_rate)
    MESSAGES.print(f"{len(found)} servos at {rate:,} baud: ids {', '.join(map(str, found))}")
    joints: list[FoundJoint] = []
    for servo_id, model in found.items():
        tick = nudge(port, rate, servo_id, model)
        known = recorded.get(servo_id)
        name = typer.prompt(
            f"id {servo_id} ({model}) moved by 3 degrees and back. Which joint",
            default=known.name if known else None,
        )
        word = typer.prompt("What should a positive angle do (opens, raises, widens ...)")
        same = typer.confirm("Did its first move do that", default=True)
        joint = FoundJoint(name, servo_id, model, word, 1 if same else -1)
        joints.append(joint if known is None else joint.within(known, tick))
    output.write_text(face_yaml(output.stem, port, rate, joints), encoding="utf-8")
    try:
        load_face(output)
    except UserError:
        output.unlink()
        raise
    RESULTS.print(
        f"{output}: {len(joints)} joints. Next: set limits in it, `lipservo setup-servos`"
    )


def _say_if_simulated(port: str | None, config: str) -> None:
    from lipservo.assembly import load_settings

    if port is None and load_settings(config)[0].bus.kind == "simulated":
        say_simulated()


def _port(given: str | None, of_the_face: str | None) -> str:
    port = given or of_the_face
    if port is None:
        raise UserError("no port: give --port, or write `bus: {kind: dynamixel, port: ...}`")
    return port
