"""`new-face`: the servos that there are become the YAML of a face."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lipservo.commands.options import DEFAULT_FACE, Config, Port, RequiredPort
from lipservo.runtime.servos.face_stopped import exit_status
from lipservo.terminal.output import MESSAGES, RESULTS, say_simulated
from lipsync.errors import UserError
from lipsync.output_file import write_whole

if TYPE_CHECKING:
    from lipservo.runtime.servos.moving import Moved


def new_face(
    output: Annotated[Path, typer.Option("--output", "-o", help="The YAML to write.")],
    port: RequiredPort,
    baud_rate: Annotated[int, typer.Option(help="Try this rate first.")] = 1_000_000,
    ranges: Annotated[
        Path | None,
        typer.Option(help="LeRobot range file: names and limits by id.", show_default=False),
    ] = None,
) -> None:
    """Find the servos, move each by 3 degrees, ask for its name and direction, write the YAML.

    With --ranges, put the face into its neutral by hand before: that is where 0 degrees will be.
    """
    from calibration.capture.lerobot_ranges import by_id, read_ranges
    from firmware_bridge.bus_kinds import kind_at
    from lipservo.runtime.servos.new_face import (
        FoundJoint,
        check_face_file,
        check_joint_name,
        face_yaml,
        nudge,
    )
    from lipservo.settings.settings import parse_face

    check_face_file(output)
    tools = kind_at(port).workshop()
    recorded = {} if ranges is None else by_id(read_ranges(ranges))
    rate, found = tools.find_unknown(port, baud_rate)
    MESSAGES.print(f"{len(found)} servos at {rate:,} baud: ids {', '.join(map(str, found))}")
    _clear_foreign(tools, port, rate, found)
    joints: list[FoundJoint] = []
    for servo_id, model in found.items():
        tick = nudge(tools, port, rate, servo_id, model)
        known = recorded.get(servo_id)
        name = typer.prompt(
            f"id {servo_id} ({model}) moved by 3 degrees and back. Which joint",
            default=known.name if known else None,
            value_proc=partial(_joint_name, check_joint_name, [joint.name for joint in joints]),
            err=True,
        )
        word = typer.prompt("What should a positive angle do (opens, raises, widens ...)", err=True)
        same = typer.confirm("Did its first move do that", default=True, err=True)
        joint = FoundJoint(name, servo_id, model, word, 1 if same else -1)
        joints.append(joint if known is None else joint.within(known, tick))
    text = face_yaml(output.stem, port, rate, joints)
    parse_face(text, output.name)
    write_whole(output, text)
    RESULTS.print(
        f"{output}: {len(joints)} joints. Next: set limits in it, `lipservo setup-servos`",
    )


def _clear_foreign(tools: Any, port: str, rate: int, found: Mapping[int, str]) -> None:
    """Ask before what another program has written into the servos is taken back."""
    foreign = tools.foreign_settings(port, rate, found)
    if not foreign:
        return
    for servo_id, changes in foreign.items():
        MESSAGES.print(f"id {servo_id}: {'; '.join(map(str, changes))}")
    question = "Another program has set these up. Write what they should be"
    if not typer.confirm(question, default=True, err=True):
        raise UserError("nothing was written; servos set up like this cannot be moved here")
    tools.clear_foreign_settings(port, rate, found, foreign)


def _joint_name(check: Callable[[str, Sequence[str]], str], taken: Sequence[str], text: str) -> str:
    """An answer to the question for a joint's name; asked again where it cannot be one."""
    try:
        return check(text, taken)
    except UserError as error:
        raise typer.BadParameter(str(error)) from None
