"""`calibrate pose` and `calibrate lags`: one step of a calibration by itself."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lipservo.commands.calibrate.calibration_options import CalibrationFile, Speed
from lipservo.commands.calibrate.making import check_files, load_setup, setup_at_port
from lipservo.commands.options import DEFAULT_FACE, Config, Json, Model, Port, Quiet, Sim
from lipservo.terminal.output import RESULTS, print_json, say_simulated

if TYPE_CHECKING:
    from lipsync.arrays import Array


def pose(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="Poses: `calibrate plan`.")],
    poses: Annotated[
        list[int] | None,
        typer.Argument(metavar="[POSE]...", help="Which of them; default: all, in their order."),
    ] = None,
    config: Config = DEFAULT_FACE,
    port: Port = None,
    sim: Sim = None,
    speed: Speed = 30.0,
) -> None:
    """Hold the servos in poses of a plan, each reached from the side it names; Enter: the next.

    For markers that are recorded by hand. At the end all go to neutral and are let go.
    """
    from lipservo.calibrating.plan_poses import read_poses, stand_in_poses
    from lipservo.terminal.keys import read_line

    setup = replace(load_setup(config, None), speed_deg_s=speed)
    numbers, chosen = read_poses(setup, plan, poses or ())

    def arrived(row: int, reached_deg: "Array") -> None:
        stands = zip(chosen.servo_names, reached_deg, chosen.goals_deg[row], strict=True)
        told = ", ".join(f"{name} {deg:.1f} of {goal:.1f}" for name, deg, goal in stands)
        RESULTS.print(f"pose {numbers[row]}: {told} deg", soft_wrap=True)

    with setup_at_port(setup, port, sim, config) as at:
        if at.settings.bus.kind == "simulated":
            say_simulated()
        stand_in_poses(at, chosen, arrived, lambda: read_line("Enter when it is recorded"))


def lags(
    file: CalibrationFile,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    speed: Speed = 30.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find how late each servo follows, by chirps and steps, and write it into a calibration.

    The map stays; the file that was there is kept as `.previous`. 14 s for each joint.
    """
    from calibration.calibration import CalibrationError
    from calibration.files.calibration_file import load_calibration, save_calibration
    from calibration.fit.report import following_lines
    from lipservo.calibrating.servo_lags import measure_lags
    from lipservo.calibrating.shown_calibration import following_values

    before = load_calibration(file)
    setup = replace(load_setup(config, model), quiet=quiet or as_json, speed_deg_s=speed)
    check_files(file)
    with setup_at_port(setup, port, sim, config) as at:
        found = measure_lags(at, before)
    # Trims may have been set while servos chirped.
    now = load_calibration(file)
    if now.origin != before.origin or now.servo_names != before.servo_names:
        raise CalibrationError(f"{file}: was replaced while servos chirped, and stays as it is")
    found = replace(now, following=found.following)
    save_calibration(found, file)
    if as_json:
        print_json({"calibration": str(file), "servos": following_values(found)})
        return
    for line in following_lines(found):
        RESULTS.print(line, soft_wrap=True, highlight=False)
