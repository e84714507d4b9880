"""--quiet leaves out the view and messages, not what will be missing afterwards."""

import os
import resource
import subprocess
import sys

import numpy as np
import soundfile


def test_a_trace_that_breaks_off_and_a_health_log_without_a_place_are_one_line_each(tmp_path):
    sound, trace = tmp_path / "line.wav", tmp_path / "trace"
    soundfile.write(sound, 0.1 * np.sin(np.arange(80_000) / 20.0), 16_000)
    places = ("HOME", "XDG_STATE_HOME", "LIPSERVO_STATE")
    done = subprocess.run(
        [sys.executable, "-m", "lipservo", "run", "--sim", "pty", "--config", "face_four"]
        + ["--wav", sound, "--trace", trace, "--quiet"],
        env={name: value for name, value in os.environ.items() if name not in places},
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000)),
    )
    at_once = [line for line in done.stderr.splitlines() if "the face goes on" in line]
    assert done.returncode != 0
    assert at_once == [f"{trace}: the trace broke off: File too large; the face goes on"]
    assert "no health log: set HOME" in done.stderr
    assert "delay from sound to face" not in done.stderr
    assert done.stderr.splitlines()[-1] != at_once[0], "at once, and at the end"
