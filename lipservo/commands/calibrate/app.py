"""The command group `lipservo calibrate`, with a sub-command for each step."""

from types import MappingProxyType

import typer

from lipservo.commands.lazy_group import Command, LazyGroup

_HERE = "lipservo.commands.calibrate"
_FACE = "The mouth"
_SINGLE = "Single steps"


class CalibrateGroup(LazyGroup):
    """The sub-commands of `lipservo calibrate`, which map a speaker's mouth to servo angles."""

    prefix = "calibrate."
    table = MappingProxyType(
        {
            "plan": Command(
                f"{_HERE}.by_files:plan",
                "Write poses to move the robot through.",
                _FACE,
                example="poses.csv --config my_face.yaml",
            ),
            "fit": Command(
                f"{_HERE}.by_files:fit",
                "Fit from poses and the markers seen at them.",
                _FACE,
                example="--config my_face.yaml --plan poses.csv --markers markers.csv -o "
                "my_face.calibration.yaml",
            ),
            "grade": Command(
                f"{_HERE}.by_files:grade",
                "Grade a calibration by other poses.",
                _FACE,
                example="my_face.calibration.yaml --config my_face.yaml --plan check.csv --markers "
                "check_markers.csv",
            ),
            "measure": Command(
                f"{_HERE}.on_servos:measure",
                "Move the servos, watch the markers, fit.",
                _FACE,
                example="--config my_face.yaml --port /dev/ttyUSB0 --tracker markers.csv -o "
                "my_face.calibration.yaml",
            ),
            "guided": Command(
                f"{_HERE}.on_servos:guided",
                "Match mouth shapes by eye.",
                _FACE,
                example="--config my_face.yaml --port /dev/ttyUSB0 -o my_face.calibration.yaml",
            ),
            "practise": Command(
                f"{_HERE}.on_servos:practise",
                "Calibrate a simulated robot.",
                _FACE,
                example="3 -o practice.calibration.yaml",
            ),
            "by-hand": Command(
                f"{_HERE}.by_hand:by_hand",
                "Write the map joint by joint.",
                _FACE,
                example="my_face.calibration.yaml --config my_face.yaml --port /dev/ttyUSB0",
            ),
            "pose": Command(
                f"{_HERE}.on_servos:pose",
                "Hold one pose of a plan.",
                _SINGLE,
                example="poses.csv 7 8 --config my_face.yaml --port /dev/ttyUSB0",
            ),
            "lags": Command(
                f"{_HERE}.on_servos:lags",
                "Measure how late each servo is.",
                _SINGLE,
                example="my_face.calibration.yaml --config my_face.yaml --port /dev/ttyUSB0",
            ),
            "touch": Command(
                f"{_HERE}.on_servos:touch",
                "Find anew where the lips meet.",
                _SINGLE,
                example="my_face.calibration.yaml --config my_face.yaml --port /dev/ttyUSB0",
            ),
            "trim": Command(
                f"{_HERE}.written:trim",
                "Change one mouth shape by hand.",
                _SINGLE,
                takes_numbers=True,
                example="my_face.calibration.yaml P jaw -1",
            ),
            "show": Command(
                f"{_HERE}.written:show",
                "Draw what a calibration says.",
                _SINGLE,
                example="my_face.calibration.yaml --config my_face.yaml",
            ),
            "neutral": Command(
                "lipservo.commands.build.jogging:neutral",
                "Bring every joint to its neutral.",
                _SINGLE,
            ),
            "audio": Command(
                "lipservo.commands.run.calibrate_audio:calibrate_audio",
                "Measure how late a loudspeaker is.",
                _SINGLE,
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
