"""`say` and `perform` with real PortAudio: their sound comes out of the loudspeaker."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from null_sink import null_sink
from written_performance import written_performance

from lipsync.text_to_speech.synthesis import SynthesisError
from lipsync.text_to_speech.synthesizers import synthesizer_for

# A PulseAudio server and a run in real time.
pytestmark = pytest.mark.slow

TEXT = "Maybe Bob."
RATE_HZ = 16_000
PATIENCE_S = 120.0


def played(recorded, *arguments):
    """What a command says of itself in JSON, and how long its sound left the loudspeaker, in s."""
    if shutil.which("parec") is None:
        pytest.skip("no parec: apt install pulseaudio-utils")
    with null_sink() as server, recorded.open("wb") as file:
        format_ = ["--format=s16le", f"--rate={RATE_HZ}", "--channels=1", "--latency-msec=20"]
        recorder = subprocess.Popen(
            ["parec", *format_, "-d", "speaker.monitor"], env=server.environment, stdout=file
        )
        try:
            done = subprocess.run(
                [sys.executable, "-m", "lipservo", *arguments, "--json"],
                env=server.environment,
                timeout=PATIENCE_S,
                check=False,
                capture_output=True,
                text=True,
            )
        finally:
            recorder.terminate()
            recorder.wait()
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["status"]["output"] is not None
    return told, loud_s(np.frombuffer(recorded.read_bytes(), "<i2") / 32_768.0, RATE_HZ)


def loud_s(samples, rate_hz):
    loud = np.flatnonzero(np.abs(samples) > 0.02)
    return (loud[-1] - loud[0]) / rate_hz


def test_what_is_said_leaves_the_loudspeaker_whole(tmp_path):
    try:
        wanted = synthesizer_for().speak(TEXT)
    except SynthesisError as missing:
        pytest.skip(str(missing))
    told, lasted_s = played(tmp_path / "heard.raw", "say", TEXT)
    assert told["phonemes"] >= 6
    assert lasted_s == pytest.approx(loud_s(wanted.samples, wanted.sample_rate_hz), abs=0.05)


def test_the_sound_of_a_performance_leaves_the_loudspeaker_whole(tmp_path):
    path = written_performance(tmp_path / "tone.perf")
    told, lasted_s = played(tmp_path / "heard.raw", "lines", "perform", path)
    assert told["status"]["n_playout_underruns"] == 0
    assert lasted_s == pytest.approx(1.0, abs=0.05)
