"""`calibrate measure`, `guided` and `practise`: servos that are moved for a whole calibration."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from calibration.simulated.robot_family import RobotFamily
from lipservo.commands.calibrate.calibration_options import (
    Accept,
    Axes,
    Camera,
    EyeDistance,
    Keep,
    Lags,
    Landmarker,
    Output,
    Plots,
    Poses,
    Ranges,
    Speed,
)
from lipservo.commands.calibrate.making import (
    check_files,
    finish,
    load_setup,
    mesh_options,
    setup_at_port,
)
from lipservo.commands.options import DEFAULT_FACE, Config, Json, Model, Port, Quiet, Sim


def measure(
    output: Output,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    tracker: Annotated[
        str | None,
        typer.Option(
            help="Who sees the markers: `camera`, a .csv, .json or folder filled meanwhile, keys "
            "(`typed`).",
            show_default=False,
        ),
    ] = None,
    axes: Axes = "x y z",
    landmarker: Landmarker = None,
    eye_distance_mm: EyeDistance = None,
    camera: Camera = "0",
    poses: Poses = 60,
    keep: Keep = None,
    lags: Lags = True,
    speed: Speed = 30.0,
    ranges: Ranges = None,
    plots: Plots = None,
    accept: Accept = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Move the servos through poses, measure markers at each, fit, and find the servos' lags.

    With --sim pty and no --tracker the markers are computed: a rehearsal of all but the skin.
    """
    from lipservo.calibrating.face_source import is_seen_from_the_front, tracker_source
    from lipservo.calibrating.measured_calibration import (
        calibrate_on_computed_skin,
        calibrate_on_servos,
    )

    if tracker is None and sim is None:
        raise typer.BadParameter(
            "say who sees the markers: --tracker camera, FILE, FOLDER or typed; by eye it is "
            "`lipservo calibrate guided`"
        )
    setup = replace(
        load_setup(config, model, ranges),
        n_poses=poses,
        keep=keep,
        quiet=quiet or as_json,
        lags=lags,
        speed_deg_s=speed,
        accept=accept,
    )
    check_files(output, keep=keep, plots=plots)
    with setup_at_port(setup, port, sim, config) as at:
        if tracker is None:
            result = calibrate_on_computed_skin(at)
        else:
            mesh = mesh_options(landmarker, eye_distance_mm, camera)
            at = replace(at, sees_forward=not is_seen_from_the_front(Path(tracker), mesh))
            with tracker_source(at, tracker, axes, mesh) as make_tracker:
                result = calibrate_on_servos(at, make_tracker)
    finish(setup, result, output, plots=plots, as_json=as_json)


def guided(
    output: Output,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    keep: Keep = None,
    lags: Lags = True,
    speed: Speed = 30.0,
    ranges: Ranges = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """No tracker: put the mouth into 14 named poses with keys, by eye.

    Coarser than a measured calibration: nobody knows millimetres without a tracker.
    """
    from lipservo.calibrating.guided_calibration import calibrate_by_eye

    setup = replace(
        load_setup(config, model, ranges),
        keep=keep,
        quiet=quiet or as_json,
        lags=lags,
        speed_deg_s=speed,
    )
    check_files(output, keep=keep)
    with setup_at_port(setup, port, sim, config) as at:
        result = calibrate_by_eye(at)
    finish(setup, result, output, as_json=as_json)


def practise(
    seed: Annotated[int, typer.Argument(metavar="SEED", help="Which robot is drawn.")],
    output: Output,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    sim: Sim = None,
    family: Annotated[
        RobotFamily | None,
        typer.Option(
            help="own: rubber and play, for joints named as face_sim's; elastic: lips that stop "
            "each other, and more, for any joints. Default: own where it knows the names.",
            show_default=False,
        ),
    ] = None,
    poses: Poses = 60,
    keep: Keep = None,
    lags: Lags = True,
    speed: Speed = 30.0,
    plots: Plots = None,
    accept: Accept = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure a simulated robot drawn from a seed, of which nothing is known; no servo is needed.

    With --sim pty its servos are simulated to the byte and spoken to over a wire, at their speed.
    """
    from lipservo.calibrating.simulated_calibration import practise_in_memory, practise_over_wire

    setup = replace(
        load_setup(config, model),
        n_poses=poses,
        keep=keep,
        quiet=quiet or as_json,
        lags=lags,
        speed_deg_s=speed,
        accept=accept,
    )
    check_files(output, keep=keep, plots=plots)
    if sim is None:
        result = practise_in_memory(setup, seed, family)
    else:
        with setup_at_port(setup, None, sim, config) as at:
            result = practise_over_wire(at, seed, family)
    finish(setup, result, output, plots=plots, as_json=as_json)
