"""The command group `lipservo calibrate`, with a sub-command for each step."""

from types import MappingProxyType

import typer

from lipservo.commands.lazy_group import Command, LazyGroup

_HERE = "lipservo.commands.calibrate"
_AT_PORT = "--config my_face.yaml --port /dev/ttyUSB0"
_FILE = "my_face.calibration.yaml"


def _of_mouth(target: str, text: str, example: str) -> Command:
    return Command(f"{_HERE}.{target}", text, "The mouth", example=example)


def _step(target: str, text: str, example: str, *, takes_numbers: bool = False) -> Command:
    return Command(target, text, "Single steps", takes_numbers=takes_numbers, example=example)


class CalibrateGroup(LazyGroup):
    """The sub-commands of `lipservo calibrate`, which map a speaker's mouth to servo angles."""

    prefix = "calibrate."
    table = MappingProxyType(
        {
            "plan": _of_mouth(
                "by_files:plan",
                "Write poses to move the robot through.",
                "poses.csv --config my_face.yaml",
            ),
            "fit": _of_mouth(
                "by_files:fit",
                "Fit from poses and the markers seen at them.",
                f"--config my_face.yaml --plan poses.csv --markers markers.csv -o {_FILE}",
            ),
            "grade": _of_mouth(
                "by_files:grade",
                "Grade a calibration by other poses.",
                f"{_FILE} --config my_face.yaml --plan check.csv --markers check_markers.csv",
            ),
            "measure": _of_mouth(
                "on_servos:measure",
                "Move the servos, watch the markers, fit.",
                f"{_AT_PORT} --tracker markers.csv -o {_FILE}",
            ),
            "guided": _of_mouth(
                "on_servos:guided", "Match mouth shapes by eye.", f"{_AT_PORT} -o {_FILE}"
            ),
            "practise": _of_mouth(
                "on_servos:practise",
                "Calibrate a simulated robot.",
                "3 -o practice.calibration.yaml",
            ),
            "by-hand": _of_mouth(
                "by_hand:by_hand", "Set touch pose and limits by hand.", f"{_FILE} {_AT_PORT}"
            ),
            "pose": _step(
                f"{_HERE}.on_servos:pose", "Hold one pose of a plan.", f"poses.csv 7 8 {_AT_PORT}"
            ),
            "lags": _step(
                f"{_HERE}.on_servos:lags", "Measure how late each servo is.", f"{_FILE} {_AT_PORT}"
            ),
            "touch": _step(
                f"{_HERE}.on_servos:touch", "Find anew where the lips meet.", f"{_FILE} {_AT_PORT}"
            ),
            "trim": _step(
                f"{_HERE}.written:trim",
                "Change one mouth shape by hand.",
                f"{_FILE} P jaw -1",
                takes_numbers=True,
            ),
            "show": _step(
                f"{_HERE}.written:show",
                "Draw what a calibration says.",
                f"{_FILE} --config my_face.yaml",
            ),
            "neutral": _step(
                "lipservo.commands.build.jogging:neutral", "Bring every joint to its neutral.", ""
            ),
            "audio": _step(
                "lipservo.commands.run.calibrate_audio:calibrate_audio",
                "Measure how late a loudspeaker is.",
                "",
            ),
        }
    )


app = typer.Typer(name="calibrate", cls=CalibrateGroup)


@app.callback(invoke_without_command=True)
def calibrate(context: typer.Context) -> None:
    """Find how a speaker's mouth becomes angles of this robot's servos (docs/calibration.md)."""
    if context.invoked_subcommand is None:
        names = ", ".join(CalibrateGroup.table)
        raise typer.BadParameter(f"say what to do: {names}", ctx=context)
