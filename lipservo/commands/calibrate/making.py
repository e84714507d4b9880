"""Options that the sub-commands of `calibrate` share, and their checks, loading and saving."""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.calibration import CalibrationError
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError, check_extra, check_inputs
from lipsync.output_file import check_output

if TYPE_CHECKING:
    from calibration.calibration import Calibration
    from lipservo.calibrating.calibration_setup import CalibrationSetup
    from lipservo.calibrating.face_source import MeshOptions
    from lipservo.calibrating.measured_calibration import CalibrationResult

Output = Annotated[Path, typer.Option("--output", "-o", help="Calibration file to write.")]
Markers = Annotated[
    Path | None,
    typer.Option(
        help="Marker positions recorded at the poses of the plan: a CSV or JSON file, or a folder "
        "of C3D files or of pictures."
    ),
]
Axes = Annotated[
    str,
    typer.Option(
        help="Axes in C3D files that point to the robot's left, up and forward, such as `x z -y`."
    ),
]
Poses = Annotated[int, typer.Option(min=1, help="Number of poses to move to.")]
Keep = Annotated[
    Path | None,
    typer.Option(
        help="File that keeps every captured pose, so that the same command continues after an "
        "interruption; default: FILE.poses beside the calibration FILE."
    ),
]
Lags = Annotated[bool, typer.Option(help="Measure how late each servo is; --no-lags: do not.")]
Speed = Annotated[
    float, typer.Option(min=5.0, max=400.0, help="Speed of the servos between poses, degrees/s.")
]
EyeDistance = Annotated[
    float | None,
    typer.Option(
        min=10.0,
        max=500.0,
        help="Distance between the outer corners of the robot's eyes, mm; default: in the face's "
        "YAML.",
    ),
]
Camera = Annotated[
    str, typer.Option(help="For --tracker camera: the camera's number or device, or a video file.")
]
CalibrationFile = Annotated[Path, typer.Argument(metavar="FILE", help="Calibration file.")]
Accept = Annotated[
    bool,
    typer.Option(
        "--accept",
        help="Warn, do not refuse, if a joint seems dead, the face's size odd or the grade bad.",
    ),
]


def load_setup(config: str, model: Path | None, /, **options: Any) -> "CalibrationSetup":
    """Return a face's settings and face model as a setup for calibration.

    model: the face model's file; None: the shipped one. Raises UserError, also without what a fit
    needs.
    """
    if config.endswith((".yaml", ".yml")):
        check_inputs(Path(config))
    check_extra("sklearn", "`lipservo calibrate`")
    from lipsync.animpho.units import in_layout, load_face_with_animphos
    from lipsync.markers import MARKERS_47

    # A model of other points is fitted through the markers that calibration knows.
    speaker = in_layout(load_face_with_animphos(model), MARKERS_47)
    from lipservo.runtime.servos.assembly import load_settings

    settings, _ = load_settings(config)
    from lipservo.calibrating.calibration_setup import CalibrationSetup

    return CalibrationSetup(settings, speaker, **options)


@contextmanager
def setup_at_port(
    setup: "CalibrationSetup", port: str | None, sim: str | None, config: str
) -> Iterator["CalibrationSetup"]:
    """Yield the setup with its servos at `port`, or at a port made for `--sim pty`.

    Unchanged if `port` and `sim` are None. config: the face to simulate.
    """
    from lipservo.runtime.servos.sim_process import servo_port

    with servo_port(port, sim, config) as actual_port:
        if actual_port is None:
            yield setup
        else:
            yield replace(setup, settings=setup.settings.at_port(actual_port))


def mesh_options(
    landmarker: Path | None, eye_distance_mm: float | None, camera: str = "0"
) -> "MeshOptions":
    """Return the options of a face tracker; its networks are opened only once it is used.

    landmarker: the tracker's file; None: the default one. eye_distance_mm: between the outer
    corners of the robot's eyes; None: not given. camera: its number or device, or a video file.
    """
    from lipservo.calibrating.face_source import MeshOptions
    from lipsync.video.face_tracker import open_tracker

    return MeshOptions(
        lambda: open_tracker(landmarker), eye_distance_mm, camera, landmarker is not None
    )


def is_calibration(head: bytes) -> bool:
    """Return whether a file with these first bytes is a calibration, damaged or not."""
    return b"model_checksum:" in head


def is_plan(head: bytes) -> bool:
    """Return whether a file with these first bytes is a plan of poses, by its column names."""
    columns = head.decode("utf-8-sig", errors="replace").split("\n", 1)[0].strip().split(",")
    return columns[0] == "pose" and any(column.endswith("_deg") for column in columns[1:])


def check_files(
    output: Path,
    *,
    keep: Path | None = None,
    inputs: Sequence[Path | None] = (),
) -> None:
    """Raise UserError unless all inputs can be read and all outputs can be written.

    keep: file for captured poses, which may exist.
    """
    check_inputs(*inputs)
    from lipservo.settings.sections import CALIBRATION_NAME

    if not re.match(CALIBRATION_NAME, output.name):
        raise UserError(f"{output}: a calibration's name must be like my_face.calibration.yaml")
    check_output(output, replaces=is_calibration, kind="calibration", inputs=inputs)
    if keep is not None and not keep.exists():
        check_output(keep)


def present_form(file: Path, before: "Calibration") -> "Calibration":
    """Return what `file` holds now, since trims may have been set while servos were measured.

    Raises CalibrationError if it is another calibration than `before`, as it was read then.
    """
    from calibration.files.calibration_file import load_calibration

    present = load_calibration(file)
    if present.origin != before.origin or present.servo_names != before.servo_names:
        raise CalibrationError(f"{file}: was replaced while servos were measured; measure again")
    return present


def keep_beside(output: Path, keep: Path | None) -> Path:
    """Return the file of captured poses: `keep`, or else one beside the calibration `output`."""
    return _beside(output, "poses") if keep is None else keep


def _beside(path: Path, suffix: str) -> Path:
    """Return the path of a file that goes with another: FILE and `previous` give FILE.previous."""
    return path.with_name(f"{path.name}.{suffix}")


@contextmanager
def resumable_poses(output: Path, keep: Path | None) -> Iterator[Path]:
    """Yield the file of captured poses, from which the same command, if run again, continues.

    keep: as the user named the file; None: a file beside the calibration `output`; when the block
    ends without an error, that file is renamed to `.previous`. A CalibrationError of the block is
    raised with a hint what to do with the poses.
    """
    poses_file = keep_beside(output, keep)
    if poses_file.exists():
        MESSAGES.print(f"{poses_file}: continues with the poses in it; delete it to begin anew")
    try:
        yield poses_file
    except CalibrationError as error:
        if not poses_file.exists():
            raise
        raise CalibrationError(
            f"{error}; the poses are kept in {poses_file}: run the same command again to continue, "
            "or delete that file to begin anew"
        ) from error
    if keep is None and poses_file.exists():
        poses_file.replace(_beside(poses_file, "previous"))


@contextmanager
def resumable_setup(
    setup: "CalibrationSetup",
    output: Path,
    keep: Path | None,
    port: str | None,
    sim: str | None,
    config: str,
) -> Iterator["tuple[CalibrationSetup, Callable[[CalibrationResult], None]]"]:
    """Yield the setup at its servos' port, and a function that saves an unfinished calibration.

    keep, output: as for `resumable_poses`, whose file the setup continues; port, sim, config: as
    for `setup_at_port`.
    """
    with resumable_poses(output, keep) as kept, setup_at_port(setup, port, sim, config) as at_port:
        at_port = replace(at_port, keep=kept)
        yield at_port, lambda so_far: save_so_far(at_port, so_far, output)


def saved(
    setup: "CalibrationSetup", result: "CalibrationResult", output: Path
) -> "tuple[Calibration, list[str]]":
    """Save a calibration to `output`, with the hand-made parts of the file that it replaces.

    Returns the calibration as saved, and notes on the parts kept. Raises UserError for a grade that
    is too bad, unless `setup.accept`; an unfinished form of this calibration in `output` is then
    replaced by the file that was there before, or removed.
    """
    calibration, notes, fault = _with_kept_parts(setup, result, output)
    earlier = _earlier_form(calibration, output)
    if fault is not None:
        if calibration.grade is not None and earlier is not None and earlier.grade is None:
            previous = _beside(output, "previous")
            if previous.exists():
                previous.replace(output)
            else:
                output.unlink()
        raise UserError(
            f"{output} is not written: {fault}; read the warnings, capture again, or save it "
            "anyway with --accept"
        )
    _save(calibration, output, earlier)
    return calibration, notes


def save_so_far(setup: "CalibrationSetup", result: "CalibrationResult", output: Path) -> None:
    """Save a calibration that is usable though not yet graded, or without the servos' lags.

    What would be refused in the end is not saved; nor is what is graded there already.
    """
    calibration, _, fault = _with_kept_parts(setup, result, output)
    if fault is not None:
        return
    earlier, previous = _earlier_form(calibration, output), _beside(output, "previous")
    if calibration.grade is not None or earlier is None or earlier.grade is None:
        if previous.exists() and not output.exists():  # `saved` must not restore what was deleted
            previous.replace(_beside(previous, "previous"))
        _save(calibration, output, earlier)
    MESSAGES.print(f"{output} is saved, and usable; what follows is added to it")


def _with_kept_parts(
    setup: "CalibrationSetup", result: "CalibrationResult", output: Path
) -> "tuple[Calibration, list[str], str | None]":
    """Return a calibration with the hand-made parts of the file `output` that it will replace.

    Also notes on these parts, and why the calibration is too bad to be saved, or None.
    """
    from calibration.fit.measured_grade import too_bad
    from lipservo.calibrating.hand_poses import with_kept_hand_parts

    calibration, notes = with_kept_hand_parts(result.calibration, setup.servos, output)
    is_accepted = result.fit is None or setup.accept
    return calibration, notes, None if is_accepted else too_bad(calibration)


def _save(calibration: "Calibration", output: Path, earlier: "Calibration | None") -> None:
    """Save a calibration; the file there becomes `.previous`, but not its own form `earlier`."""
    from calibration.files.calibration_file import save_calibration

    unfinished = earlier is not None and earlier.grade in (None, calibration.grade)
    save_calibration(calibration, output, keeps_previous=not unfinished)


def _earlier_form(calibration: "Calibration", output: Path) -> "Calibration | None":
    """Return what the file `output` holds if its map is that of `calibration`, else None."""
    from calibration.files.calibration_file import load_calibration
    from calibration.fit.measured_grade import map_checksum

    try:
        before = load_calibration(output)
    except CalibrationError:
        return None
    return before if map_checksum(before) == map_checksum(calibration) else None


def finish(
    setup: "CalibrationSetup",
    result: "CalibrationResult",
    output: Path,
    *,
    check_plan: Path | None = None,
    as_json: bool,
) -> None:
    """Save the calibration to `output`, and print its report.

    check_plan: file for poses by which it can be graded; None: not written.
    """
    from lipservo.calibrating.measured_calibration import jaw_check
    from lipservo.calibrating.shown_calibration import report_lines
    from lipservo.calibrating.within_speeds import speed_line, within_speeds

    fit = result.fit
    calibration, notes = saved(setup, result, output)
    next_step = None
    if check_plan is not None:
        from lipservo.calibrating.plan_poses import write_check_poses

        next_step = write_check_poses(setup, calibration, fit, check_plan, output)
    jaw_r = jaw_check(setup, calibration)
    speeds = within_speeds(setup.model, calibration, setup.settings)
    if as_json:
        from lipservo.calibrating.shown_calibration import measured_values

        report = {
            "calibration": str(output),
            "method": calibration.origin.method,
            "poses": calibration.origin.poses,
            **asdict(calibration.errors),
            **measured_values(calibration),
            "check_plan": None if check_plan is None else str(check_plan),
            "jaw_correlation": jaw_r,
            "warnings": result.warnings,
            "kept": notes,
            "within_speeds": asdict(speeds),
        }
        if fit is not None:
            report["left_out_pose_rms_mm"] = fit.face.left_out_rms_mm
        print_json(report)
        return
    for line in (*result.warnings, *notes):
        MESSAGES.print(line)
    for line in report_lines(calibration, str(output), fit):
        RESULTS.print(line)
    RESULTS.print(speed_line(speeds))
    if jaw_r is not None:
        RESULTS.print(f"the jaw goes with the speaker's: correlation {jaw_r:.2f}")
    if next_step is not None:
        RESULTS.print(next_step)
    if setup.settings.calibration != output.name:
        RESULTS.print(
            f"to use it, write `calibration: {output.name}` into the face's YAML, and keep both "
            "files in one folder",
        )
