"""`calibrate plan`, `fit` and `grade`, which use files: for robots moved by other programs."""

from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.calibrate.making import (
    Accept,
    Axes,
    CalibrationFile,
    EyeDistance,
    Lags,
    Markers,
    Output,
    Poses,
    check_files,
    finish,
    is_plan,
    load_setup,
    mesh_options,
)
from lipservo.commands.options import DEFAULT_FACE, Config, Json, Landmarker, Model, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError, check_inputs
from lipsync.output_file import check_output


def plan(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Plan (CSV file) to write.")],
    config: Config = DEFAULT_FACE,
    model: Model = None,
    poses: Poses = 60,
    refine: Annotated[
        Path | None,
        typer.Option(
            metavar="PLAN",
            help="Plan at whose poses --markers were recorded. FILE gets these poses and more, of "
            "speech or of joints whose effect is still unclear.",
        ),
    ] = None,
    markers: Markers = None,
    axes: Axes = "x y z",
    landmarker: Landmarker = None,
    eye_distance_mm: EyeDistance = None,
    accept: Accept = False,
    as_json: Json = False,
) -> None:
    """Write poses to move a robot through: neutral, each joint alone, then all joints together."""
    if (refine is None) != (markers is None):
        raise typer.BadParameter("give both --refine PLAN and --markers FILE, or neither")
    check_inputs(refine, markers)
    check_output(file, replaces=is_plan, kind="plan of poses", inputs=[markers, refine])
    setup = load_setup(config, model, n_poses=poses)
    from calibration.capture.capture import joined
    from calibration.capture.marker_files import read_plan, write_plan

    procedure, names = setup.procedure(), setup.servos.names
    if refine is None or markers is None:
        new_plan = procedure.whole_range_plan()
        next_options = f"--plan {file} --markers FILE -o FILE"
    else:
        from lipservo.calibrating.face_source import read_recorded

        mesh = mesh_options(landmarker, eye_distance_mm)
        seen, capture = read_recorded(setup, refine, markers, axes, mesh)
        further, lines = procedure.further_plan(capture, seen.servos.positive, accept=accept)
        for line in lines:
            MESSAGES.print(line)
        new_plan = joined(read_plan(refine, names), further)
        next_options = f"--plan {file} --markers {markers} -o FILE"
    write_plan(new_plan, file)
    if as_json:
        print_json({"plan": str(file), "poses": len(new_plan)})
        return
    RESULTS.print(
        f"{file}: {len(new_plan)} poses. Reach each from the side it names (`lipservo calibrate "
        f"pose {file}` does), record the markers, then `lipservo calibrate fit {next_options}`",
    )


def fit(
    output: Output,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    plan: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Plan at whose poses --markers were recorded."),
    ] = None,
    markers: Markers = None,
    axes: Axes = "x y z",
    landmarker: Landmarker = None,
    eye_distance_mm: EyeDistance = None,
    lags: Lags = True,
    check_plan: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Also write ten new poses of speech to this file; `calibrate grade` measures the "
            "calibration at them.",
        ),
    ] = None,
    accept: Accept = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit a calibration to recorded markers; without --plan and --markers, to the simulated face.

    The errors printed are estimates until `calibrate grade` has measured them. Servo lags are found
    for simulated servos only; `calibrate lags` measures those of real servos.
    """
    if (plan is None) != (markers is None):
        raise typer.BadParameter("give --plan with --markers; `calibrate plan` writes one")
    if check_plan is not None and markers is None:
        raise typer.BadParameter(
            "--check-plan needs --markers, since nothing is measured on the simulated face"
        )
    check_files(output, inputs=[plan, markers])
    if check_plan is not None:
        if check_plan.resolve() == output.resolve():
            raise typer.BadParameter("--check-plan and -o are the same file; choose two names")
        check_output(check_plan, replaces=is_plan, kind="plan of poses", inputs=[plan, markers])
    setup = load_setup(config, model, quiet=quiet or as_json, lags=lags, accept=accept)
    if plan is None or markers is None:
        from lipservo.calibrating.measured_calibration import fit_simulated_face

        result = fit_simulated_face(setup)
    else:
        from lipservo.calibrating.face_source import read_recorded
        from lipservo.calibrating.measured_calibration import fit_capture
        from lipservo.calibrating.plan_poses import check_plan as check_goals

        check_goals(setup, plan)
        mesh = mesh_options(landmarker, eye_distance_mm)
        setup, capture = read_recorded(setup, plan, markers, axes, mesh)
        with MESSAGES.status("fitting", spinner="line"):
            result = fit_capture(setup, capture)
    finish(setup, result, output, check_plan=check_plan, as_json=as_json)


def grade(
    file: CalibrationFile,
    plan: Annotated[
        Path, typer.Option(metavar="FILE", help="Poses that `calibrate fit --check-plan` wrote.")
    ],
    markers: Annotated[
        Path,
        typer.Option(
            help="Markers recorded at these poses: CSV or JSON file, or a folder of C3D files or "
            "pictures."
        ),
    ],
    config: Config = DEFAULT_FACE,
    model: Model = None,
    axes: Axes = "x y z",
    landmarker: Landmarker = None,
    eye_distance_mm: EyeDistance = None,
    accept: Accept = False,
    as_json: Json = False,
) -> None:
    """Grade a calibration by markers recorded at ten new poses of speech; store the grade in it.

    If the grade is too bad the file stays unchanged, unless you give --accept.
    """
    from calibration.files.calibration_file import load_calibration, save_calibration

    before = load_calibration(file)
    check_files(file, inputs=[plan, markers])
    setup = load_setup(config, model, accept=accept)
    from calibration.fit.measured_grade import too_bad
    from lipservo.calibrating.face_source import picture_reader
    from lipservo.calibrating.plan_poses import check_face, grade_by_files
    from lipservo.calibrating.shown_calibration import (
        coverage_table,
        coverage_values,
        grade_values,
        report_lines,
    )

    check_face(setup, before, str(file))
    read = picture_reader(markers, setup, mesh_options(landmarker, eye_distance_mm))
    graded, warnings = grade_by_files(setup, before, plan, markers, axes=axes, read=read)
    for line in () if as_json else warnings:
        MESSAGES.print(line)
    fault = too_bad(graded)
    if fault is not None and not accept:
        raise UserError(
            f"{file} stays as it is: {fault}; check the markers, calibrate anew, or save it anyway "
            "with --accept"
        )
    save_calibration(graded, file)
    if as_json:
        grade, coverage = grade_values(graded), coverage_values(graded)
        print_json(
            {"calibration": str(file), "grade": grade, "coverage": coverage, "warnings": warnings}
        )
        return
    for line in report_lines(graded, str(file), None, with_servos=False):
        RESULTS.print(line)
    RESULTS.print(coverage_table(graded))
