"""The command `new-face`, which writes a face's YAML from found or named servos."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from firmware_bridge.errors import BusError
from lipservo.commands.options import OpenPage, Sim, refusing
from lipservo.terminal.output import MESSAGES, RESULTS
from lipsync.errors import UserError
from lipsync.output_file import write_whole

if TYPE_CHECKING:
    from lipservo.runtime.servos.new_face import NewBus

#: The baud rate that is tried first when servos are searched for.
FIRST_BAUD_RATE: Final = 1_000_000


def new_face(
    output: Annotated[Path, typer.Option("--output", "-o", help="The YAML file to write.")],
    port: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PORT",
            help="Serial port of the servos, such as /dev/ttyUSB0; for several buses NAME=PORT, "
            "once for each bus.",
        ),
    ] = None,
    bus: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND",
            help="Kind of bus: dynamixel, feetech, maestro, pca9685, ...; default: detected at "
            "the port. For several buses NAME=KIND, once for each bus.",
        ),
    ] = None,
    baud_rate: Annotated[int, typer.Option(help="Baud rate to try first.")] = FIRST_BAUD_RATE,
    ranges: Annotated[
        Path | None,
        typer.Option(help="LeRobot range file with the joints' names and limits by servo id."),
    ] = None,
    board: Annotated[
        list[str] | None,
        typer.Option(
            metavar="BOARD",
            help="Board of hobby servos: the Maestro's model (micro6) or the PCA9685's address "
            "(0x40); for several buses NAME=BOARD.",
        ),
    ] = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=CHANNEL:WORD",
            help="A hobby servo as JOINT=CHANNEL:EFFECT_OF_A_LONGER_PULSE, such as jaw=0:opens; "
            "once for each servo. With two buses of hobby servos: BUS/JOINT=..., lips/jaw=0:opens.",
        ),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Ask no questions.")] = False,
    page: Annotated[
        bool, typer.Option("--page", help="Set up the face on a web page, up to its first words.")
    ] = False,
    sim: Sim = None,
    open_page: OpenPage = False,
) -> None:
    """Write the YAML file of a face: serial servos are found, hobby servos are named by you.

    Each servo found is moved by 3 degrees, so that you see which joint it is. With --ranges, put
    the face into its neutral pose by hand first: 0 degrees will be there. Hobby servos get narrow
    limits, 1400 to 1600 us, and are not moved. With --page all this happens on a web page, as do
    limits, calibration and first words; an existing YAML is continued there.
    """
    if page:
        others = {
            "--baud-rate": baud_rate != FIRST_BAUD_RATE, "--ranges": ranges, "--board": board,
            "--channel": channel, "--yes": yes,
        }  # fmt: skip
        if unfit := [name for name, value in others.items() if value]:
            raise typer.BadParameter(f"{', '.join(unfit)}: not with --page; leave it out")
        _serve_setup(output, port or [], bus or [], sim, open_page=open_page)
        return
    if open_page or sim:
        raise typer.BadParameter("--open and --sim need --page")
    from lipservo.runtime.servos.new_face import check_face_file, face_on_buses, parts_of
    from lipservo.settings.settings import parse_face

    check_face_file(output)
    parts = parts_of(bus or [], port or [], board or [], channel or [])
    if not parts:
        raise UserError("no port: give --port, or --bus KIND (maestro) if no board is plugged in")
    for given, name, is_wired in ((yes, "--yes", True), (ranges is not None, "--ranges", False)):
        if given and all(bool(part.kind.board_key) is not is_wired for part in parts.values()):
            raise UserError(f"{name} is not for a {next(iter(parts.values())).kind.name} bus")
    texts: dict[str, str] = {}
    names: list[str] = []
    for bus_name, part in parts.items():
        if bus_name:
            MESSAGES.print(f"bus {bus_name}, {part.kind.name}:")
        if part.kind.board_key:
            found = _wired_yaml(output, part, names, yes=yes)
        else:
            found = _found_yaml(output, part, names, baud_rate, ranges)
        texts[bus_name] = found
        names += parse_face(found, output.name).servos
    text = face_on_buses(output.stem, texts) if len(texts) > 1 else next(iter(texts.values()))
    parse_face(text, output.name)
    write_whole(output, text)
    then = "set limits in it, `lipservo setup-servos`"
    if any(part.kind.board_key for part in parts.values()):
        then = "neutral and limits, as its first lines say"
    RESULTS.print(f"{output}: {len(names)} joints. Next: {then}")


def _serve_setup(
    output: Path, ports: Sequence[str], kinds: Sequence[str], sim: str | None, *, open_page: bool
) -> None:
    """Serve the setup page of a new face until Ctrl-C; then its running step ends, torque off.

    output: the face's YAML. ports, kinds: of the bus, one each at most. sim: `pty`: simulated
    servos.
    """
    from firmware_bridge.bus_kinds import bus_kind
    from lipservo.access.token_file import read_token
    from lipservo.commands.run.dashboard import check_dashboard, serve_page
    from lipservo.commands.run.voice_choice import access_file

    check_dashboard()
    if len(ports) > 1 or len(kinds) > 1:
        raise UserError("--page sets up one bus; leave --page out for several")
    port, kind = next(iter(ports), None), next(iter(kinds), None)
    if sim not in (None, "pty") or (sim and (port or kind)):
        raise UserError("--sim only accepts `pty`, and not together with --port or --bus")
    if kind and output.exists():
        raise UserError(f"{output} names its bus already; leave --bus out")
    if kind and not (bus_kind(kind).board_key or port):
        raise UserError(f"no port: give --port, where the servos of --bus {kind} are")
    from lipservo.dashboard.child import bound_dashboard
    from lipservo.dashboard.face_link import FaceLink
    from lipservo.dashboard.first_hour.first_hour import FirstHour

    token_file = access_file(None, open_to_this_computer=False)
    token = read_token(None if token_file is None else str(token_file))
    setup = FirstHour(output, None if kind else port, token_file, simulated=sim is not None)
    with closing(setup) as hour, bound_dashboard(None, token) as bound:
        if kind:
            hour.choose_port(port, kind, simulated=False)
        link = FaceLink(hour.control_path, let_go=hour.let_go)
        serve_page(bound, link, token, open_page=open_page, hour=hour)


def _wired_yaml(output: Path, part: "NewBus", taken: Sequence[str], *, yes: bool) -> str:
    """Return the YAML of hobby servos, wired as given by --channel or by the user's answers.

    output: the YAML, whose stem names the face. part: the bus. taken: names of joints on other
    buses. yes: no prompts.
    """
    from lipservo.runtime.servos.new_face import (
        WiredJoint,
        check_wiring,
        parse_channel,
        pulse_face_yaml,
    )

    joints: list[WiredJoint] = []
    kind, board = part.kind, part.board

    def wired(board: str, joints: Sequence[WiredJoint]) -> str:
        """Return the YAML of joints on a board. Raises UserError or BusError if it lacks one."""
        text = pulse_face_yaml(output.stem, kind, part.port, board, joints)
        check_wiring(text, output.name)
        return text

    def check_board(board: str) -> str:
        wired(board, [WiredJoint("jaw", 0, "opens")])
        return board

    for each in part.channels:
        joints.append(parse_channel(each, joints, taken))
    if yes and not joints:
        raise UserError("no servos given; add --channel jaw=0:opens for each of them")
    if board is None:
        usual, check = kind.usual_board, refusing(check_board)
        what = f"Which {kind.board_key} has the {kind.name}"
        board = usual if yes else typer.prompt(what, default=usual, value_proc=check, err=True)
    while not part.channels:
        text = typer.prompt(
            "A servo, as in jaw=0:opens (Enter: no more)", "", err=True, show_default=False
        )
        if not text and joints:
            break
        try:
            joint = parse_channel(text, joints, taken)
            wired(board, [*joints, joint])
            joints.append(joint)
        except (UserError, BusError) as error:
            MESSAGES.print(str(error))
    return wired(board, joints)


def _found_yaml(
    output: Path, part: "NewBus", taken: Sequence[str], baud_rate: int, ranges: Path | None
) -> str:
    """Find the servos at the port, nudge each, ask for its joint; return the face's YAML text.

    output: the YAML, whose stem names the face. part: the bus. taken: names of joints on other
    buses. baud_rate: tried first. ranges: a LeRobot range file.
    """
    from calibration.capture.lerobot_ranges import by_id, read_ranges
    from lipservo.runtime.servos.new_face import FoundJoint, check_joint_name, face_yaml, nudge

    kind, port = part.kind, part.port
    if port is None:
        raise UserError("no port given; add --port, at which servos are searched for")
    tools = kind.workshop()
    recorded = {} if ranges is None else by_id(read_ranges(ranges))
    if not tools.CLEARS_MIDDLE:  # these servos keep their homing offset, as in the recording
        recorded = {key: replace(each, homing_offset_ticks=0) for key, each in recorded.items()}
    rate, found = tools.find_unknown(port, baud_rate)
    MESSAGES.print(f"{len(found)} servos at {rate:,} baud: ids {', '.join(map(str, found))}")
    for servo_id in sorted(set(recorded) - set(found)):
        MESSAGES.print(f"id {servo_id} ({recorded[servo_id].name} in {ranges}) does not answer")
    _clear_foreign(tools, port, rate, found)
    joints: list[FoundJoint] = []
    for servo_id, model in found.items():
        tick, motion, _ = nudge(tools, port, rate, servo_id, model)
        joint_range, names = recorded.get(servo_id), [*taken, *(joint.name for joint in joints)]
        name = typer.prompt(
            f"id {servo_id} ({model}) {motion}. Which joint",
            default=joint_range.name if joint_range else None,
            value_proc=refusing(partial(check_joint_name, taken=names)),
            err=True,
        )
        word = typer.prompt("What should a positive angle do (opens, raises, widens ...)", err=True)
        same = typer.confirm("Did its first move do that", default=True, err=True)
        joint = FoundJoint(name, servo_id, model, word, 1 if same else -1)
        if joint_range is not None:
            servo_model = tools.servo_models()[model]
            turns = joint_range.is_whole(servo_model.n_positions) and typer.confirm(
                f"The recorded range of {name} is all that the servo has, as where nobody moved "
                f"it. Can {name} really turn so far (no: {joint.min_deg:g} to {joint.max_deg:g} "
                "deg)",
                default=False,
                err=True,
            )
            joint = joint.within(joint_range, tick, servo_model, turns_all_the_way=turns)
        joints.append(joint)
    return face_yaml(output.stem, kind, port, rate, joints)


def _clear_foreign(tools: Any, port: str, rate: int, found: Mapping[int, str]) -> None:
    """Show settings that other programs wrote into the servos, and reset them if the user agrees.

    tools: functions for single servos of this kind of bus. rate: baud. found: models by id. Raises
    UserError if the user refuses; nothing is written then.
    """
    foreign = tools.foreign_settings(port, rate, found)
    if not foreign:
        return
    for servo_id, changes in foreign.items():
        MESSAGES.print(f"id {servo_id}: {'; '.join(map(str, changes))}")
    question = "Set up for another face, or by another program. Write what they should be"
    if not typer.confirm(question, default=True, err=True):
        raise UserError("nothing was written; with these settings the servos cannot be moved")
    tools.clear_foreign_settings(port, rate, found, foreign)
