"""What people type that cannot work: told in a few lines, and every file as it was."""

import shlex
from pathlib import Path

import pytest
from bad_inputs import command_lines, make_files, run
from lipservo_lab.commands.groups import LearnGroup

from lipservo.cli import COMMANDS
from lipservo.commands.calibrate.app import CalibrateGroup
from lipservo.commands.lines.app import LinesGroup

#: The longest that any mistake needs: a face without its settings is told one by one.
_MOST_LINES = 25


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("inputs")
    make_files(made)
    return made


@pytest.mark.parametrize("line", command_lines())
def test_a_command_line_that_cannot_work_is_told_and_changes_nothing(line, folder):
    outcome = run(line, folder)
    assert not outcome.is_traceback, outcome.stderr
    assert outcome.status in (1, 2), outcome.stderr
    assert 1 <= len(outcome.complaints) <= _MOST_LINES, outcome.stderr
    assert outcome.changed == []


def test_the_table_has_every_command():
    groups = {"calibrate": CalibrateGroup, "lines": LinesGroup, "learn": LearnGroup}
    lines = [shlex.split(line) for line in command_lines()]
    tried = {line[0] for line in lines}
    assert tried >= {name for name, command in COMMANDS.items() if not command.hidden}
    for name, group in groups.items():
        below = {line[1] for line in lines if line[0] == name and len(line) > 1}
        assert below >= set(group.table)
