"""`builder-process`: one step of a new face's setup, led by a page; started by `new-face --page`.

It owns the servos' port while it runs. It ends, with torque off, when the page's server does.
"""

import json
import os
import sys
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from firmware_bridge.bus_kinds import bus_kind
from lipservo.commands.build.builder import FIRST_BAUD_RATE
from lipservo.commands.options import port_of
from lipservo.runtime.servos.face_stopped import exit_status
from lipsync.errors import UserError

if TYPE_CHECKING:
    from lipservo.calibrating.calibration_setup import CalibrationSetup
    from lipservo.calibrating.measured_calibration import CalibrationResult
    from lipservo.terminal.page_line import PageLine

Request = Mapping[str, Any]


def builder_process(
    step: Annotated[str, typer.Argument(help="Step of the setup.")],
    request: Annotated[str, typer.Argument(help="Parameters of the step, a JSON object.")],
    parent: Annotated[int, typer.Option(help="Process id of the page's server.")],
) -> None:
    """Run one step of a new face's setup on the servos; JSON lines in and out."""
    from firmware_bridge.process.operating_system import die_with_parent, write_from_background

    die_with_parent()
    write_from_background()
    if os.getppid() != parent:  # the server ended before the line above took effect
        raise typer.Exit(1)
    from lipservo.terminal.page_line import PageLine

    page, parsed = PageLine(), json.loads(request)
    try:
        if step != "drawn":  # which needs no servos
            port_of(parsed["port"], None)
        _STEPS[step](parsed, page)
    finally:
        page.finish()


def _find_servos(request: Request, page: "PageLine") -> None:
    """Find the servos at the port; send the page their models and other programs' settings.

    With `clear` in the request these settings are reset.
    """
    tools, port = bus_kind(request["kind"]).workshop(), request["port"]
    rate, found = tools.find_unknown(port, FIRST_BAUD_RATE)
    foreign = tools.foreign_settings(port, rate, found)
    if request.get("clear"):
        tools.clear_foreign_settings(port, rate, found, foreign)
        foreign = {}
    page.tell(
        "found",
        rate=rate,
        servos={str(servo_id): model for servo_id, model in found.items()},
        foreign={str(servo_id): [str(each) for each in some] for servo_id, some in foreign.items()},
    )


def _nudge_servo(request: Request, page: "PageLine") -> None:
    """Move one servo by 3 degrees and back, and send the event `nudged` to the page."""
    from lipservo.runtime.servos.new_face import nudge

    tools, servo_id = bus_kind(request["kind"]).workshop(), request["id"]
    _, motion, moved = nudge(tools, request["port"], request["rate"], servo_id, request["model"])
    page.tell("nudged", id=servo_id, note=None if moved else f"servo id {servo_id} {motion}")


def _send_limp_angles(request: Request, page: "PageLine") -> None:
    """Switch torque off, and send the joints' angles (deg) to the page until it sends the key q."""
    from firmware_bridge.clock import MonotonicClock
    from firmware_bridge.loop.targets import MemoryTargetChannel
    from firmware_bridge.stopping import named_by_reason
    from lipservo.runtime.servos.assembly import load_settings
    from lipservo.runtime.servos.driven_face import ControlOptions, DriveOptions, driven_face
    from lipservo.runtime.servos.limp_servos import STEADY_READINGS, LimpPose, LimpServos
    from lipservo.runtime.status.silent_board import SilentBoard

    config = request["config"]
    settings = load_settings(config)[0].at_port(request["port"])
    clock = MonotonicClock()
    with ExitStack() as stack:
        board = stack.enter_context(SilentBoard.create(settings, config))
        control = ControlOptions(about={"config": config}, watched_fd=board.fileno)
        # A dry run: nothing here switches torque on, whatever clients request meanwhile.
        options = DriveOptions(dry_run=True, control=control)
        driven = stack.enter_context(driven_face(settings, clock, MemoryTargetChannel(), options))
        servos = LimpServos(settings, driven.bus, clock, list(settings.servos))
        report = servos.let_go()
        if not report.complete:
            raise UserError(
                f"torque off is NOT confirmed by {named_by_reason(report.unconfirmed)}; keep your "
                "hands away"
            )
        page.tell("limp", confirmed=report.confirmed)
        readings: deque[LimpPose] = deque(maxlen=STEADY_READINGS)
        for time_s, late in driven.life.ticks():
            readings.append(servos.read_pose())
            pose = servos.steady(readings)
            board.tell(driven.bridge, driven.bridge.tick(time_s, late))
            angles = zip(servos.names, pose.positions_deg.tolist(), strict=True)
            page.tell(
                "turned",
                deg={name: round(deg, 1) if deg == deg else None for name, deg in angles},
                obstacles=pose.obstacles,
            )
            if (page.next_order(0.0) or {}).get("key") == "q":
                return


def _jog_joints(request: Request, _page: "PageLine") -> None:
    """Hold the joints in neutral, to be moved by sliders of the page Servos, until stopped."""
    from firmware_bridge.clock import MonotonicClock
    from lipservo.runtime.servos.assembly import bus_for, load_settings
    from lipservo.runtime.servos.hand_driven import drive_by_hand

    settings = load_settings(request["config"])[0].at_port(request["port"])
    clock = MonotonicClock()
    bus = bus_for(settings, clock, may_jump=bool(request.get("may_jump")))
    raise typer.Exit(exit_status(*drive_by_hand(settings, request["config"], clock, bus=bus)))


def _write_servo_limits(request: Request, _page: "PageLine") -> None:
    """Write the YAML's limits into the servos. Raises typer.Exit unless each answers at its id."""
    from lipservo.commands.build.setup_servos import setup_servos

    with open(os.devnull) as null_device:
        sys.stdin = null_device  # nobody can be asked to connect one servo alone: that is an error
        setup_servos(port=request["port"], config=request["config"], dry_run=False)


def _calibration_setup(request: Request, page: "PageLine") -> "CalibrationSetup":
    """Return the calibration setup that the page requests, which reports progress to the page.

    Raises UserError if the files to read or write cannot be used.
    """
    from lipservo.calibrating.on_page import PageWatch
    from lipservo.commands.calibrate.making import check_files, load_setup

    config = request["config"]
    keep = Path(request["keep"])
    check_files(Path(request["output"]), keep=keep)
    setup = load_setup(
        config,
        None,
        keep=keep,
        quiet=True,
        lags=bool(request.get("lags")),
        accept=bool(request.get("accept")),
        config=config,
    )
    setup = replace(setup, settings=setup.settings.at_port(request["port"]))
    return replace(setup, watch=PageWatch(page, setup).watch)


def _calibrate_by_eye(request: Request, page: "PageLine") -> None:
    """Save a calibration fitted to mouth shapes that a person matches with the page's sliders."""
    from lipservo.calibrating.on_page import PageFront
    from lipservo.calibrating.posing import calibrate_by_eye
    from lipservo.commands.calibrate.making import save_so_far

    setup, simulated = _calibration_setup(request, page), bool(request.get("simulated"))
    result = calibrate_by_eye(
        setup,
        lambda face: PageFront(setup, page, face, simulated=simulated),
        lambda so_far: save_so_far(setup, so_far, Path(request["output"])),
    )
    _save_calibration(setup, result, request, page)


def _calibrate_measured(request: Request, page: "PageLine") -> None:
    """Move the servos through poses, measure markers, and save the calibration fitted to them."""
    from lipservo.calibrating.face_source import calibrate_seen
    from lipservo.commands.calibrate.making import mesh_options, resumable_poses, save_so_far

    setup, tracker = _calibration_setup(request, page), request["tracker"]
    mesh = mesh_options(None, request.get("eye_distance_mm"), request.get("camera") or "0")
    source = None if tracker == "computed" else tracker

    def save(so_far: "CalibrationResult") -> None:
        save_so_far(setup, so_far, Path(request["output"]))

    with resumable_poses(Path(request["output"]), setup.keep):
        _save_calibration(setup, calibrate_seen(setup, source, "x y z", mesh, save), request, page)


def _calibrate_drawn(request: Request, page: "PageLine") -> None:
    """Save a calibration fitted to the simulated face, for servos that report no positions."""
    from lipservo.calibrating.measured_calibration import fit_simulated_face

    setup = _calibration_setup(request, page)
    _save_calibration(setup, fit_simulated_face(setup), request, page)


def _save_calibration(
    setup: "CalibrationSetup", result: "CalibrationResult", request: Request, page: "PageLine"
) -> None:
    """Save the calibration, enter its file in the face's YAML, and send its report to the page."""
    from lipservo.calibrating.shown_calibration import closing_values, report_lines
    from lipservo.calibrating.within_speeds import speed_line, within_speeds
    from lipservo.commands.calibrate.making import saved
    from lipservo.settings.edited_yaml import edited

    output = Path(request["output"])
    calibration, kept_notes = saved(setup, result, output)
    edited(Path(request["config"]), {("calibration",): output.name}).write()
    # The file of the measurements so far is not needed any more.
    Path(request["keep"]).unlink(missing_ok=True)
    lines = report_lines(calibration, output.name, result.fit)
    lines.append(speed_line(within_speeds(setup.model, calibration, setup.settings)))
    page.tell(
        "graded",
        lines=lines,
        warnings=[*result.warnings, *kept_notes],
        closing=closing_values(calibration),
    )


def _run_daemon(request: Request, _page: "PageLine") -> None:
    """Run the command `daemon` with the request's face and port until that face is stopped."""
    from lipservo.commands.run.dashboard_beside import with_sounds
    from lipservo.commands.run.run import ANY_PORT, daemon
    from lipservo.runtime.run_request import DEFAULT_OUTPUT

    token = request.get("token_file")
    daemon(
        play=DEFAULT_OUTPUT if request.get("play") else None,
        listen=ANY_PORT,
        token_file=None if token is None else Path(token),
        open_to_this_computer=token is None,
        sounds=Path(str(with_sounds(None).sounds)),
        config=request["config"],
        port=request["port"],
        quiet=True,
    )


_STEPS: Final[Mapping[str, Callable[[Request, "PageLine"], None]]] = {
    "find": _find_servos,
    "nudge": _nudge_servo,
    "limits": _send_limp_angles,
    "jog": _jog_joints,
    "set_up": _write_servo_limits,
    "by_eye": _calibrate_by_eye,
    "measure": _calibrate_measured,
    "drawn": _calibrate_drawn,
    "speak": _run_daemon,
}
