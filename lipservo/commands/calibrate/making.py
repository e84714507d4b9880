"""What the sub-commands that make a calibration have in common: before the work, and after it."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from lipservo.settings.setting_types import CALIBRATION_NAME
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError
from lipsync.output_file import check_output

if TYPE_CHECKING:
    from lipservo.calibrating.calibration_result import CalibrationResult
    from lipservo.calibrating.calibration_setup import CalibrationSetup
    from lipservo.calibrating.face_source import MeshOptions


def load_setup(config: str, model: Path | None, ranges: Path | None = None) -> "CalibrationSetup":
    """The face and the model. ranges: a LeRobot file that the face's limits must lie within."""
    from lipservo.calibrating.calibration_setup import CalibrationSetup
    from lipservo.face.assembly import load_settings
    from lipsync.animpho.other_layout import in_layout
    from lipsync.animpho.units import load_face_with_animphos
    from lipsync.markers import MARKERS_47

    settings, _ = load_settings(config)
    if ranges is not None:
        from calibration.capture.lerobot_ranges import check_within_recorded, read_ranges

        limits = {name: (s.min_deg, s.max_deg) for name, s in settings.mouth_servos.items()}
        check_within_recorded(read_ranges(ranges), limits)
    # A model of other points is fitted through the markers that calibration knows.
    return CalibrationSetup(settings, in_layout(load_face_with_animphos(model), MARKERS_47))


@contextmanager
def setup_at_port(
    setup: "CalibrationSetup", port: str | None, sim: str | None, config: str
) -> Iterator["CalibrationSetup"]:
    """The same with its servos at the port asked for, or at one made for `--sim pty`."""
    from lipservo.face.assembly import settings_at_port
    from lipservo.face.sim_process import servo_port

    with servo_port(port, sim, config) as found:
        if found is None:
            yield setup
        else:
            yield replace(setup, settings=settings_at_port(setup.settings, found))


def mesh_options(
    landmarker: Path | None, eye_distance_mm: float | None, camera: str = "0"
) -> "MeshOptions":
    """What was typed about a face mesh; its networks are opened only where one is used."""
    from lipservo.calibrating.face_source import MeshOptions
    from lipsync.video.tracking.trackers import open_tracker

    return MeshOptions(
        lambda: open_tracker(landmarker), eye_distance_mm, camera, landmarker is not None
    )


def check_files(
    output: Path,
    *,
    keep: Path | None = None,
    plots: Path | None = None,
    inputs: Iterable[Path | None] = (),
) -> None:
    """See before the work that everything can be written. Raises UserError."""
    from calibration.files.calibration_file import is_calibration

    if not re.match(CALIBRATION_NAME, output.name):
        raise UserError(f"{output}: a face can only name a file such as my_face.calibration.yaml")
    check_output(output, replaces=is_calibration, kind="calibration", inputs=inputs)
    if keep is not None and not keep.exists():
        check_output(keep)
    if plots is not None:
        from lipservo.calibrating.coverage_plot import PICTURE
        from lipservo.terminal.pictures import check_folder

        check_folder(plots, [PICTURE])


def finish(
    setup: "CalibrationSetup",
    result: "CalibrationResult",
    output: Path,
    *,
    plots: Path | None = None,
    check_plan: Path | None = None,
    as_json: bool,
) -> None:
    """Save, draw, write poses to grade by, and say how good it is."""
    from calibration.files.calibration_file import save_calibration
    from calibration.fit.measured_grade import too_bad
    from calibration.fit.report import report_lines
    from lipservo.calibrating.calibration_result import jaw_check
    from lipservo.calibrating.made_by_hand import with_hand_made

    fit = result.fit
    calibration, kept = with_hand_made(result.calibration, setup.servos, output)
    bad = None if fit is None else too_bad(calibration)
    if bad is not None and not setup.accept:
        raise UserError(
            f"{output} is not written: {bad}; look at the warnings, capture again, or take it as "
            "it is with --accept"
        )
    save_calibration(calibration, output)
    if plots is not None:
        from lipservo.calibrating.coverage_plot import draw_coverage

        drawn = draw_coverage(plots, setup.model, calibration, fit)
        MESSAGES.print(f"drawn: {drawn}", soft_wrap=True, highlight=False)
    then = None
    if check_plan is not None:
        from lipservo.calibrating.graded_by_files import write_check_poses

        then = write_check_poses(setup, calibration, fit, check_plan, output)
    jaw_r = jaw_check(setup, calibration)
    if as_json:
        from lipservo.calibrating.shown_calibration import coverage_values, grade_values

        lips = calibration.learnt_lips
        told = {
            "calibration": str(output),
            "method": calibration.origin.method,
            "poses": calibration.origin.poses,
            **asdict(calibration.errors),
            "coverage": coverage_values(calibration),
            "learnt_lips": None if lips is None else asdict(lips),
            "check_plan": None if check_plan is None else str(check_plan),
            "jaw_correlation": jaw_r,
            "warnings": result.warnings,
            "kept": kept,
            "grade": grade_values(calibration),
        }
        if fit is not None:
            told["left_out_pose_rms_mm"] = fit.face.left_out_rms_mm
        print_json(told)
        return
    for line in (*result.warnings, *kept):
        MESSAGES.print(line, soft_wrap=True, highlight=False)
    for line in report_lines(calibration, str(output), fit):
        RESULTS.print(line, soft_wrap=True, highlight=False)
    if jaw_r is not None:
        RESULTS.print(f"the jaw goes with the speaker's: correlation {jaw_r:.2f}")
    if then is not None:
        RESULTS.print(then, soft_wrap=True, highlight=False)
    if setup.settings.calibration != output.name:
        RESULTS.print(
            f"to use it, write `calibration: {output.name}` into the face's YAML, and keep both "
            "files in one folder",
            soft_wrap=True,
        )
