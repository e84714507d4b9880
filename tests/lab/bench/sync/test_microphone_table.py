"""The table that a puppeteer chooses by, and the point of it that `--low-latency` takes."""

import re
from importlib import resources

import numpy as np
import pytest
import soundfile
from lipservo_lab.bench.sync import microphone_latency as table
from lipservo_lab.bench.sync.microphone_latency import clip_to_bus_s
from lipservo_lab.learning.motion.trained_model import load_trained_model
from places import ROOT
from running_daemon import own_folder
from speech import CLIP_PATH
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.runtime.motion_options import LOW_LATENCY_LOOKAHEAD_S, LOW_LATENCY_S, MotionOptions
from lipsync.motion.finishing import Style
from lipsync.recognition.network import DEFAULT_WEIGHTS

LOW_LATENCY = MotionOptions(
    style=Style(LOW_LATENCY_LOOKAHEAD_S), recognizer_latency_s=LOW_LATENCY_S
)


def documented_rows():
    """The table in docs/benchmarks.md: look-ahead, recogniser, declared, measured, in ms."""
    text = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    section = text.split("### From microphone to bus")[1].split("\n#")[0]
    lines = [line for line in section.splitlines() if line.startswith("| ")][1:]
    return [[float(cell) for cell in line.split("|")[1:5]] for line in lines if "---" not in line]


def test_what_is_documented_as_declared_is_declared():
    rows = documented_rows()

    assert len(rows) == len(table.LOOKAHEADS_S) * len(table.LATENCIES_S)
    for lookahead_ms, latency_ms, declared_ms, _ in rows:
        motion = MotionOptions(
            style=Style(lookahead_ms / 1e3), recognizer_latency_s=latency_ms / 1e3
        )
        assert 1e3 * table.declared_delay_s(motion) == pytest.approx(declared_ms, abs=0.5)


def test_a_run_with_low_latency_declares_what_the_table_says(tmp_path, monkeypatch):
    own_folder(monkeypatch)
    sound = tmp_path / "short.wav"
    soundfile.write(sound, np.random.default_rng(0).normal(0.0, 0.01, 3200), 16_000)
    shipped = resources.files("lipservo.config") / "face_sim.yaml"
    face = tmp_path / "face.yaml"
    face.write_text(f"{shipped.read_text()}\nmotion: {{low_latency: true}}\n")
    done = CliRunner().invoke(app, ["run", "--wav", str(sound), "--config", str(face)])

    assert done.exit_code == 0, done.output
    said = " ".join(done.stderr.split()).split("delay from sound to face: ")[1]
    parts = re.findall(r"(recogniser|look-ahead|sound block|publishing) (\d+)", said)
    assert len(parts) == 4
    declared_ms = sum(float(ms) for _, ms in parts)
    point = [LOW_LATENCY_LOOKAHEAD_S * 1e3, LOW_LATENCY_S * 1e3]
    assert [row[2] for row in documented_rows() if row[:2] == point] == [declared_ms]


@pytest.mark.slow
def test_a_goal_follows_the_microphone_within_150_ms_of_low_latency():
    assert 0.0 < clip_to_bus_s(LOW_LATENCY, 1).max() <= 0.150


@pytest.mark.campaign
def test_every_point_has_its_row_with_delay_closures_and_accuracy():
    face = load_trained_model()
    clip = [(CLIP_PATH, ())]
    rows = table.microphone_table(
        clip, face, DEFAULT_WEIGHTS, lambda s: {"viseme_all": s}, lambda *_: None, n_times=2
    )

    assert [(row["lookahead_ms"], row["latency_ms"]) for row in rows] == [
        (0.0, 45.0), (50.0, 45.0), (100.0, 45.0), (0.0, 95.0), (50.0, 95.0), (100.0, 95.0),
    ]  # fmt: skip
    for row in rows:
        assert row["closures"] == 0
        assert row["viseme_all"] == row["latency_ms"] / 1e3
        # The microphone's piece and its driver are not declared.
        assert row["microphone_to_bus_p95_ms"] <= row["declared_delay_ms"] + 20.0
