"""`calibrate by-hand`: torque off, the lips moved with the fingers, poses kept in a calibration."""

import contextlib
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_bridge.errors import BusError
from firmware_bridge.stopping import ExitStatus, StopReport
from lipservo.commands.calibrate.making import (
    CalibrationFile,
    check_files,
    load_setup,
    setup_at_port,
)
from lipservo.commands.options import DEFAULT_FACE, Config, Json, Model, Port, Sim
from lipservo.terminal.output import MESSAGES, RESULTS, complain, print_json, say_simulated
from lipsync.errors import UserError

if TYPE_CHECKING:
    from firmware_bridge.bus import ServoBus
    from firmware_bridge.stop_signals import DeferredSignals
    from lipservo.calibrating.calibration_setup import CalibrationSetup
    from lipsync.arrays import Array


def by_hand(
    file: CalibrationFile,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    keep: Annotated[
        Path | None,
        typer.Option(help="File that keeps each pose at once; the same command continues from it."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Torque off: pose the lips by hand (closed, widest, rounded, touching); keep the poses.

    Hobby servos, which report no position, are moved by keys instead. The poses become the limits
    and the touch pose of the calibration. The command asks before it switches off the servos of the
    mouth; they then stay limp, however the command ends. Exit status 3: not every servo has
    confirmed that.
    """
    from calibration.calibration import check_calibration, check_servo_memories
    from calibration.files.calibration_file import load_calibration, save_calibration

    before = load_calibration(file)
    check_files(file, keep=keep)
    setup = load_setup(config, model)
    check_calibration(before, setup.model, setup.servos.names, setup.settings.checksum)
    from calibration.fit.guided import kept_poses
    from calibration.fit.measured import TOUCH_CURRENT_MA
    from firmware_bridge.stop_signals import DeferredSignals, StopRequested
    from lipservo.calibrating.guided_calibration import hand_poses_by_keys
    from lipservo.calibrating.hand_poses import pose_lines, with_hand_poses
    from lipservo.runtime.servos.assembly import servo_memories

    releases: list[StopReport] = []  # outlives whatever ends the session; the last one counts
    status = 0
    kept_poses(setup.servos.names, keep)
    with setup_at_port(setup, port, sim, config) as at, DeferredSignals() as signals:
        check_servo_memories(before, servo_memories(at.settings))
        try:
            at = replace(at, keep=keep)
            made_deg = _pose_limp(at, releases, signals) if at.has_place else hand_poses_by_keys(at)
        except StopRequested as stop:
            status = 128 + stop.number
            n_kept = len(kept_poses(setup.servos.names, keep))
            kept = f"; {n_kept} poses are in {keep}: the same command goes on" if n_kept else ""
            complain(f"stopped by {stop}; {file} stays as it is{kept}")
        except (BusError, UserError) as error:
            status = 1
            complain("\n".join([str(error), *getattr(error, "__notes__", [])]))
        finally:
            with contextlib.suppress(StopRequested, OSError), signals.finish_first():
                for report in releases[-1:]:
                    advice = "it stays off" if report.complete else "keep your hands away"
                    MESSAGES.print(f"{report.line()}; {advice}")
    is_unconfirmed = bool(releases) and not releases[-1].complete
    if status:
        raise typer.Exit(ExitStatus.UNCONFIRMED if is_unconfirmed else status)
    # Trims may have been set while fingers were busy.
    try:
        after = with_hand_poses(load_calibration(file), setup.servos, made_deg, TOUCH_CURRENT_MA)
        save_calibration(after, file)
    except UserError as error:
        if not is_unconfirmed:
            raise
        complain(str(error))
        raise typer.Exit(ExitStatus.UNCONFIRMED) from error
    if as_json:
        poses = {
            name: dict(zip(after.servo_names, deg.tolist(), strict=True))
            for name, deg in after.hand_poses.items()
        }
        print_json(
            {
                "calibration": str(file),
                "poses": poses,
                "torque_off": releases[-1].as_dict() if releases else None,
            }
        )
    else:
        for line in pose_lines(before, after):
            RESULTS.print(line)
    if is_unconfirmed:
        raise typer.Exit(ExitStatus.UNCONFIRMED)


def _pose_limp(
    setup: "CalibrationSetup", releases: list[StopReport], signals: "DeferredSignals"
) -> "Mapping[str, Array]":
    """Switch torque off if the user agrees; return hand poses, (n_servos,) degrees by name.

    releases: gets a report each time torque was switched off, which is done once more at the end.
    signals: in whose `finish_first` no signal interrupts. Raises UserError if the user refuses, or
    not every servo confirms.
    """
    from rich.live import Live

    from firmware_bridge.clock import Clock, MonotonicClock
    from lipservo.calibrating.guided_calibration import LimpFront
    from lipservo.calibrating.hand_poses import HAND_POSES
    from lipservo.calibrating.posing import make_poses
    from lipservo.runtime.servos.assembly import bus_for, simulated_wire
    from lipservo.runtime.servos.limp_servos import LimpServos
    from lipservo.terminal.keys import PressedKeys

    with ExitStack() as stack:
        clock: Clock = MonotonicClock()
        if setup.settings.capabilities.in_memory:
            say_simulated()
            simulated_bus, clock = simulated_wire(setup.settings)
            bus: ServoBus = simulated_bus
        else:
            bus = bus_for(setup.settings, clock)
        with signals.finish_first():
            stack.enter_context(bus)
        servos = LimpServos(setup.settings, bus, clock)
        keys = stack.enter_context(PressedKeys())
        MESSAGES.print(
            f"The servos of the mouth ({', '.join(setup.servos.names)}) are let go now: what they "
            "hold falls. Hold the jaw with a hand. Space or Enter: let go. Any other key: leave "
            "all as it is.",
            soft_wrap=True, style="bold yellow",
        )  # fmt: skip
        while (key := keys.next_key(1.0)) is None:
            pass
        if key not in (" ", "\n", "\r"):
            raise UserError("nothing was let go, and nothing kept")

        def release() -> None:
            with signals.finish_first():
                releases.append(servos.let_go())

        release()
        stack.callback(release)
        if not releases[-1].complete:
            raise UserError("not every servo confirmed torque off, so nothing was kept")
        live = stack.enter_context(Live(console=MESSAGES, transient=True, auto_refresh=False))
        front = LimpFront(servos, setup.servos, keys, live, signals.finish_first)
        joints, undivided = setup.servos.joints, signals.finish_first
        return make_poses(joints, HAND_POSES, front, lambda _: None, setup.keep, undivided)
