"""Commands that are imported when they are run, and those of another distribution."""

from types import SimpleNamespace

import pytest
from every_command import every_command
from rich.text import Text
from typer.testing import CliRunner

from lipservo.cli import MOVED, app
from lipservo.commands import lazy_group
from lipservo.commands.options import MOVED_OPTIONS
from lipservo.commands.run import stop
from lipsync.errors import UserError

#: At the top; `film` and `study` are to come.
MOST_COMMANDS = 27
#: All else is in the face's YAML, or set while it runs. `run` reads label files: `--tier` and
#: `--alphabet` say what one holds.
MOST_OPTIONS = {"run": 19, "daemon": 17}


def run(*arguments):
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.parametrize(("old", "new"), MOVED.items())
def test_an_old_name_prints_the_new_one(old, new):
    done = run(old, "--help")

    assert done.exit_code == 2
    assert f"is now `lipservo {new}`" in done.stderr
    assert f"lipservo {new}" in dict(every_command())


def test_there_are_so_few_commands_that_one_finds_the_right_one():
    listed = run("--help").stdout

    visible = [path for path, _ in every_command() if len(path.split()) == 2]
    named = [path.split()[1] for path in visible if f"\n  {path.split()[1]} " in listed]
    assert 20 < len(named) <= MOST_COMMANDS


@pytest.mark.parametrize("name", MOST_OPTIONS)
def test_a_command_that_starts_a_face_has_few_options(name):
    found = dict(every_command())[f"lipservo {name}"].params
    typed = {option for each in found for option in (*each.opts, *each.secondary_opts)}
    of_the_shell = {"install_completion", "show_completion"}

    assert len({each.name for each in found} - of_the_shell) <= MOST_OPTIONS[name]
    assert typed.isdisjoint(MOVED_OPTIONS[name])


def test_without_the_lab_bench_says_what_to_install(monkeypatch):
    monkeypatch.setattr(lazy_group, "entry_points", lambda **_: ())

    for words in (["bench"], ["learn", "face"], ["lines", "render-folder"]):
        assert "pip install lipservo-lab" in str(run(*words).exception)


def test_a_lab_of_another_version_is_refused_in_a_line_that_names_both(monkeypatch):
    other = SimpleNamespace(name="lipservo-lab", version="0.1.0")
    point = SimpleNamespace(name="bench", dist=other, load=lambda: stop)
    monkeypatch.setattr(lazy_group, "entry_points", lambda **_: (point,))

    error = run("bench").exception
    assert isinstance(error, UserError)
    assert "lipservo-lab 0.1.0 does not fit lipservo" in str(error)


def test_a_mistyped_name_is_answered_with_the_nearest():
    done = run("stpo")

    assert done.exit_code == 2
    assert "did you mean stop?" in done.stderr


def test_help_is_printed_as_it_is_written():
    """Rich takes words in brackets for markup: it drops them, or ends in a traceback."""
    for path, command in every_command():
        options = [getattr(each, "help", None) for each in command.params]
        for text in filter(None, (command.help, *options)):
            assert Text.from_markup(text).plain == text.replace("\\[", "["), path
