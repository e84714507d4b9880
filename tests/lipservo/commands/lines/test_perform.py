"""`perform`, from the command line, on the simulated face."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fake_sound_card import install_sound_card
from lipservo_lab.learning.motion.trained_model import save_model
from small_model import small_model
from typer.testing import CliRunner
from written_performance import written_performance

from lipservo.cli import app
from lipservo.runtime.servos.assembly import assemble_face
from lipservo.traces.trace_file import read_trace
from lipsync.offline.performance import RATE_HZ
from lipsync.offline.performed_motion import EASING_S
from lipsync.phonemes import PhonemeEvent

DURATION_S = 0.8
FACE = assemble_face("face_sim", None)
pytestmark = pytest.mark.usefixtures("own_folder")


def invoke(*arguments):
    return CliRunner().invoke(app, [str(each) for each in arguments])


def refusal(*arguments):
    done = invoke("lines", "perform", "--mute", *arguments)
    assert done.exit_code != 0
    assert done.stdout == ""
    text = str(done.exception)
    assert "\n" not in text
    return text


def faces_of(duration_s=DURATION_S):
    """A mouth that opens and closes three times, from an open one to a half open one."""
    times_s = np.arange(round(duration_s * RATE_HZ) + 1) / RATE_HZ
    faces = np.tile(FACE.model.rest, (len(times_s), 1))
    faces[:, 0] += 12.0 * np.cos(2 * np.pi * 2.8 * times_s)
    faces[:, 1] += 5.0 * np.sin(2 * np.pi * 1.3 * times_s)
    return faces.astype(np.float32)


@pytest.fixture
def written(tmp_path):
    """Writes a performance with changes, and gives its path."""

    def write(duration_s=DURATION_S, **changes):
        phonemes = (PhonemeEvent("AA", 0.0, 0.5), PhonemeEvent("M", 0.5, duration_s))
        given = {"coefficients": faces_of(duration_s), "phonemes": phonemes, **changes}
        return written_performance(tmp_path / "line.perf", duration_s, **given)

    return write


def stored(values, at_s):
    """Rows (n, k) of the file, linear between them."""
    grid_s = np.arange(len(values)) / RATE_HZ
    return np.stack([np.interp(at_s, grid_s, column) for column in values.T], axis=1)


def test_the_motion_sent_is_that_of_the_file(written, tmp_path):
    path, trace = written(), tmp_path / "trace"
    done = invoke("lines", "perform", path, "--mute", "--trace", trace, "--rate-hz", 100, "--json")
    told = json.loads(done.stdout)
    seen = read_trace(trace)
    faces = faces_of()
    at_s = seen.sound_s - EASING_S
    inside = (at_s >= 0.0) & (at_s <= DURATION_S)

    assert done.exit_code == 0
    assert told["stop"]["complete"]
    assert told["phonemes"] == 2
    assert (told["recognizer"], told["strategy"]) == ("none", "performed")
    assert told["status"]["fallback_level"] == 0
    assert inside.sum() > 40
    np.testing.assert_allclose(seen.coefficients[inside], stored(faces, at_s[inside]), atol=2e-3)
    assert {p for p, i in zip(seen.phonemes, inside, strict=True) if i} == {"AA", "M"}
    for ends in (seen.coefficients[0], seen.coefficients[-1]):
        np.testing.assert_allclose(ends, FACE.model.rest, atol=1e-3)
    # Servos are asked before the face is shown, by as much as they are late (10 to 20 ms here).
    jaw = [joint.name for joint in FACE.joints].index("jaw")
    rows = np.array([FACE.calibration.positions_deg(face) for face in faces])
    inside &= at_s < DURATION_S - 0.05
    off_deg = min(
        np.abs(stored(rows, at_s[inside] + early_s)[:, jaw] - seen.sent_deg[inside, jaw]).max()
        for early_s in np.arange(0.0, 0.03, 0.0005)
    )
    assert np.ptp(rows[:, jaw]) > 3.0
    assert off_deg < 0.1


def test_a_sound_beside_the_performance_serves_as_well(written):
    done = invoke("lines", "perform", written(included=False), "--mute", "--json")

    assert json.loads(done.stdout)["phonemes"] == 2


def test_the_loudspeaker_is_found_before_anything_moves(written, monkeypatch):
    card = install_sound_card(monkeypatch)
    path = written()

    assert "no single loudspeaker 'no such'" in str(
        invoke("lines", "perform", path, "--output", "no such").exception
    )
    both = invoke("lines", "perform", path, "--mute", "--output", "HDMI")
    assert both.exit_code == 2
    assert "not both" in both.output
    assert card.outputs == []


def test_sigterm_brings_the_mouth_to_rest_and_lets_the_servos_go(written):
    path = written(30.0)
    process = subprocess.Popen(
        [sys.executable, "-m", "lipservo", "lines", "perform", path, "--mute", "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    give_up_s = time.monotonic() + 60.0
    sockets = Path(os.environ["XDG_RUNTIME_DIR"], "lipservo")
    while not list(sockets.glob("*.sock")) and time.monotonic() < give_up_s:
        time.sleep(0.05)
    time.sleep(1.0)
    process.send_signal(signal.SIGTERM)
    out, said = process.communicate(timeout=60)
    told = json.loads(out)

    assert process.returncode == 128 + signal.SIGTERM, said
    assert told["stop"]["complete"]
    assert told["stop"]["at_rest"]
    assert told["duration_s"] < 20.0


def test_what_cannot_be_performed_is_told_in_one_line(written, tmp_path):
    """Files that are no performance: tests/lipsync/offline/test_performance_file.py."""
    assert "rendered for face model" in refusal(written(face_checksum="another"))
    path = written(coefficients=np.zeros((81, 2), np.float32))
    assert "2 coefficients per face" in refusal(path)
    path = written(coefficients=faces_of()[:40])
    assert "its faces last 0.39 s, its sound 0.80 s" in refusal(path)
    noise = tmp_path / "noise.wav"
    noise.write_bytes(b"no sound")
    assert refusal(written(sound=noise)).startswith(f"{path}: its sound noise.wav")


def test_a_calibration_for_another_model_is_refused(written, tmp_path):
    model = tmp_path / "face.npz"
    save_model(small_model(), model)

    assert "calibration" in refusal(written(), "--model", model)
