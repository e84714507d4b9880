"""When drawn mouths close for P B M: a worked example, and the command with its picture."""

import json

import pytest
from lipservo_lab.bench.shape_figures import closing_figures
from speech import CLIP_LABELS_PATH, CLIP_PATH
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.terminal.pictures import is_picture
from lipsync.phonemes import PhonemeEvent

PHONES = tuple(
    PhonemeEvent(phoneme, i / 5, (i + 1) / 5)
    for i, phoneme in enumerate(("SIL", "M", "AA", "P", "AA", "B", "AA", "B", "SIL"))
)


def test_closings_are_early_or_late_and_those_after_a_pause_are_not_timed():
    """P at 0.6 s is closed 20 ms early, the first B 40 ms late, the second not at all."""
    closed = [(0.0, 0.4), (0.58, 0.7), (1.04, 1.1)]
    assert closing_figures(PHONES, closed) == {
        "phones": 4, "met": 3, "p10_ms": -14.0, "median_ms": 10.0, "p90_ms": 34.0,
    }  # fmt: skip


def test_a_mouth_that_never_closes_has_no_times():
    assert closing_figures(PHONES, []) == {
        "phones": 4, "met": 0, "p10_ms": None, "median_ms": None, "p90_ms": None,
    }  # fmt: skip


@pytest.mark.slow
def test_the_command_compares_the_bundled_clip_and_draws_it(tmp_path):
    picture = tmp_path / "shapes.png"
    arguments = ["bench", "shapes", CLIP_PATH, CLIP_LABELS_PATH, "--picture", picture, "--json"]
    done = CliRunner().invoke(app, [str(each) for each in arguments])
    assert done.exit_code == 0, done.output
    methods = json.loads(done.stdout)["methods"]
    with_true_phones = [row for name, row in methods.items() if "from the sound" not in name]
    assert [row["met"] for row in with_true_phones] == [16] * 4
    assert abs(methods["our lips, true phones"]["median_ms"]) < 20.0
    assert is_picture(picture.read_bytes())
