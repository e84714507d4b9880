"""`calibrate`: from any face's motion to this robot's servos, by the way that the robot allows."""

import datetime
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from lipservo.commands.options import DEFAULT_FACE, Config, Json, Model, Quiet
from lipservo.output import MESSAGES, RESULTS, print_json

if TYPE_CHECKING:
    from calibration.calibration import Calibration
    from calibration.capture import Capture
    from calibration.measured import MeasuredFit
    from lipservo.settings import FaceSettings
    from lipsync.animpho.model import FaceModel

_POSES = 60

Output = Annotated[
    Path | None,
    typer.Option("--output", "-o", help="The calibration to write.", show_default=False),
]
Plan = Annotated[
    Path | None,
    typer.Option(
        help="Poses (CSV). Without --markers: write them there, to move the robot through.",
        show_default=False,
    ),
]
Markers = Annotated[
    Path | None,
    typer.Option(
        help="Marker positions recorded at the poses of --plan: CSV, JSON, or a folder of C3D.",
        show_default=False,
    ),
]
Axes = Annotated[
    str, typer.Option(help="Axes of C3D files that point to the robot's left, up and forward.")
]
Practise = Annotated[
    int | None,
    typer.Option(
        metavar="SEED",
        help="Practise the measured way on a simulated robot drawn from a seed.",
        show_default=False,
    ),
]
Guided = Annotated[
    bool,
    typer.Option("--guided", help="No tracker: put the mouth into named poses with keys, by eye."),
]
Keep = Annotated[
    Path | None,
    typer.Option(
        help="Keep every captured pose in this file at once; go on from it.", show_default=False
    ),
]


def calibrate(
    output: Output = None,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    plan: Plan = None,
    markers: Markers = None,
    axes: Axes = "x y z",
    practise: Practise = None,
    guided: Guided = False,
    poses: Annotated[int, typer.Option(help="How many poses a plan has.")] = _POSES,
    keep: Keep = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit servo angles to a talker's face, with errors on motion left out of the fit.

    Measured: --plan FILE writes the poses; move the robot through them, record its markers, and
    come back with --plan FILE --markers FILE -o FILE. --practise SEED does it all on a simulated
    robot. --guided needs no tracker. With none of these the simulated face is fitted, which needs
    no measuring.
    """
    from lipservo.assembly import load_face_model, load_settings

    settings, _ = load_settings(config)
    if plan is not None and markers is None:
        _write_plan(settings, plan, poses, as_json=as_json)
        return
    if output is None:
        raise typer.BadParameter("say where to write the calibration", param_hint="--output")
    if not output.parent.is_dir():
        raise typer.BadParameter(f"{output.parent}: no such folder", param_hint="--output")
    face_model = load_face_model(model)
    if markers is not None:
        if plan is None:
            raise typer.BadParameter("--markers needs the --plan it was recorded with")
        _from_files(settings, face_model, plan, markers, axes, output, as_json=as_json)
    elif guided:
        _guided(settings, face_model, keep, output, as_json=as_json)
    elif practise is not None:
        _practise(settings, face_model, practise, poses, keep, output, as_json, quiet)
    else:
        _from_simulated_face(settings, face_model, output, as_json=as_json)


def _from_simulated_face(
    settings: "FaceSettings", model: "FaceModel", output: Path, *, as_json: bool
) -> None:
    from calibration.calibration_file import save_calibration
    from calibration.fitting import fit_calibration
    from calibration.joint_range import JointRange

    joints = [JointRange(n, s.min_deg, s.max_deg) for n, s in settings.mouth_servos.items()]
    with MESSAGES.status("fitting"):
        fitted = fit_calibration(model, joints, settings.checksum)
    save_calibration(fitted, output)
    if as_json:
        print_json({"calibration": str(output), **asdict(fitted.errors)})
    else:
        errors = fitted.errors
        RESULTS.print(
            f"{output}: on {errors.n_frames} frames left out the lips are "
            f"{errors.lip_rms_mm:.2f} mm off (the nearest poses of this face: "
            f"{errors.nearest_lip_rms_mm:.2f}), the lip gap {errors.gap_rms_mm:.2f} mm; "
            f"{errors.clipped_share:.1%} of the frames reach a limit",
            soft_wrap=True,
        )


def _write_plan(settings: "FaceSettings", path: Path, n_poses: int, *, as_json: bool) -> None:
    from calibration.capture_plan import plan_poses
    from calibration.joint_range import JointRange
    from calibration.marker_files import write_plan

    joints = [JointRange(n, s.min_deg, s.max_deg) for n, s in settings.mouth_servos.items()]
    write_plan(plan_poses(joints, n_poses), path)
    if as_json:
        print_json({"plan": str(path), "poses": n_poses})
    else:
        RESULTS.print(
            f"{path}: {n_poses} poses. Reach each from the side it names, record the markers, then "
            f"`lipservo calibrate --plan {path} --markers FILE -o FILE`",
            soft_wrap=True,
        )


def _from_files(
    settings: "FaceSettings",
    model: "FaceModel",
    plan: Path,
    markers: Path,
    axes: str,
    output: Path,
    *,
    as_json: bool,
) -> None:
    from calibration.marker_files import read_capture

    capture = read_capture(plan, markers, tuple(settings.mouth_servos), axes=axes)
    with MESSAGES.status("fitting"):
        fit = _fit(settings, model, capture)
    _finish(fit, fit.calibration, output, as_json=as_json)


def _guided(
    settings: "FaceSettings", model: "FaceModel", keep: Path | None, output: Path, *, as_json: bool
) -> None:
    from calibration.calibration_file import save_calibration
    from lipservo.guided_calibration import calibrate_by_eye

    fitted = calibrate_by_eye(settings, model, typer.getchar, MESSAGES, keep=keep)
    save_calibration(fitted, output)
    if as_json:
        print_json({"calibration": str(output), "method": "guided", "poses": fitted.origin.poses})
        return
    off_deg, servo = max(zip(fitted.errors.joint_rms_deg, fitted.servo_names, strict=True))
    RESULTS.print(
        f"{output}: from {fitted.origin.poses} poses made by eye. A pose left out is "
        f"{off_deg:.1f} deg off at most (rms, {servo}). On simulated robots such a map was 0.9 mm "
        "off in the median, a measured one 0.4 (docs/benchmarks.md)",
        soft_wrap=True,
    )


def _practise(
    settings: "FaceSettings",
    model: "FaceModel",
    seed: int,
    n_poses: int,
    keep: Path | None,
    output: Path,
    as_json: bool,
    quiet: bool,
) -> None:
    from dataclasses import replace

    from calibration.capture import capture_poses
    from calibration.capture_plan import plan_poses
    from calibration.joint_range import JointRange
    from calibration.servo_response import identify
    from calibration.simulated_robot import SimulatedRobot, draw_robot
    from calibration.simulated_servos import SimulatedServos
    from lipsync.markers import MARKER_NAMES

    joints = [JointRange(n, s.min_deg, s.max_deg) for n, s in settings.mouth_servos.items()]
    names = [joint.name for joint in joints]
    rest_mm = model.markers_mm(model.rest[None])[0]
    robot = SimulatedRobot(draw_robot(rest_mm, names, seed), noise_seed=seed)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=MESSAGES,
        transient=True,
        disable=quiet or as_json,
    ) as bar:
        task = bar.add_task("poses", total=n_poses)
        capture = capture_poses(
            plan_poses(joints, n_poses, seed=seed),
            MARKER_NAMES,
            robot.move,
            robot.measure,
            keep=keep,
            progress=lambda done: bar.update(task, completed=done),
        )
        bar.update(bar.add_task("fitting", total=None))
        fit = _fit(settings, model, capture)
        servos = SimulatedServos.drawn(len(joints), seed)
        following = identify(servos.encoders_deg, joints, fit.face.backlash_deg)
    _finish(fit, replace(fit.calibration, following=following), output, as_json=as_json)


def _fit(settings: "FaceSettings", model: "FaceModel", capture: "Capture") -> "MeasuredFit":
    from calibration.joint_range import JointRange
    from calibration.measured import fit_measured

    mouth = settings.mouth_servos
    return fit_measured(
        model,
        capture,
        [JointRange(n, s.min_deg, s.max_deg) for n, s in mouth.items()],
        settings.checksum,
        date=datetime.date.today().isoformat(),
        servo_models=tuple(servo.model for servo in mouth.values()),
        positive=[servo.positive for servo in mouth.values()],
    )


def _finish(fit: "MeasuredFit", calibration: "Calibration", output: Path, *, as_json: bool) -> None:
    from calibration.calibration_file import save_calibration
    from calibration.report import report_lines

    save_calibration(calibration, output)
    if as_json:
        coverage = {viseme: asdict(reach) for viseme, reach in calibration.coverage.items()}
        print_json(
            {
                "calibration": str(output),
                "method": calibration.origin.method,
                "poses": calibration.origin.poses,
                **asdict(calibration.errors),
                "left_out_pose_rms_mm": fit.face.left_out_rms_mm,
                "coverage": coverage,
                "warnings": fit.warnings,
            }
        )
        return
    for line in fit.warnings:
        MESSAGES.print(line, soft_wrap=True)
    for line in report_lines(fit, calibration, str(output)):
        RESULTS.print(line, soft_wrap=True, highlight=False)
