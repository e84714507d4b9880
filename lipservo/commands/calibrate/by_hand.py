"""`calibrate by-hand`: torque off, the lips moved with the fingers, poses kept in a calibration."""

import contextlib
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_bridge.stopping import ExitStatus, StopReport, named_by_reason
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
    from lipservo.runtime.servos.limp_servos import LimpServos
    from lipsync.arrays import Array


@dataclass(slots=True)
class _Session:
    """The poses made by hand (deg), and the report on torque off; None: not switched off yet."""

    made_deg: "Mapping[str, Array]"
    report: StopReport | None = None


def by_hand(
    file: CalibrationFile,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    port: Port = None,
    sim: Sim = None,
    keep: Annotated[
        Path | None,
        typer.Option(
            help="Keep each pose in this file at once; go on from it.", show_default=False
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Torque off, move the lips with your fingers, keep the pose: closed, widest, rounded, touched.

    Hobby servos, which report no position, are moved by keys instead. The poses go into the
    calibration: a touch pose and limits. The servos of the mouth are let go once you have agreed,
    and stay limp, whatever ends this. Exit status 3: not every servo has confirmed that.
    """
    from calibration.calibration import check_calibration, check_servo_memories
    from calibration.files.calibration_file import load_calibration, save_calibration

    before = load_calibration(file)
    check_files(file, keep=keep)
    setup = load_setup(config, model)
    check_calibration(before, setup.model, setup.servos.names, setup.settings.checksum)
    from firmware_bridge.stop_signals import DeferredSignals, StopRequested
    from lipservo.calibrating.guided_calibration import hand_poses_by_keys
    from lipservo.calibrating.hand_poses import pose_lines, with_hand_poses
    from lipservo.runtime.servos.assembly import servo_memories

    session, status = _Session(_kept(setup, keep)), 0
    with setup_at_port(setup, port, sim, config) as at, DeferredSignals() as signals:
        check_servo_memories(before, servo_memories(at.settings))
        try:
            if at.has_place:
                _pose(at, session, keep, signals)
            else:
                session.made_deg = hand_poses_by_keys(replace(at, keep=keep))
        except StopRequested as stop:
            status = 128 + stop.number
            complain(f"stopped by {stop}; {file} stays as it is" + _kept_text(session, keep))
        finally:
            with contextlib.suppress(StopRequested, OSError), signals.finish_first():
                _tell(session.report)
    if status:
        raise typer.Exit(status)
    # Trims may have been set while fingers were busy.
    after = with_hand_poses(load_calibration(file), setup.servos, session.made_deg, _cap_ma())
    save_calibration(after, file)
    if as_json:
        poses = {
            name: dict(zip(after.servo_names, deg.tolist(), strict=True))
            for name, deg in after.hand_poses.items()
        }
        print_json(
            {
                "calibration": str(file),
                "poses": poses,
                "torque_off": None if session.report is None else session.report.as_dict(),
            }
        )
    else:
        for line in pose_lines(before, after):
            RESULTS.print(line)
    if session.report is not None and not session.report.complete:
        raise typer.Exit(ExitStatus.UNCONFIRMED)


def _pose(
    at: "CalibrationSetup", session: _Session, keep: Path | None, signals: "DeferredSignals"
) -> None:
    """Switch torque off if the user agrees, and record hand poses in the session.

    Torque is switched off once more at the end. keep: file for each pose at once; None: none.
    Raises UserError if the user refuses.
    """
    from calibration.fit.guided import keep_poses
    from firmware_bridge.clock import Clock, MonotonicClock
    from lipservo.calibrating.hand_poses import HAND_POSES, Posing, pose_by_hand
    from lipservo.runtime.servos.assembly import bus_for, simulated_wire
    from lipservo.runtime.servos.limp_servos import LimpServos
    from lipservo.terminal.keys import PressedKeys

    names = at.servos.names

    def kept(made_deg: "Mapping[str, Array]") -> None:
        if keep is not None:
            keep_poses(made_deg, names, keep)

    with ExitStack() as stack:
        clock: Clock = MonotonicClock()
        if at.settings.capabilities.in_memory:
            say_simulated()
            simulated_bus, clock = simulated_wire(at.settings)
            bus: ServoBus = simulated_bus
        else:
            bus = bus_for(at.settings, clock)
        with signals.finish_first():
            stack.enter_context(bus)
        servos = LimpServos(at.settings, bus, clock)
        keys = stack.enter_context(PressedKeys())
        MESSAGES.print(
            f"The servos of the mouth ({', '.join(names)}) are let go now: what they hold falls. "
            "Hold the jaw with a hand. Space or Enter: let go. Any other key: leave all as it is.",
            soft_wrap=True, style="bold yellow",
        )  # fmt: skip
        key = None
        while key is None:
            key = keys.next_key(1.0)
        if key not in (" ", "\n", "\r"):
            raise UserError("nothing was let go, and nothing kept")
        with signals.finish_first():
            session.report = servos.let_go()
        stack.callback(_let_go_again, session, servos, signals)
        if not session.report.complete:
            raise UserError(
                f"torque off is NOT confirmed by {named_by_reason(session.report.unconfirmed)}; "
                "keep your hands away"
            )
        posing = Posing(HAND_POSES, dict(session.made_deg), kept, signals.finish_first)
        session.made_deg = posing.made_deg
        pose_by_hand(servos, at.servos, posing, keys, MESSAGES)


def _let_go_again(session: _Session, servos: "LimpServos", signals: "DeferredSignals") -> None:
    """Switch torque off once more, and store the servos' confirmations in the session."""
    with signals.finish_first():
        session.report = servos.let_go()


def _tell(report: StopReport | None) -> None:
    if report is not None:
        MESSAGES.print(f"{report.line()}; it stays off")


def _kept(setup: "CalibrationSetup", keep: Path | None) -> "Mapping[str, Array]":
    from calibration.fit.guided import kept_poses

    return {} if keep is None else kept_poses(setup.servos.names, keep)


def _kept_text(session: _Session, keep: Path | None) -> str:
    if keep is None or not session.made_deg:
        return ""
    return f"; {len(session.made_deg)} poses are in {keep}: the same command goes on"


def _cap_ma() -> float:
    from calibration.fit.measured import TOUCH_CURRENT_MA

    return TOUCH_CURRENT_MA
