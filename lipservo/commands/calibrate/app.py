"""The command group `lipservo calibrate`, with a sub-command for each step."""

from collections.abc import Iterable
from types import MappingProxyType

import typer

from lipservo.commands.lazy_group import Command, LazyGroup

_HERE = "lipservo.commands.calibrate"
_AT_PORT = "--config my_face.yaml --port /dev/ttyUSB0"
_FILE = "my_face.calibration.yaml"


_CONFIG = "--config my_face.yaml"
_SEEN = "--markers markers.csv"
#: Command, its module here, its line in the help, and an example of its arguments.
_OF_MOUTH = (
    ("plan", "by_files", "Write poses to move the robot through.", f"poses.csv {_CONFIG}"),
    ("fit", "by_files", "Fit from poses and the markers seen at them.",
     f"{_CONFIG} --plan poses.csv {_SEEN} -o {_FILE}"),
    ("grade", "by_files", "Grade a calibration by new poses.",
     f"{_FILE} {_CONFIG} --plan check.csv {_SEEN}"),
    ("measure", "on_servos", "Move the servos, watch the markers, fit.",
     f"{_AT_PORT} --tracker markers.csv -o {_FILE}"),
    ("guided", "on_servos", "Match mouth shapes by eye.", f"{_AT_PORT} -o {_FILE}"),
    ("unit", "on_servos", "Calibrate another unit of a design.",
     f"design.calibration.yaml {_AT_PORT} -o {_FILE}"),
    ("practise", "on_servos", "Calibrate a simulated robot.", "3 -o practice.calibration.yaml"),
    ("by-hand", "by_hand", "Pose the mouth by hand: limits, touch.", f"{_FILE} {_AT_PORT}"),
)  # fmt: skip
_STEPS = (
    ("pose", "on_servos", "Move to poses of a plan.", f"poses.csv 7 8 {_AT_PORT}"),
    ("lags", "on_servos", "Measure how late each servo is.", f"{_FILE} {_AT_PORT}"),
    ("touch", "on_servos", "Find again where the lips meet.", f"{_FILE} {_AT_PORT}"),
    ("trim", "written", "Change one mouth shape by hand.", f"{_FILE} P jaw -1"),
    ("show", "written", "Print what a calibration contains.", f"{_FILE} {_CONFIG}"),
)


def _commands(rows: Iterable[tuple[str, str, str, str]], section: str) -> dict[str, Command]:
    """Return commands by name, listed in the help under `section`.

    rows: name, module, line of help and example arguments of each.
    """
    return {
        name: Command(
            f"{_HERE}.{module}:{name.replace('-', '_')}", text, section, name == "trim",
            example=example,
        )
        for name, module, text, example in rows
    }  # fmt: skip


class CalibrateGroup(LazyGroup):
    """The sub-commands of `lipservo calibrate`, which map a speaker's mouth to servo angles."""

    prefix = "calibrate."
    table = MappingProxyType(
        {
            **_commands(_OF_MOUTH, "The mouth"),
            **_commands(_STEPS, "Single steps"),
            "neutral": Command(
                "lipservo.commands.build.jogging:neutral",
                "Bring every joint to its neutral.",
                "Single steps",
            ),
            "audio": Command(
                "lipservo.commands.run.calibrate_audio:calibrate_audio",
                "Measure how late a loudspeaker is.",
                "Single steps",
            ),
        }
    )


app = typer.Typer(name="calibrate", cls=CalibrateGroup)


@app.callback(invoke_without_command=True)
def calibrate(context: typer.Context) -> None:
    """Find how a speaker's mouth becomes angles of this robot's servos (docs/calibration.md)."""
    if context.invoked_subcommand is None:
        names = ", ".join(CalibrateGroup.table)
        raise typer.BadParameter(f"no step given; use one of {names}", ctx=context)
