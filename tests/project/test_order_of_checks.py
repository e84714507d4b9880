"""A command looks for its files first, then for its extras, and only then works."""

import importlib.util

import pytest
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync import errors

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_extras")]
CLIP = "lipservo/clips/welcome.flac"
TRACE = "tests/data/traces/clip.jsonl.gz"


@pytest.fixture
def without_extras(monkeypatch):
    """No library of any extra is found."""
    monkeypatch.setattr(
        errors,
        "find_spec",
        lambda name: None if name in errors.EXTRA_OF else importlib.util.find_spec(name),
    )


def answer(*arguments):
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code != 0
    return str(done.exception) if isinstance(done.exception, errors.UserError) else done.output


@pytest.mark.parametrize(
    "arguments",
    [
        ("film", "absent.wav", "-o", "{}/film.mp4"),
        ("film", CLIP, "-o", "{}/film.mp4", "--phonemes", "absent.TextGrid"),
        ("film", "-o", "{}/film.mp4", "--trace", "absent.jsonl"),
        ("lines", "align", "absent.wav", "hello"),
        ("lines", "render", "absent.wav", "-o", "{}/a.perf", "--method", "model-based"),
        (
            *("lines", "render", CLIP, "-o", "{}/a.perf", "--method", "model-based"),
            *("--textgrid", "absent.TextGrid"),
        ),
        ("lines", "render-folder", "absent", "-o", "{}/out", "--method", "model-based"),
        ("trace", "diff", TRACE, "absent.jsonl", "--plot", "{}/plot.png"),
        ("learn", "import-video", "absent.mp4", "-o", "{}/corpus"),
        ("learn", "import-scans", "absent", "-o", "{}/corpus"),
        ("learn", "recognizer", "absent", "-o", "{}/weights.npz"),
        ("study", "report", "absent"),
        ("study", "make", "{}/study", "--corpus", "absent"),
        ("bench", "motion", "--corpus", "absent", "--plots", "{}/plots"),
        ("bench", "figures", "--corpus", "absent", "--model", CLIP, "--plots", "{}/plots"),
        ("bench", "readability", "--corpus", "absent", "--plots", "{}/plots"),
        ("bench", "display", "--corpus", "absent"),
    ],
)
def test_a_file_that_is_absent_is_named_before_an_extra(arguments, tmp_path):
    said = answer(*(each.format(tmp_path) for each in arguments))
    assert "absent" in said
    assert "pip install" not in said


@pytest.mark.parametrize(
    "arguments",
    [
        ("film", CLIP, "-o", "{}/film.mp4"),
        ("lines", "align", CLIP, "hello"),
        ("lines", "render", CLIP, "-o", "{}/a.perf", "--method", "model-based"),
        ("trace", "diff", TRACE, TRACE, "--plot", "{}/plot.png"),
        ("learn", "import-video", CLIP, "-o", "{}/corpus"),
        ("bench", "motion", "--corpus", "{}", "--plots", "{}/plots"),
        ("bench", "bus"),
        ("bench", "scans"),
        ("bench", "inputs"),
    ],
)
def test_an_extra_that_is_absent_is_named_before_the_work(arguments, tmp_path):
    said = answer(*(each.format(tmp_path) for each in arguments))
    assert "pip install" in said
    assert not list(tmp_path.iterdir())
