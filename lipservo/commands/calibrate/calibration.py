"""`calibrate` and `trim`: from any face's motion to this robot's servos."""

import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lipservo.commands.calibrate.calibration_options import (
    Axes,
    Guided,
    Keep,
    Lags,
    Markers,
    Output,
    Plan,
    Plots,
    Port,
    Practise,
    Ranges,
    Refine,
    Sim,
    Speed,
    TrackerSource,
)
from lipservo.commands.options import DEFAULT_FACE, Config, Json, Model, Quiet
from lipservo.settings.setting_types import CALIBRATION_NAME
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError
from lipsync.output_file import check_output

if TYPE_CHECKING:
    from lipservo.calibrating.calibration_ways import Result, Workplace

_POSES = 60


def calibrate(
    output: Output = None,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    plan: Plan = None,
    markers: Markers = None,
    refine: Refine = None,
    axes: Axes = "x y z",
    port: Port = None,
    sim: Sim = None,
    tracker: TrackerSource = None,
    practise: Practise = None,
    guided: Guided = False,
    poses: Annotated[int, typer.Option(help="How many poses are captured.")] = _POSES,
    keep: Keep = None,
    lags: Lags = True,
    speed: Speed = 30.0,
    ranges: Ranges = None,
    plots: Plots = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit servo angles to a talker's face, with errors on motion left out of the fit.

    On servos: --port with --tracker, or --guided by eye. By hand: --plan FILE writes the poses;
    record markers, and come back with --plan FILE --markers FILE. Without servos: --practise SEED,
    or nothing at all: the simulated face.
    """
    from calibration.files.calibration_file import is_calibration
    from lipservo.calibrating.calibration_ways import Workplace
    from lipservo.face.assembly import load_settings, settings_at_port
    from lipservo.face.sim_process import servo_port
    from lipsync.animpho.other_layout import in_layout
    from lipsync.animpho.units import load_face_with_animphos
    from lipsync.markers import MARKERS_47

    settings, _ = load_settings(config)
    if ranges is not None:
        from calibration.capture.lerobot_ranges import check_within_recorded, read_ranges

        limits = {name: (s.min_deg, s.max_deg) for name, s in settings.mouth_servos.items()}
        check_within_recorded(read_ranges(ranges), limits)
    face_model = in_layout(load_face_with_animphos(model), MARKERS_47)
    at = Workplace(settings, face_model, poses, keep, quiet or as_json, lags, speed_deg_s=speed)
    if plan is not None and (markers is None or refine is not None):
        _write_plan(at, plan, markers, refine, axes, as_json=as_json)
        return
    if output is None:
        raise typer.BadParameter("say where to write the calibration", param_hint="--output")
    _check_name(output)
    check_output(output, replaces=is_calibration, kind="calibration", inputs=[plan, markers])
    if keep is not None and not keep.exists():
        check_output(keep)
    if plots is not None:
        if guided or all(each is None for each in (markers, tracker, practise, port, sim)):
            raise typer.BadParameter(
                "needs measured markers; by eye and without a robot there are none",
                param_hint="--plots",
            )
        from lipservo.calibrating.coverage_plot import PICTURE
        from lipservo.terminal.pictures import check_folder

        check_folder(plots, [PICTURE])
    if markers is not None:
        if plan is None:
            raise typer.BadParameter("--markers needs the --plan it was recorded with")
        result = _from_files(at, plan, markers, axes)
    else:
        if port is not None and tracker is None and not guided:
            raise typer.BadParameter(
                "say who sees the markers: --tracker FILE, FOLDER or typed; or --guided by eye",
                param_hint="--port",
            )
        with servo_port(port, sim, config) as found_port:
            if found_port is not None:
                from dataclasses import replace

                at = replace(at, settings=settings_at_port(settings, found_port))
            result = _from_robot(
                at, tracker, axes, practise, guided=guided, over_wire=found_port is not None
            )
    _finish(at, result, output, plots, as_json=as_json)


def _check_name(output: Path) -> None:
    """A calibration that no face can name is of no use to anybody."""
    if not re.match(CALIBRATION_NAME, output.name):
        raise UserError(f"{output}: a face can only name a file such as my_face.calibration.yaml")


def _from_robot(
    at: "Workplace",
    tracker: str | None,
    axes: str,
    practise: int | None,
    *,
    guided: bool,
    over_wire: bool,
) -> "Result":
    from lipservo.calibrating.calibration_ways import (
        by_eye,
        by_practice,
        by_servos,
        by_simulated_face,
        by_simulated_skin,
        tracker_of,
    )

    if guided:
        return by_eye(at)
    if tracker is not None:
        return by_servos(at, tracker_of(at, tracker, axes))
    if over_wire:
        return by_simulated_skin(at, practise)
    if practise is not None:
        return by_practice(at, practise)
    return by_simulated_face(at)


def _write_plan(
    at: "Workplace",
    path: Path,
    markers: Path | None,
    refine: Path | None,
    axes: str,
    *,
    as_json: bool,
) -> None:
    """A first plan, or with markers of one a longer plan."""
    from calibration.capture.capture_plan import joined
    from calibration.capture.marker_files import is_plan, read_capture, read_plan, write_plan

    target = path if markers is None or refine is None else refine
    check_output(target, replaces=is_plan, kind="plan of poses", inputs=[markers])
    procedure = at.procedure()
    names = tuple(joint.name for joint in at.joints)
    if markers is None or refine is None:
        plan = procedure.whole_range_plan()
        then = f"--plan {path} --markers FILE -o FILE"
    else:
        capture = read_capture(path, markers, names, axes=axes)
        further = procedure.speech_plan(capture, max(1, procedure.n_of_speech))
        plan = joined(read_plan(path, names), further)
        then = f"--plan {refine} --markers {markers} -o FILE"
    write_plan(plan, target)
    if as_json:
        print_json({"plan": str(target), "poses": len(plan)})
    else:
        RESULTS.print(
            f"{target}: {len(plan)} poses. Reach each from the side it names, record the markers, "
            f"then `lipservo calibrate {then}`",
            soft_wrap=True,
        )


def _from_files(at: "Workplace", plan: Path, markers: Path, axes: str) -> "Result":
    from calibration.capture.marker_files import read_capture
    from lipservo.calibrating.calibration_ways import fit_capture

    names = tuple(joint.name for joint in at.joints)
    capture = read_capture(plan, markers, names, axes=axes)
    with MESSAGES.status("fitting", spinner="line"):
        return fit_capture(at, capture)


def _finish(
    at: "Workplace", result: "Result", output: Path, plots: Path | None, *, as_json: bool
) -> None:
    """Save, draw, and say how good it is."""
    from calibration.files.calibration_file import save_calibration
    from calibration.fit.report import report_lines
    from lipservo.calibrating.calibration_ways import jaw_check

    calibration, fit = result.calibration, result.fit
    save_calibration(calibration, output)
    if plots is not None:
        from lipservo.calibrating.coverage_plot import draw_coverage

        drawn = draw_coverage(plots, at.model, calibration, fit)
        MESSAGES.print(f"drawn: {drawn}", soft_wrap=True, highlight=False)
    jaw_r = jaw_check(at, calibration)
    if as_json:
        told = {
            "calibration": str(output),
            "method": calibration.origin.method,
            "poses": calibration.origin.poses,
            **asdict(calibration.errors),
            "coverage": {viseme: asdict(reach) for viseme, reach in calibration.coverage.items()},
            "jaw_correlation": jaw_r,
            "warnings": result.warnings,
        }
        if fit is not None:
            told["left_out_pose_rms_mm"] = fit.face.left_out_rms_mm
        print_json(told)
        return
    for line in result.warnings:
        MESSAGES.print(line, soft_wrap=True, highlight=False)
    for line in report_lines(calibration, str(output), fit):
        RESULTS.print(line, soft_wrap=True, highlight=False)
    if jaw_r is not None:
        RESULTS.print(f"the jaw goes with the talker's: correlation {jaw_r:.2f}")
    if at.settings.calibration != output.name:
        RESULTS.print(
            f"to use it, write `calibration: {output.name}` into the face's YAML, and keep both "
            "files in one folder",
            soft_wrap=True,
        )


def trim(
    file: Annotated[Path, typer.Argument(help="The calibration to change.")],
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
    from calibration.run.viseme_trim import trimmed

    calibration = load_calibration(file)
    if viseme is not None:
        if joint is None or deg is None:
            raise typer.BadParameter("give VISEME, JOINT and DEG, or none of them")
        calibration = trimmed(calibration, viseme, joint, deg)
        save_calibration(calibration, file)
    for name, degrees in calibration.trim.items():
        for servo, added_deg in zip(calibration.servo_names, degrees, strict=True):
            if added_deg:
                RESULTS.print(f"{name}: {servo} {added_deg:+g} deg", highlight=False)
    if not any(degrees.any() for degrees in calibration.trim.values()):
        RESULTS.print("no trims")
