"""What `lipservo calibrate` and `lipservo trim` took as flags is refused with the new spelling."""

import shlex

import pytest
from lipservo.commands.calibrate.old_spelling import new_spelling
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.commands.calibrate.app import app as calibrate

SUB_COMMANDS = (
    "plan", "fit", "grade", "measure", "guided", "practise", "by-hand", "pose", "lags", "trim",
    "show",
)  # fmt: skip


def lipservo(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "400"})


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("-o c.yaml", "fit --output c.yaml"),
        (
            "--config f.yaml --model m.npz -oc.yaml",
            "fit --config f.yaml --model m.npz --output c.yaml",
        ),
        ("--config f.yaml --plan p.csv --poses 30", "plan p.csv --config f.yaml --poses 30"),
        ("--plan=p.csv --ranges r.json --json", "plan p.csv --ranges r.json --json"),
        (
            "--plan p.csv --markers m.csv --refine q.csv --axes 'x z -y'",
            "plan q.csv --refine p.csv --markers m.csv --axes 'x z -y'",
        ),
        (
            "--plan p.csv --markers m.csv -o c.yaml --plots d -q",
            "fit --plan p.csv --markers m.csv --output c.yaml --plots d --quiet",
        ),
        (
            "--port /dev/x --tracker m.csv --keep k --speed 20 -o c.yaml",
            "measure --port /dev/x --tracker m.csv --keep k --speed 20 --output c.yaml",
        ),
        ("--sim pty -o c.yaml", "measure --sim pty --output c.yaml"),
        (
            "--guided --port /dev/x --no-lags -o c.yaml",
            "guided --port /dev/x --no-lags --output c.yaml",
        ),
        ("--practise 3 --sim pty -o c.yaml", "practise 3 --sim pty --output c.yaml"),
        ("--lags --plan", "plan PLAN"),
        ("--plan 'my poses.csv'", "plan 'my poses.csv'"),
    ],
)
def test_every_old_flag_is_refused_with_what_to_type_now(old, new):
    done = lipservo("calibrate", *shlex.split(old))
    assert done.exit_code == 2
    assert f"now `lipservo calibrate {new}`" in str(done.stderr).replace("\n", "")


def test_trim_alone_is_refused_with_what_to_type_now():
    done = lipservo("trim", "c.yaml", "P", "jaw", "-1")
    assert done.exit_code == 2
    assert "now `lipservo calibrate trim c.yaml P jaw -1`" in done.stderr


def test_what_a_sub_command_does_not_know_is_left_out_of_its_spelling():
    old = ["--guided", "--poses", "9", "-o", "c.yaml"]
    assert (
        new_spelling(old, {"guided": ["--output"]}) == "lipservo calibrate guided --output c.yaml"
    )


def test_each_sub_command_has_a_help_of_its_own_with_an_example():
    names = [command.name or command.callback.__name__ for command in calibrate.registered_commands]
    assert tuple(names) == SUB_COMMANDS
    for name in SUB_COMMANDS:
        told = " ".join(lipservo("calibrate", name, "--help").stdout.split())
        assert f"Example: lipservo calibrate {name} " in told
