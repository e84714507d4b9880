"""`doctor`: reports faults between computer and servos with remedies, and measures for a report."""

import json
import platform
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from firmware_bridge.errors import BusError
from firmware_bridge.process.runtime_folder import RUNS_FACES
from lipservo.commands.options import DEFAULT_FACE, Config, Json, Port, port_of
from lipservo.terminal.output import MESSAGES, RESULTS, complain, print_json
from lipsync.errors import UserError

if TYPE_CHECKING:
    from firmware_bridge.bus_kinds import Finding
    from lipservo.settings.settings import FaceSettings


#: The finding on systems other than Linux: the fault, and the remedy.
_OTHER_SYSTEM: Final = (
    f"{platform.system()} reaches no servo and runs no face: it lacks Unix sockets that name their "
    "peer, file locks of Linux, /proc",
    "render, export, film, align and fit here; run the face on Linux: a Raspberry Pi, WSL 2",
)


def _check_bus(settings: "FaceSettings") -> "Iterator[Finding]":
    """Yield the findings on each bus; of several, one that cannot be reached is a finding, too.

    Raises BusError if the only bus cannot be reached.
    """
    from firmware_bridge.bus_kinds import Finding, Severity

    if not settings.buses:
        yield from settings.bus_kind.examine(settings.wiring)
    for name, one in settings.alone.items() if settings.buses else ():
        if one.servo_port is None:
            yield Finding(Severity.GOOD, f"{name}: simulated in memory")
            continue
        try:
            for each in one.bus_kind.examine(one.wiring):
                yield replace(each, what=f"{name}: {each.what}")
        except BusError as error:
            yield Finding(Severity.BAD, f"{name}: {error}")


def _check_lags(settings: "FaceSettings", config: str) -> "Iterator[Finding]":
    """Yield a finding on mouth servos that report no position: whether their lags are known.

    Lag: how late the servo follows its goals, by the calibration. Nothing is yielded without such
    servos, or without a calibration.
    """
    from firmware_bridge.bus_kinds import Finding, Severity
    from lipservo.runtime.servos.assembly import assemble_face

    capabilities, names = settings.capabilities, list(settings.servos)
    blind = [name for name in settings.mouth_servos if not capabilities.of(names.index(name)).place]
    if not blind or settings.calibration is None:
        return
    calibration = assemble_face(config, None).calibration
    if calibration.following is None:
        yield Finding(
            Severity.WARNING,
            "how late these servos are is not known, and lips are late by as much: "
            f"{', '.join(blind)}",
            "film one (docs/calibration.md) and type it: `lipservo calibrate lags FILE --lag-ms "
            f"{blind[0]}=60`",
        )
        return
    lag_s = dict(zip(calibration.servo_names, calibration.following.lag_s.tolist(), strict=True))
    lags_text = ", ".join(f"{name} {1e3 * lag_s[name]:.0f} ms" for name in blind)
    yield Finding(
        Severity.GOOD, f"late by the calibration, which these servos cannot confirm: {lags_text}"
    )


def _check_cpu(settings: "FaceSettings", config: str) -> "Iterator[Finding]":
    """Yield findings on whether this computer is fast enough for the face; takes some seconds.

    Nothing for servos on several buses, which cannot be simulated by their bytes.
    """
    from firmware_bridge.bus_kinds import Finding, Severity
    from lipservo.commands.build.within_reach import face_cost, within_reach

    if settings.buses:
        return
    try:
        cost = face_cost(config, time.perf_counter)
    except (UserError, BusError) as error:
        what = f"what this computer can do for this face was not measured: {error}"
        yield Finding(Severity.WARNING, what)
        return
    yield from within_reach(cost, settings.rate_hz)


def doctor(
    port: Port = None,
    config: Config = DEFAULT_FACE,
    as_json: Json = False,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.json",
            help="Measure the hardware, and write a report for developers, without names or paths.",
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=1.0, max=600.0, help="Seconds that --report reads and writes.")
    ] = 5.0,
    move: Annotated[
        str | None, typer.Option(metavar="JOINT", help="With --report: joint to move.")
    ] = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="With --report: ask no questions; needed in a script.")
    ] = False,
) -> None:
    """Examine port, adapter and every servo; print each fault and its remedy.

    The last lines say whether this computer is fast enough: for live recognition, for the servo
    loop and up to which rate, for the dashboard. Exit status 1 if a finding is bad. Without
    --report nothing changes. --report switches torque off and reads and writes the servos for some
    seconds; if you agree, one joint then moves 5 degrees to and fro, within its limits.
    """
    from firmware_bridge.bus_kinds import Finding, Severity
    from lipservo.runtime.servos.assembly import load_settings

    settings, _ = load_settings(config)
    if not RUNS_FACES:
        _print_findings([Finding(Severity.BAD, *_OTHER_SYSTEM)], as_json=as_json)
    settings = settings.at_port(port_of(port, settings.servo_port or settings.bus.port))
    if report is not None:
        _make_report(settings, config, report, seconds=seconds, move=move, yes=yes, as_json=as_json)
        return
    if move is not None or yes:
        raise typer.BadParameter("--move and --yes need --report")
    found = (_check_bus(settings), _check_lags(settings, config), _check_cpu(settings, config))
    _print_findings(chain(*found), as_json=as_json)


def _print_findings(found: "Iterable[Finding]", *, as_json: bool) -> None:
    """Print findings as they come, or all as JSON. Raises typer.Exit with 1 where one is bad."""
    from firmware_bridge.bus_kinds import Severity

    findings = []
    for finding in found:
        findings.append(finding)
        if not as_json:
            mark = {0: "ok  ", 1: "warn", 2: "BAD "}[finding.severity]
            remedy = f" -> {finding.remedy}" if finding.remedy else ""
            RESULTS.print(f"{mark} {finding.what}{remedy}")
    n_bad = sum(finding.severity is Severity.BAD for finding in findings)
    if as_json:
        listed = [
            {"severity": f.severity.name.lower(), "what": f.what, "remedy": f.remedy}
            for f in findings
        ]
        print_json({"bad": n_bad, "findings": listed})
    if n_bad:
        raise typer.Exit(1)


def _make_report(
    settings: "FaceSettings",
    config: str,
    file: Path,
    *,
    seconds: float,
    move: str | None,
    yes: bool,
    as_json: bool,
) -> None:
    """Measure the hardware and write the report as JSON and text; if stopped, write nothing.

    file: the report, .json. seconds: of reading and writing. move: the joint to step; None: the
    first one, if the user agrees. yes: no questions. as_json: print the result as JSON. Raises
    typer.Exit with 1 where a finding is bad or the servos were not read and written.
    """
    from firmware_bridge.stop_signals import DeferredSignals, StopRequested
    from lipservo.health.hardware_report import about_face, as_text, examined, scrubbed, secrets_of
    from lipsync.output_file import check_output, written_whole

    if file.suffix != ".json":
        raise UserError(f"{file}: name the report like {file.stem or 'report'}.json")
    text_file = file.with_suffix(".txt")
    if move is not None and move not in settings.servos:
        raise UserError(f"this face has no joint {move!r}; it has {', '.join(settings.servos)}")
    joint = move or next(iter(settings.servos))
    for each in (file, text_file):
        check_output(each)
    # Secrets: names and paths, which the report must not contain.
    names, secrets = ", ".join(settings.servos), secrets_of(settings, config)
    _require_consent(f"The servos are let go, and what they hold falls: {names}. Go on", yes=yes)
    status = 0
    with DeferredSignals() as signals:
        try:
            report: dict[str, Any] = about_face(settings)
            MESSAGES.print("examining")
            report["findings"] = examined(settings, secrets, _check_bus)
            MESSAGES.print(f"reading and writing for {seconds:g} s")
            try:
                report["limp_loop"] = _measure_limp_loop(settings, seconds)
            except BusError as error:
                complain(f"{error}; the report has this, too")
                report["limp_loop"] = {"error": scrubbed(str(error), secrets)}
        except StopRequested as stop:
            status = 128 + stop.number
            with suppress(StopRequested), signals.finish_first():
                complain(f"stopped by {stop}; the servos are let go, and nothing was written")
    if status:
        raise typer.Exit(status)
    report["steps"] = None
    failure = report["limp_loop"].get("error")
    n_bad = sum(each["severity"] == "bad" for each in report["findings"])
    if failure is None and (move is not None or _wants_steps(joint, yes=yes)):
        if move is not None:
            _require_consent(_move_question(joint), yes=yes)
        report["steps"] = _measure_steps(settings, joint)
    with written_whole(file) as whole, written_whole(text_file) as text:
        whole.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n")
        text.write_text(as_text(report))
    if as_json:
        print_json({"bad": n_bad, "findings": report["findings"], "error": failure or ""})
    else:
        RESULTS.print(
            f"{file} and {text_file.name} ({n_bad} bad findings): read them, then send them "
            '(docs/hardware.md, "Tell us what yours does")'
        )
    if n_bad or failure is not None:
        raise typer.Exit(1)


def _move_question(joint: str) -> str:
    """Return the question, for a person, whether `joint` may be moved."""
    from lipservo.health.hardware_report import STEP_DEG

    return (
        f"All servos are held, and {joint} moves {STEP_DEG:g} degrees to and fro, three times, "
        "at most as fast as its YAML says. Keep your hands away. Move it"
    )


def _wants_steps(joint: str, *, yes: bool) -> bool:
    """Return whether the user agrees to steps of `joint`; False with `yes` or without terminal."""
    can_ask = not yes and sys.stdin.isatty()
    return can_ask and typer.confirm(_move_question(joint), default=False, err=True)


def _require_consent(question: str, *, yes: bool) -> None:
    """Raise UserError unless `yes`, or the question is confirmed at the terminal."""
    if not yes and not sys.stdin.isatty():
        raise UserError(f"{question}? No terminal can be asked; give --yes")
    if not yes and not typer.confirm(question, default=False, err=True):
        raise UserError("not confirmed, so nothing was done or written")


def _measure_limp_loop(settings: "FaceSettings", seconds: float) -> dict[str, Any]:
    """Switch torque off; read and write the limp servos for `seconds`, and return measurements.

    They are those of `hardware_report.limp_loop`, and `n_confirmed_limp`. Servos that do not
    confirm torque off are printed.
    """
    from firmware_bridge.clock import MonotonicClock
    from firmware_bridge.stopping import named_by_reason
    from lipservo.health.hardware_report import limp_loop
    from lipservo.runtime.servos.assembly import bus_for
    from lipservo.runtime.servos.limp_servos import LimpServos

    clock = MonotonicClock()
    with bus_for(settings, clock, strict=False) as bus:
        released = LimpServos(settings, bus, clock, list(settings.servos)).let_go()
        if settings.capabilities.confirmed_limp and not released.complete:
            MESSAGES.print(f"torque off is NOT confirmed: {named_by_reason(released.unconfirmed)}")
        report = limp_loop(bus, settings.rate_hz, seconds, clock)
    return {"n_confirmed_limp": len(released.confirmed), **report}


def _measure_steps(settings: "FaceSettings", joint: str) -> dict[str, Any]:
    """Step the joint to and fro; return its label, the tick rate (Hz), and how it answered.

    Answers are empty for a servo that reports no position. Raises FaceStopped when a person stops
    it, and what bus and bridge raise.
    """
    from firmware_bridge.clock import MonotonicClock
    from firmware_bridge.stopping import StopLevel
    from lipservo.health.hardware_report import N_STEPS, STEP_S, labels, step_answers, step_goals
    from lipservo.runtime.servos.held_face import HeldFace

    servo = settings.servos[joint]
    with HeldFace(settings, MonotonicClock(), joints=[joint], end=StopLevel.SOFT) as face:
        goals_deg = step_goals(servo.min_deg, servo.max_deg, face.rate_hz)
        rate_hz = face.rate_hz
        if settings.capabilities.place:
            seen_deg = face.drive(goals_deg, rate_hz)
            answers = step_answers(goals_deg[:, 0], seen_deg[:, 0], rate_hz)
        else:
            answers = []
            for goal_deg in goals_deg[:: round(STEP_S * rate_hz)]:
                face.lead(goal_deg)
                face.hold(STEP_S)
    report = face.life.report
    assert report is not None
    return {
        "servo": labels(settings)[list(settings.servos).index(joint)],
        "rate_hz": rate_hz,
        "n_steps": 2 * N_STEPS,
        "answers": answers,
        "n_let_go": len(report.confirmed) + len(report.released),
    }
