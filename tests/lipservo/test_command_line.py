"""What the command line says of itself, and how it says what is wrong."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from lipservo import cli, command_line
from lipservo.terminal.output import RESULTS
from lipsync.errors import UserError


def told(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    """The exit status of `lipservo` with these arguments."""
    monkeypatch.setattr(sys, "argv", ["lipservo", *arguments])
    with pytest.raises(SystemExit) as end:
        command_line.main()
    return end.value.code


def test_without_a_command_its_help_is_printed(monkeypatch, capsys):
    assert told(monkeypatch) == 0
    assert "Usage: lipservo" in capsys.readouterr().out


def test_it_knows_its_version(monkeypatch, capsys):
    assert told(monkeypatch, "--version") == 0
    assert capsys.readouterr().out == f"lipservo {version('lipservo')}\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("say", "x", "--rate-hz", "f"), "'--rate-hz': not a number; see `lipservo say --help`"),
        (("run", "--rate-hz", "50"), "--rate-hz: `rate_hz:` in the face's YAML says it now"),
        (("daemon", "--queue"), "--queue: `access.queue:` in the face's YAML says it now"),
        (("run", "--strength", "1"), "`lipservo set strength VALUE` changes it while the face"),
        (("run", "--zzz"), "No such option: --zzz; see `lipservo run --help`"),
        (("bench",), "Missing command; see `lipservo bench --help`"),
        (("run", "--wav", "a", "--mic"), "give --wav or --mic, not both"),
    ],
)
def test_wrong_usage_is_one_line_and_status_2(monkeypatch, capsys, arguments, said):
    assert told(monkeypatch, *arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("lipservo: ")
    assert said in line


def test_notes_of_an_error_are_told_too(monkeypatch, capsys):
    error = UserError("the port is gone")
    error.add_note("torque off was not confirmed")

    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(cli, "app", fail)
    assert told(monkeypatch, "run") == 1
    assert capsys.readouterr().err.splitlines() == [
        "lipservo: the port is gone",
        "lipservo: torque off was not confirmed",
    ]


def test_names_of_files_are_printed_as_they_are(capsys):
    RESULTS.print("[final].wav :smile: [/]")
    assert capsys.readouterr().out == "[final].wav :smile: [/]\n"


def test_a_negative_angle_is_an_angle(monkeypatch, capsys):
    """Refused because the jaw goes to -2, not because there is no option -5."""
    assert told(monkeypatch, "jog", "jaw", "-5") == 1
    assert "lipservo: jaw: -5 deg is outside -2..25" in capsys.readouterr().err


def test_commands_that_move_simulated_servos_say_so_loudly(monkeypatch, capsys):
    assert told(monkeypatch, "jog", "jaw", "1", "--hold-s", "0") == 0
    known_text_of = capsys.readouterr()
    assert known_text_of.err.startswith("SIMULATED: no real servo moves")
    assert "jaw stands at" in known_text_of.out


def test_a_shell_completes_its_commands(tmp_path: Path):
    asked = {
        "_LIPSERVO_COMPLETE": "complete_bash",
        "COMP_WORDS": "lipservo calibrate",
        "COMP_CWORD": "1",
    }
    done = subprocess.run(
        [sys.executable, "-m", "lipservo"],
        env={**os.environ, **asked},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert sorted(done.stdout.split()) == ["calibrate"]
