"""What needs no servo starts where Python has nothing of POSIX; the rest says so in one line."""

import json
import subprocess
import sys

import pytest
from places import ROOT

CLIP = str(ROOT / "lipservo" / "clips" / "welcome.flac")
NEEDS_LINUX = "servos and running faces need Linux; `lipservo doctor` says what works here"


def without_posix(*arguments):
    script = ROOT / "tests" / "project" / "without_posix.py"
    return subprocess.run(
        [sys.executable, str(script), *arguments], capture_output=True, text=True, check=False
    )


def test_every_command_is_imported_without_posix():
    done = without_posix("import-all")

    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("arguments", [["--help"], ["lines", "render", "--help"], ["devices"]])
def test_help_and_devices_start_without_posix(arguments):
    if arguments == ["devices"]:
        pytest.importorskip("sounddevice", reason="no PortAudio here", exc_type=OSError)
    assert without_posix(*arguments).returncode == 0


def test_a_line_is_rendered_and_exported_without_posix(tmp_path):
    rendered, exported = tmp_path / "line.perf", tmp_path / "line.json"

    assert without_posix("lines", "render", CLIP, "-o", str(rendered)).returncode == 0
    assert without_posix("export", CLIP, "-o", str(exported)).returncode == 0
    assert rendered.stat().st_size > 10_000
    assert json.loads(exported.read_text())["mouthCues"]


def test_doctor_says_what_another_system_lacks_and_what_works_there():
    done = without_posix("doctor", "--json")
    (finding,) = json.loads(done.stdout)["findings"]

    assert done.returncode == 1
    assert finding["severity"] == "bad"
    assert "no servo" in finding["what"]
    assert "render, export" in finding["remedy"]


@pytest.mark.parametrize("command", ["run --wav X", "daemon", "status", "stop", "sim-bus"])
def test_a_command_that_needs_linux_is_one_line(command):
    done = without_posix(*command.replace("X", CLIP).split())

    assert (done.returncode, done.stderr.strip()) == (1, f"lipservo: {NEEDS_LINUX}")
