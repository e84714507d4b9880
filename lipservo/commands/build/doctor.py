"""`doctor`: reports faults between computer, servos and microphone, with remedies."""

import platform
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Final

import typer

from firmware_bridge.errors import BusError
from firmware_bridge.process.runtime_folder import RUNS_FACES
from lipservo.commands.options import DEFAULT_FACE, Config, Json, Port, port_of
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
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


def _check_microphone(settings: "FaceSettings") -> "Iterator[Finding]":
    """Yield the findings on half a minute at the face's microphone. Raises SoundError."""
    from lipservo.health.listening import findings, listen
    from lipservo.runtime.run_request import DEFAULT_MICROPHONE
    from lipservo.runtime.sound import open_microphone
    from lipsync.recognition.network import load_shipped_weights

    sound = settings.sound
    with open_microphone(sound.input or DEFAULT_MICROPHONE, sound.channel) as source:
        MESSAGES.print(f"{source.name}: speak as to the robot, for half a minute")
        samples = listen(source, time.monotonic, time.sleep)
    yield from findings(samples, load_shipped_weights())


def doctor(
    port: Port = None,
    config: Config = DEFAULT_FACE,
    as_json: Json = False,
    listen: Annotated[
        bool, typer.Option("--listen", help="Examine the microphone instead: speak for 30 s.")
    ] = False,
) -> None:
    """Examine port, adapter and every servo; print each fault and its remedy.

    The last lines say whether this computer is fast enough: for live recognition, for the servo
    loop and up to which rate, for the dashboard. Nothing is changed.
    Exit status 1 if a finding is bad.
    """
    from firmware_bridge.bus_kinds import Finding, Severity
    from lipservo.runtime.servos.assembly import load_settings

    settings, _ = load_settings(config)
    if listen:
        _print_findings(_check_microphone(settings), as_json=as_json)
        return
    if not RUNS_FACES:
        _print_findings([Finding(Severity.BAD, *_OTHER_SYSTEM)], as_json=as_json)
    settings = settings.at_port(port_of(port, settings.servo_port or settings.bus.port))
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
