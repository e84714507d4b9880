"""--quiet leaves out the view and messages, not what will be missing afterwards."""

import os
import subprocess
import sys
import threading

import numpy as np
import pytest
import soundfile
from logged import logged

from lipservo.traces.trace_file import BackgroundTrace, TraceError

RUN = [sys.executable, "-m", "lipservo", "run", "--sim", "pty", "--config", "face_four"]
PATIENCE_S = 30.0


def test_a_health_log_without_a_place_is_one_line(tmp_path):
    sound = tmp_path / "line.wav"
    soundfile.write(sound, 0.1 * np.sin(np.arange(8_000) / 20.0), 16_000)
    places = ("HOME", "XDG_STATE_HOME", "LIPSERVO_STATE")
    done = subprocess.run(
        [*RUN, "--wav", sound, "--quiet"],
        env={name: value for name, value in os.environ.items() if name not in places},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0
    assert done.stderr == "health is not logged: set HOME, XDG_STATE_HOME or LIPSERVO_STATE\n"


class FullDisk:
    """In the place of a trace's file."""

    def observe(self, _tick):
        raise TraceError("trace: the trace stopped: No space left on device")


def test_a_trace_that_breaks_off_is_one_line_at_once_and_an_error_at_the_end():
    is_logged = threading.Event()
    with logged("lipservo.traces", lambda _line: is_logged.set()) as lines:
        trace = BackgroundTrace(FullDisk())
        for _ in range(3):
            trace.observe("a tick")
        assert is_logged.wait(PATIENCE_S)
        with pytest.raises(TraceError), trace:
            pass
    assert lines == ["trace: the trace stopped: No space left on device; the face goes on"]


def test_a_face_beats_on_while_a_slow_disk_takes_the_end_of_its_trace():
    taken, beats = threading.Event(), []

    class SlowDisk:
        def close(self, _dropped):
            assert taken.wait(PATIENCE_S)

    def beat():
        beats.append(1)
        if len(beats) == 3:
            taken.set()

    with BackgroundTrace(SlowDisk(), beat):
        pass
    assert len(beats) >= 3
