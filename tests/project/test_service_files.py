"""The files that make a service of a face: systemd unit and udev rule."""

import re
import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest
from every_command import every_command
from places import ROOT

from firmware_bridge.process.port_holders import END_OF_HUNG
from firmware_bridge.process.runtime_folder import SERVICE_FOLDER
from firmware_bridge.stopping import ExitStatus

CONFIG = resources.files("lipservo.config")
UNIT = (CONFIG / "lipservo.service").read_text()
RULES = (CONFIG / "60-lipservo-dynamixel.rules").read_text()


def command_of(key):
    """The arguments after the program in a line of the unit, `ExecStart` for one."""
    (line,) = re.findall(rf"^{key}=(.*)$", UNIT, re.MULTILINE)
    program, *arguments = line.removeprefix("-").split()
    assert Path(program).name == "lipservo"
    return arguments


@pytest.mark.parametrize("key", ["ExecStart", "ExecStopPost"])
def test_the_command_lines_of_the_unit_are_understood(key):
    """Parsed, not run; an unknown option or a bad value raises."""
    name, *arguments = command_of(key)
    command = dict(every_command())[f"lipservo {name}"]

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


#: Of `systemd-analyze security`, from 0 to 10: what it calls OK ends at 4.
MOST_EXPOSURE = 4.0


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_a_face_can_do_little_else_than_move_servos_and_speak():
    unit = ROOT / "config" / "lipservo.service"
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", str(unit)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if "unrecognized option" in done.stderr:
        pytest.skip("systemd before 250 judges running units only")
    (level,) = re.findall(r"exposure level for lipservo.service: ([0-9.]+)", done.stdout)

    assert float(level) <= MOST_EXPOSURE


def test_the_unit_leaves_a_face_what_it_needs():
    """Real-time scheduling, its state, sounds of the page, and every device that it drives."""
    devices = re.findall(r"^DeviceAllow=char-(\w+) rw$", UNIT, re.MULTILINE)

    assert SETTINGS["DevicePolicy"] == "closed"
    assert {"ttyUSB", "ttyACM", "ttyAMA", "i2c", "gpiochip", "alsa"} <= set(devices)
    assert int(SETTINGS["LimitRTPRIO"]) >= 50
    assert "RestrictRealtime" not in SETTINGS
    assert "MemoryDenyWriteExecute" not in SETTINGS, "a voice may be a program that compiles"
    assert "PrivateUsers" not in SETTINGS, "a stop says which user asked for it"
    assert {"AF_UNIX", "AF_INET", "AF_INET6"} == set(SETTINGS["RestrictAddressFamilies"].split())
    state = f"/var/lib/{SETTINGS['StateDirectory']}"
    assert f"LIPSERVO_STATE={state}" in SETTINGS["Environment"].split()


SETTINGS = dict(re.findall(r"^(\w+)=(.*)$", UNIT, re.MULTILINE))


def test_the_unit_gives_the_face_time_to_come_to_rest_and_restarts_it():
    assert SETTINGS["Type"] == "notify"
    assert SETTINGS["Restart"] == "on-failure"
    assert float(SETTINGS["WatchdogSec"]) >= 10.0
    # 5 s for the bridge, and 30 s for a port that is gone: firmware_bridge/process/supervisor.py
    assert float(SETTINGS["TimeoutStopSec"]) > 5.0 + 30.0


def test_a_stop_by_a_person_is_not_undone_by_systemd():
    prevented = SETTINGS["RestartPreventExitStatus"].split()

    final = (ExitStatus.UNCONFIRMED, ExitStatus.CRITICAL_SERVO_FAILED)
    assert {*(str(int(each)) for each in final), END_OF_HUNG.name} == set(prevented)


def test_a_login_user_who_may_open_the_port_finds_the_face_and_nobody_else_does():
    """The folder is the service's, for its group; the socket in it is for owner and group."""
    assert Path("/run") / SETTINGS["RuntimeDirectory"] == SERVICE_FOLDER
    assert SETTINGS["Group"] == "dialout"
    assert SETTINGS["RuntimeDirectoryMode"] == "0750"
    assert int(SETTINGS["UMask"], 8) & 0o070 == 0
    assert 'GROUP="dialout"' in RULES


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
