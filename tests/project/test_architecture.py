"""Pages name files that exist, and the tables of docs/architecture.md names in them."""

import re

import numpy as np
import pytest
from places import ROOT
from state_tables import page_with_tables
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.traces.trace_file import read_trace

TEXT = (ROOT / "docs" / "architecture.md").read_text("utf-8")
#: Tables whose last column names what to look for in each file, and how many rows they have.
READING = {"Ten files to read, in this order": 10, "Which files a change touches": 12}


def rows(title):
    """The cells of each row of the tables under a heading."""
    section = TEXT.split(f"\n## {title}\n")[1].split("\n## ")[0]
    lines = re.findall(r"^\| (.+) \|$", section, re.MULTILINE)
    cells = [line.split(" | ") for line in lines]
    return [row for row in cells if "look for" not in row and not row[0].startswith("---")]


def spans(cell):
    return re.findall(r"`(.+?)`", cell)


def defines(text, symbol):
    """Whether a file defines a name: class, function, constant, field, key, or variable."""
    name = re.escape(symbol)
    return re.search(rf"^\s*(?:class {name}\b|def {name}\b|{name}\b\s*[:=])", text, re.MULTILINE)


@pytest.mark.parametrize("title", READING)
def test_every_file_to_read_or_to_touch_has_what_it_is_said_to_have(title):
    told = rows(title)
    assert len(told) == READING[title]
    for row in told:
        files, symbols = spans(row[1]), spans(row[-1])
        assert 1 <= len(files) <= 2
        for file, symbol in zip(files, symbols, strict=True):
            text = (ROOT / file).read_text("utf-8")
            found = f"`{symbol}`" in text or f"`servos.*.{symbol}`" in text
            assert defines(text, symbol) or (file.endswith(".md") and found), (file, symbol)


def test_the_sample_that_is_followed_goes_where_the_page_says(tmp_path):
    """The delay, and what reaches the servos at the last tick before the face is seen."""
    trace = tmp_path / "walk.jsonl"
    sound = ROOT / "lipservo" / "clips" / "welcome.flac"
    arguments = ["replay", sound, "--rate-hz", "100", "--trace", trace, "--quiet"]
    done = CliRunner().invoke(app, [str(each) for each in arguments])
    assert done.exit_code == 0, done.output

    said_s = re.search(r": (\S+) s\) lies in the M", TEXT)[1]
    delay_ms = re.search(r": (\d+) ms of delay", TEXT)[1]
    sent_ms = re.search(r"^\| (\d{3}) \| `firmware_bridge/gate/limits.py`", TEXT, re.M)[1]
    lip_deg, jaw_deg = re.search(r"lip may go to (\S+), the jaw to (\S+) degrees", TEXT).groups()
    run = read_trace(trace)
    assert run.delay_s == pytest.approx(float(delay_ms) / 1e3, abs=5e-4)
    shown_s = float(said_s) + (float(sent_ms) - float(delay_ms)) / 1e3
    tick = int(np.abs(run.sound_s - shown_s).argmin())
    sent_deg = dict(zip(run.servos, run.sent_deg[tick], strict=True))
    assert run.phonemes[tick] == "M"
    assert sent_deg["upper_lip_left"] == pytest.approx(float(lip_deg), abs=0.06)
    assert sent_deg["jaw"] == pytest.approx(float(jaw_deg), abs=0.06)


def test_the_state_tables_of_the_page_are_those_of_the_code():
    """`python tests/support/servos/state_tables.py` writes them."""
    assert page_with_tables(TEXT) == TEXT
