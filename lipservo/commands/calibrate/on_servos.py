"""`calibrate measure`, `guided`, `practise`, `pose`, `lags` and `touch`, which move servos."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.simulated.robot_family import RobotFamily
from lipservo.commands.calibrate.making import (
    Accept,
    Axes,
    CalibrationFile,
    Camera,
    EyeDistance,
    Keep,
    Lags,
    Output,
    Poses,
    Speed,
    check_files,
    finish,
    keep_beside,
    load_setup,
    mesh_options,
    present_form,
    resumable_setup,
    setup_at_port,
)
from lipservo.commands.options import (
    DEFAULT_FACE,
    Config,
    Json,
    Landmarker,
    Model,
    Port,
    Quiet,
    Sim,
)
from lipservo.terminal.output import RESULTS, print_json, say_simulated
from lipsync.errors import check_inputs

if TYPE_CHECKING:
    from lipsync.arrays import Array

Tracker = Annotated[
    str | None,
    typer.Option(
        help="Source of markers: `camera`, or a .csv or .json file or a folder (of C3D files or "
        "pictures) that your tracker fills during the run."
    ),
]


def measure(
    output: Output,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    tracker: Tracker = None,
    axes: Axes = "x y z",
    landmarker: Landmarker = None,
    eye_distance_mm: EyeDistance = None,
    camera: Camera = "0",
    poses: Poses = 60,
    keep: Keep = None,
    lags: Lags = True,
    speed: Speed = 30.0,
    accept: Accept = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Move the servos through poses, measure markers at each, and fit a calibration to them.

    Unless you give --no-lags, each servo's lag is measured, too. With --sim pty and no --tracker
    the markers are computed: a rehearsal of everything but real skin.
    """
    if tracker is None and sim is None:
        raise typer.BadParameter(
            "no source of markers given; add --tracker camera, FILE or FOLDER, or use `lipservo "
            "calibrate guided` to do it by eye"
        )
    check_files(output, keep=keep_beside(output, keep))
    setup = load_setup(
        config,
        model,
        n_poses=poses,
        quiet=quiet or as_json,
        lags=lags,
        speed_deg_s=speed,
        accept=accept,
    )
    from lipservo.calibrating.face_source import calibrate_seen

    mesh = mesh_options(landmarker, eye_distance_mm, camera)
    with resumable_setup(setup, output, keep, port, sim, config) as (at_port, save):
        result = calibrate_seen(at_port, tracker, axes, mesh, save)
        finish(setup, result, output, as_json=as_json)


def guided(
    output: Output,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    keep: Keep = None,
    lags: Lags = True,
    speed: Speed = 30.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate without a tracker: you put the mouth into 14 named poses with keys, by eye.

    The result is coarser than with a tracker: millimetres are not known.
    """
    check_files(output, keep=keep_beside(output, keep))
    setup = load_setup(config, model, quiet=quiet or as_json, lags=lags, speed_deg_s=speed)
    from lipservo.calibrating.guided_calibration import calibrate_by_keys

    with resumable_setup(setup, output, keep, port, sim, config) as (at_port, save):
        finish(setup, calibrate_by_keys(at_port, save), output, as_json=as_json)


def unit(
    base: Annotated[
        Path, typer.Argument(metavar="BASE", help="Calibration file of another unit of the design.")
    ],
    output: Output,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    tracker: Tracker = None,
    axes: Axes = "x y z",
    landmarker: Landmarker = None,
    eye_distance_mm: EyeDistance = None,
    camera: Camera = "0",
    keep: Keep = None,
    speed: Speed = 30.0,
    accept: Accept = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Take a design's calibration over to another unit of it, or after a repair: at most 15 poses.

    With --tracker the servos make them; it needs the poses that BASE was measured by, BASE.poses
    or BASE.poses.previous. Without, you correct the design's poses by keys; then lips are closed
    until the servos' current rises, where they measure it.
    """
    from calibration.files.calibration_file import load_calibration

    design = load_calibration(base)
    check_files(output, keep=keep_beside(output, keep), inputs=[base])
    setup = load_setup(
        config, model, quiet=quiet or as_json, lags=False, speed_deg_s=speed, accept=accept
    )
    from lipservo.calibrating.unit_calibration import (
        Design,
        check_design,
        design_capture,
        unit_of_eye,
        unit_of_tracker,
    )

    check_design(setup, design, base)
    by_markers = tracker is not None or sim is not None
    learnt = Design.learnt(design, design_capture(base)) if by_markers else None
    mesh = mesh_options(landmarker, eye_distance_mm, camera)
    with resumable_setup(setup, output, keep, port, sim, config) as (at_port, _):
        if learnt is None:
            result = unit_of_eye(at_port, design)
        else:
            result = unit_of_tracker(at_port, learnt, tracker, axes, mesh)
        finish(at_port, result, output, as_json=as_json)


def practise(
    seed: Annotated[
        int, typer.Argument(metavar="SEED", min=0, help="Seed of the simulated robot.")
    ],
    output: Output,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    sim: Sim = None,
    family: Annotated[
        RobotFamily | None,
        typer.Option(
            help="Kind of robot. own: soft skin and backlash, for faces with face_sim's joint "
            "names; elastic: lips that touch, for any joints. Default: own if the names fit."
        ),
    ] = None,
    poses: Poses = 60,
    keep: Keep = None,
    lags: Lags = True,
    speed: Speed = 30.0,
    accept: Accept = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate a simulated robot that a random seed determines, for practice; no servo is needed.

    With --sim pty the command drives the simulated servos over a serial port, in real time.
    """
    check_files(output, keep=keep_beside(output, keep))
    setup = load_setup(
        config,
        model,
        n_poses=poses,
        quiet=quiet or as_json,
        lags=lags,
        speed_deg_s=speed,
        accept=accept,
    )
    from lipservo.calibrating.measured_calibration import practise_in_memory, practise_over_wire

    practise_on = practise_in_memory if sim is None else practise_over_wire
    with resumable_setup(setup, output, keep, None, sim, config) as (at_port, save):
        result = practise_on(at_port, seed, family, save)
        finish(setup, result, output, as_json=as_json)


def pose(
    plan: Annotated[
        Path, typer.Argument(metavar="PLAN", help="Plan file, as `calibrate plan` writes it.")
    ],
    poses: Annotated[
        list[int] | None,
        typer.Argument(
            metavar="[POSE]...",
            help="Numbers of the poses to take; default: all, in the order of the plan.",
        ),
    ] = None,
    config: Config = DEFAULT_FACE,
    port: Port = None,
    sim: Sim = None,
    speed: Speed = 30.0,
) -> None:
    """Move the servos to poses of a plan, one after the other; Enter goes to the next pose.

    This is for markers that you record yourself. Each joint comes from the side that the plan
    names, because of backlash. At the end all joints go to neutral, and torque is switched off.
    """
    check_inputs(plan)
    setup = load_setup(config, None, speed_deg_s=speed)
    from lipservo.calibrating.plan_poses import hold_plan_poses, read_poses
    from lipservo.terminal.keys import read_line

    numbers, chosen = read_poses(setup, plan, poses or ())

    def arrived(row: int, reached_deg: "Array") -> None:
        reached = zip(chosen.servo_names, reached_deg, chosen.goals_deg[row], strict=True)
        angles = ", ".join(f"{name} {deg:.1f} of {goal:.1f}" for name, deg, goal in reached)
        RESULTS.print(f"pose {numbers[row]}: {angles} deg")

    with setup_at_port(setup, port, sim, config) as at_port:
        if at_port.settings.capabilities.in_memory:
            say_simulated()
        hold_plan_poses(at_port, chosen, arrived, lambda: read_line("Enter when it is recorded"))


def lags(
    file: CalibrationFile,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    speed: Speed = 30.0,
    lag_ms: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=MS",
            help="JOINT=MS: lag of a servo without encoder, seen in a film; once for each servo.",
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how late each servo follows its goals, and store these lags in the calibration.

    Each joint moves to and fro, faster and faster, then in steps, for 14 s. The rest of the
    calibration does not change; the old file is kept as `.previous`. Servos without encoders cannot
    be measured: give their lags with --lag-ms (docs/calibration.md).
    """
    from calibration.calibration import CalibrationError
    from calibration.files.calibration_file import load_calibration, save_calibration

    before = load_calibration(file)
    check_files(file)
    setup = load_setup(config, model, quiet=quiet or as_json, speed_deg_s=speed)
    from lipservo.calibrating.measured_calibration import measure_lags, typed_lags
    from lipservo.calibrating.shown_calibration import following_lines, following_values

    if lag_ms:
        measured = typed_lags(setup, before, lag_ms)
    elif not setup.has_any_place:
        raise CalibrationError(
            "the mouth's servos report no position, so they cannot measure their lag: film one, "
            f"and give the lag, such as --lag-ms {setup.servos.names[0]}=60"
        )
    else:
        with setup_at_port(setup, port, sim, config) as at_port:
            measured = measure_lags(at_port, before)
    measured = replace(present_form(file, before), following=measured.following)
    save_calibration(measured, file)
    if as_json:
        print_json({"calibration": str(file), "servos": following_values(measured)})
        return
    for line in following_lines(measured):
        RESULTS.print(line)


def touch(
    file: CalibrationFile,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    tracker: Tracker = None,
    by_eye: Annotated[
        bool,
        typer.Option(
            "--by-eye",
            help="You watch, and press Enter where the lips meet; default for hobby servos.",
        ),
    ] = False,
    axes: Axes = "x y z",
    landmarker: Landmarker = None,
    eye_distance_mm: EyeDistance = None,
    camera: Camera = "0",
    speed: Speed = 30.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find again where the lips meet, within a minute, and write it into a calibration.

    The map from face to servo angles does not change; the old file is kept as `.previous`. Contact
    is detected by --tracker; without it by the servos' current, or by your eye if the servos do not
    measure current; with --sim pty by markers computed from the simulated servos.
    """
    from calibration.files.calibration_file import load_calibration, save_calibration

    before = load_calibration(file)
    check_files(file)
    setup = load_setup(config, model, quiet=quiet or as_json, speed_deg_s=speed)
    from lipservo.calibrating.face_source import tracker_source
    from lipservo.calibrating.touching import touch_by_current, touch_by_eye, touch_by_markers
    from lipservo.terminal.keys import read_key

    if by_eye and tracker is not None:
        raise typer.BadParameter("give --by-eye or --tracker, not both")

    with setup_at_port(setup, port, sim, config) as at_port:
        if tracker is not None or (sim is not None and not by_eye):
            mesh = mesh_options(landmarker, eye_distance_mm, camera)
            with tracker_source(at_port, tracker, axes, mesh) as make_tracker:
                new, later_mm = touch_by_markers(at_port, before, make_tracker)
        elif by_eye or not at_port.has_load:
            new, later_mm = touch_by_eye(at_port, before, read_key)
        else:
            new, later_mm = touch_by_current(at_port, before)
    save_calibration(replace(present_form(file, before), closure=new.closure), file)
    if as_json:
        print_json({"calibration": str(file), "contact_later_mm": later_mm})
        return
    how = "later" if later_mm >= 0.0 else "earlier"
    RESULTS.print(f"the lips meet {abs(later_mm):.2f} mm {how} than {file} said, which says so now")
