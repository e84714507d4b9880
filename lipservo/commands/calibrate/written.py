"""`calibrate trim` and `calibrate show`, which change or print an existing calibration file."""

from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.calibrate.making import CalibrationFile
from lipservo.commands.options import Json
from lipservo.terminal.output import MESSAGES, RESULTS, print_json


def trim(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The calibration to change.")],
    viseme: Annotated[
        str | None, typer.Argument(help="A phoneme of the class, P for P B M.", show_default=False)
    ] = None,
    joint: Annotated[str | None, typer.Argument(help="Which joint.", show_default=False)] = None,
    deg: Annotated[
        float | None,
        typer.Argument(
            help="Degrees to add while the class is spoken; 0: none.", show_default=False
        ),
    ] = None,
) -> None:
    """Add degrees to a joint while a viseme class is spoken; without VISEME: show what is added."""
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
            help="Face whose rules between joints are shown too; its name, or a YAML file.",
            show_default=False,
        ),
    ] = None,
    plots: Annotated[
        Path | None,
        typer.Option(
            help="Folder for a picture of what is within reach (lipservo[plots]).",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Print what a calibration says: its grade, each servo, each viseme class, rules, trims."""
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
        drawn = draw_reach(plots, calibration)
        MESSAGES.print(f"plots drawn: {drawn}")
    if as_json:
        print_json({"calibration": str(file), **shown_values(calibration, rules)})
        return
    RESULTS.print(servo_table(calibration))
    if calibration.coverage:
        RESULTS.print(coverage_table(calibration))
    for line in shown_lines(calibration, str(file), rules):
        RESULTS.print(line)
