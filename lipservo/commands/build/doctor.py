"""`doctor`: what is wrong between computer and servos, and what to do."""

import typer

from lipservo.commands.options import DEFAULT_FACE, Config, Json, Port, port_of
from lipservo.terminal.output import RESULTS, print_json


def doctor(port: Port = None, config: Config = DEFAULT_FACE, as_json: Json = False) -> None:
    """Examine port, adapter and every servo; say what is wrong and what to do. Changes nothing.

    Exit status 1 when something is bad.
    """
    from firmware_bridge.dynamixel.doctor import Severity, examine
    from firmware_bridge.dynamixel.provisioning import UNHURRIED_S
    from firmware_bridge.dynamixel.wire.line import Line
    from firmware_bridge.dynamixel.wire.serial_transport import latency_timer_ms, open_port
    from lipservo.runtime.servos.assembly import load_settings, mounted_servos

    settings, _ = load_settings(config)
    name = port_of(port, settings.bus.port)
    transport = open_port(name, settings.bus.baud_rate)
    try:
        findings = []
        line = Line(transport, extra_wait_s=UNHURRIED_S)
        servos, timer_ms = mounted_servos(settings), latency_timer_ms(name)
        for finding in examine(line, servos, settings.rate_hz, timer_ms):
            findings.append(finding)
            if not as_json:
                mark = {0: "ok  ", 1: "warn", 2: "BAD "}[finding.severity]
                remedy = f" -> {finding.remedy}" if finding.remedy else ""
                RESULTS.print(f"{mark} {finding.what}{remedy}", soft_wrap=True, highlight=False)
    finally:
        transport.close()
    n_bad = sum(finding.severity is Severity.BAD for finding in findings)
    if as_json:
        listed = [
            {"severity": f.severity.name.lower(), "what": f.what, "remedy": f.remedy}
            for f in findings
        ]
        print_json({"bad": n_bad, "findings": listed})
    if n_bad:
        raise typer.Exit(1)
