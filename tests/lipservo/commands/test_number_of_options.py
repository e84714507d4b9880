"""`run` and `daemon` have few options; all else is in the face's YAML, or set while it runs."""

import pytest
import typer.main

from lipservo.cli import app
from lipservo.commands.options import MOVED_OPTIONS

#: `run` reads label files: `--tier` and `--alphabet` say what one holds.
MOST = {"run": 19, "daemon": 17}
#: The parser gives them to every command.
COMPLETION = {"install_completion", "show_completion"}


def options(command):
    group = typer.main.get_command(app)
    found = group.get_command(None, command)
    return {name for each in found.params for name in (*each.opts, *each.secondary_opts)}, found


@pytest.mark.parametrize("command", ["run", "daemon"])
def test_a_command_that_starts_a_face_has_few_options(command):
    names, found = options(command)

    assert len({each.name for each in found.params} - COMPLETION) <= MOST[command]
    assert names.isdisjoint(MOVED_OPTIONS[command])
