"""`calibrate grade`: what a calibration made by files is worth, measured on a second visit."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.calibrate.calibration_options import (
    Accept,
    Axes,
    CalibrationFile,
    EyeDistance,
    Landmarker,
)
from lipservo.commands.calibrate.making import check_files, load_setup, mesh_options
from lipservo.commands.options import DEFAULT_FACE, Config, Json, Model
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError


def grade(
    file: CalibrationFile,
    plan: Annotated[
        Path, typer.Option(metavar="FILE", help="Poses that `calibrate fit --check-plan` wrote.")
    ],
    markers: Annotated[
        Path,
        typer.Option(help="Markers recorded at them: CSV, JSON, a folder of C3D or of pictures."),
    ],
    config: Config = DEFAULT_FACE,
    model: Model = None,
    axes: Axes = "x y z",
    landmarker: Landmarker = None,
    eye_distance_mm: EyeDistance = None,
    accept: Accept = False,
    as_json: Json = False,
) -> None:
    """Measure a calibration at ten poses of speech that were never fitted, and write its grade.

    A grade that is too bad is not written without --accept; the file is as it was then.
    """
    from calibration.files.calibration_file import load_calibration, save_calibration
    from calibration.fit.measured_grade import too_bad
    from calibration.fit.report import report_lines
    from lipservo.calibrating.face_source import reader_of
    from lipservo.calibrating.graded_by_files import check_face, grade_by_files
    from lipservo.calibrating.shown_calibration import coverage_table, coverage_values, grade_values

    before = load_calibration(file)
    setup = replace(load_setup(config, model), accept=accept)
    check_face(setup, before, str(file))
    check_files(file, inputs=[plan, markers])
    read = reader_of(markers, setup, mesh_options(landmarker, eye_distance_mm))
    found, warnings = grade_by_files(setup, before, plan, markers, axes=axes, read=read)
    for line in () if as_json else warnings:
        MESSAGES.print(line, soft_wrap=True, highlight=False)
    bad = too_bad(found)
    if bad is not None and not accept:
        raise UserError(
            f"{file} stays as it is: {bad}; look at the markers, calibrate anew, or take the grade "
            "as it is with --accept"
        )
    save_calibration(found, file)
    if as_json:
        grade, coverage = grade_values(found), coverage_values(found)
        print_json(
            {"calibration": str(file), "grade": grade, "coverage": coverage, "warnings": warnings}
        )
        return
    for line in report_lines(found, str(file), None, with_servos=False):
        RESULTS.print(line, soft_wrap=True, highlight=False)
    RESULTS.print(coverage_table(found))
