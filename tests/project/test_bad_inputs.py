"""What people type that cannot work: told in a few lines, and every file as it was."""

from pathlib import Path

import pytest
from bad_inputs import command_lines, make_files, run

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
    tried = {line.split()[0] for line in command_lines()}
    assert tried >= {
        "run", "daemon", "replay", "devices", "train", "calibrate", "trim", "recognize", "align",
        "train-recognizer", "plot-training", "sim-bus", "doctor", "setup-servos", "new-face",
        "jog", "neutral", "stop", "bench", "render",
        "perform", "train-offline", "adapt",
    }  # fmt: skip
