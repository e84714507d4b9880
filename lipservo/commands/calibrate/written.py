"""`calibrate trim` and `calibrate show`, which change or print an existing calibration file."""

from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.calibrate.making import CalibrationFile
from lipservo.commands.options import Json
from lipservo.terminal.output import MESSAGES, RESULTS, print_json


def trim(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Calibration file to change.")],
    viseme: Annotated[
        str | None, typer.Argument(help="A phoneme of the viseme class; P stands for P, B and M.")
    ] = None,
    joint: Annotated[str | None, typer.Argument(help="Joint to trim.")] = None,
    deg: Annotated[
        float | None,
        typer.Argument(help="Degrees to add to the joint while the class is spoken; 0: no trim."),
    ] = None,
) -> None:
    """Add degrees to a joint while a viseme class is spoken; without VISEME: print these trims."""
    from calibration.files.calibration_file import load_calibration, save_calibration

    calibration = load_calibration(file)
    from calibration.run.compensation import trimmed
    from lipservo.calibrating.shown_calibration import trim_lines

    if viseme is not None:
        if joint is None or deg is None:
            raise typer.BadParameter("give all of VISEME, JOINT and DEG, or none")
        calibration = trimmed(calibration, viseme, joint, deg)
        save_calibration(calibration, file)
    for line in trim_lines(calibration):
        RESULTS.print(line, highlight=False)


def show(
    file: CalibrationFile,
    config: Annotated[
        str | None,
        typer.Option(
            help="Face (a name, or the path of a YAML file) whose rules between joints are also "
            "shown."
        ),
    ] = None,
    plots: Annotated[
        Path | None,
        typer.Option(
            help="Folder for a picture of the mouth shapes that the robot reaches (needs the "
            "extra `plots`)."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Print a calibration: grade, servos, viseme classes, rules between joints, and trims.

    Trims are degrees that `calibrate trim` has added.
    """
    from calibration.files.calibration_file import load_calibration

    calibration = load_calibration(file)
    from lipservo.calibrating.shown_calibration import (
        coverage_table,
        servo_table,
        shown_lines,
        shown_values,
    )

    rules = None
    if config is not None:
        from lipservo.runtime.servos.assembly import load_settings

        rules = load_settings(config)[0].prevent
    if plots is not None:
        from lipservo.calibrating.shown_calibration import PICTURE, draw_reach
        from lipservo.terminal.pictures import check_folder

        check_folder(plots, [PICTURE])
        MESSAGES.print(f"plots drawn: {draw_reach(plots, calibration)}")
    if as_json:
        print_json({"calibration": str(file), **shown_values(calibration, rules)})
        return
    RESULTS.print(servo_table(calibration))
    if calibration.coverage:
        RESULTS.print(coverage_table(calibration))
    for line in shown_lines(calibration, str(file), rules):
        RESULTS.print(line)
