"""The command: lists, bad input, and what signals leave. Sessions: recording/test_session.py."""

import json
import signal
import subprocess
import sys
import time

import pytest
from fake_sound_card import install_sound_card
from places import ROOT
from typer.testing import CliRunner

from lipservo.cli import app

SUPPORT = ROOT / "tests" / "support" / "sound"
CAMERA = "lavfi:testsrc=size=64x48:rate=30"


def record_corpus(*arguments):
    return CliRunner().invoke(app, ["learn", "record", *map(str, arguments)])


def test_the_list_is_printed_without_any_device():
    lines = record_corpus("--list").stdout.splitlines()
    assert len(lines) == 60
    assert lines[0].startswith("s001  ")
    assert len(json.loads(record_corpus("--list", "--json").stdout)["sentences"]) == 60


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((), "name a folder"),
        (("-o", "f", "--size", "large"), "write WIDTHxHEIGHT"),
        (("-o", "none/f"), "there is no folder none"),
        (("-o", "file"), "is a file"),
        (("-o", "f", "--sentences", "none.txt"), "cannot be read as text"),
        (("-o", "f", "--camera", "/dev/no-camera"), "cannot be opened"),
        (("-o", "f", "--camera", CAMERA, "--mic", "nobody's"), "nobody's"),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, monkeypatch, arguments, complaint):
    install_sound_card(monkeypatch)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    done = record_corpus(*arguments)
    assert done.exit_code != 0
    assert complaint in f"{done.exception} {done.output}"
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["file"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_a_take_leaves_nothing_half(tmp_path, number):
    process = subprocess.Popen(
        [
            sys.executable, SUPPORT / "delivering_card.py", "learn", "record",
            "-o", tmp_path / "me",
            "--camera", CAMERA, "--json",
        ],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT, text=True,
    )  # fmt: skip
    process.stdin.write(" ")
    process.stdin.flush()
    partial = tmp_path / "me" / "s001.mkv.partial"
    try:
        while not partial.is_file():
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.02)
        process.send_signal(number)
        told, complaints = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 128 + number, complaints
    assert json.loads(told)["recorded"] == []
    assert list((tmp_path / "me").iterdir()) == []
