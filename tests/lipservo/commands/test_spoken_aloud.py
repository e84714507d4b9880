"""`say` with real PortAudio: what it says comes out of the loudspeaker."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from null_sink import null_sink

from lipsync.text_to_speech.synthesis import SynthesisError
from lipsync.text_to_speech.synthesizers import synthesizer_for

# A PulseAudio server and a run in real time.
pytestmark = pytest.mark.slow

TEXT = "Maybe Bob."
RATE_HZ = 16_000
PATIENCE_S = 120.0


def test_what_is_said_leaves_the_loudspeaker_whole(tmp_path):
    if shutil.which("parec") is None:
        pytest.skip("no parec: apt install pulseaudio-utils")
    try:
        voice = synthesizer_for()
    except SynthesisError as missing:
        pytest.skip(str(missing))
    wanted = voice.speak(TEXT)
    recorded = tmp_path / "heard.raw"
    with null_sink() as server, recorded.open("wb") as file:
        format_ = ["--format=s16le", f"--rate={RATE_HZ}", "--channels=1", "--latency-msec=20"]
        recorder = subprocess.Popen(
            ["parec", *format_, "-d", "speaker.monitor"], env=server.environment, stdout=file
        )
        try:
            done = subprocess.run(
                [sys.executable, "-m", "lipservo", "say", TEXT, "--json"],
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
    assert told["phonemes"] >= 6
    assert told["status"]["output"] is not None
    heard = np.frombuffer(recorded.read_bytes(), "<i2") / 32_768.0
    loud = np.flatnonzero(np.abs(heard) > 0.02)
    sounding = np.flatnonzero(np.abs(wanted.samples) > 0.02)
    lasted_s = (loud[-1] - loud[0]) / RATE_HZ
    assert lasted_s == pytest.approx((sounding[-1] - sounding[0]) / wanted.sample_rate_hz, abs=0.05)
