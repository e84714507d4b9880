"""The files that make a service of a face: systemd unit and udev rule."""

import re
import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest
import typer

from lipservo.cli import app

CONFIG = resources.files("lipservo.config")
UNIT = (CONFIG / "lipservo.service").read_text()
RULES = (CONFIG / "60-lipservo-dynamixel.rules").read_text()


def command_of(key):
    """The arguments after the program in a line of the unit, `ExecStart` for one."""
    (line,) = re.findall(rf"^{key}=(.*)$", UNIT, re.MULTILINE)
    program, *arguments = line.split()
    assert Path(program).name == "lipservo"
    return arguments


@pytest.mark.parametrize("key", ["ExecStart", "ExecStop"])
def test_the_command_lines_of_the_unit_are_understood(key):
    """Parsed, not run; an unknown option or a bad value raises."""
    name, *arguments = command_of(key)
    command = typer.main.get_command(app).commands[name]

    assert command.make_context(name, arguments).params


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_has_nothing_to_say_against_the_unit(tmp_path):
    """With a program that exists in place of the installed one, which systemd looks for."""
    unit = tmp_path / "lipservo.service"
    unit.write_text(UNIT.replace("/opt/lipservo/bin/lipservo", sys.executable))
    done = subprocess.run(
        ["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False
    )

    assert (done.returncode, done.stderr) == (0, "")


def test_the_unit_gives_the_face_time_to_come_to_rest_and_restarts_it():
    settings = dict(re.findall(r"^(\w+)=(.*)$", UNIT, re.MULTILINE))

    assert settings["Type"] == "notify"
    assert settings["Restart"] == "on-failure"
    assert float(settings["WatchdogSec"]) >= 10.0  # a bridge may need 5 s to be shot and limp
    assert float(settings["TimeoutStopSec"]) > 2 * 5.0  # the supervisor waits 5 s for each child


MATCH_OR_SET = re.compile(r'([A-Z]+)(?:\{([A-Za-z_]+)\})?(==|!=|=|\+=|:=)"([^"]*)"')


@pytest.mark.parametrize(
    "rule", [line for line in RULES.splitlines() if line and not line.startswith("#")]
)
def test_a_rule_matches_before_it_sets_and_uses_known_keys(rule):
    """The grammar of udev(7); `udevadm verify` came with systemd 254."""
    parts = [MATCH_OR_SET.fullmatch(part.strip()) for part in rule.split(",")]

    assert all(parts), rule
    matches = [part[1] for part in parts if part[3] in ("==", "!=")]
    sets = [part[1] for part in parts if part[3] not in ("==", "!=")]
    assert set(matches) <= {"SUBSYSTEM", "ACTION", "DRIVER", "ATTRS", "KERNEL"}
    assert set(sets) <= {"GROUP", "MODE", "SYMLINK", "ATTR"}
    assert "SUBSYSTEM" in matches
    assert sets
