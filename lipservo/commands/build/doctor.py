"""`doctor`: what is wrong between computer and servos, and what to do."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import typer

from firmware_bridge.errors import BusError

from lipservo.commands.options import DEFAULT_FACE, Config, Json, Port, port_of
from lipservo.terminal.output import RESULTS, print_json

if TYPE_CHECKING:
    from firmware_bridge.bus_kinds import Finding
    from lipservo.settings.settings import FaceSettings


def _examined(settings: "FaceSettings") -> "Iterator[Finding]":
    """What is found on each bus; where it cannot be reached, that too, and the next is examined."""
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


def doctor(port: Port = None, config: Config = DEFAULT_FACE, as_json: Json = False) -> None:
    """Examine port, adapter and every servo; say what is wrong and what to do. Changes nothing.

    Exit status 1 when something is bad.
    """
    from firmware_bridge.bus_kinds import Severity
    from lipservo.runtime.servos.assembly import load_settings

    settings, _ = load_settings(config)
    settings = settings.at_port(port_of(port, settings.servo_port or settings.bus.port))
    findings = []
    for finding in _examined(settings):
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
