"""`perform` with real PortAudio: its sound comes out of the loudspeaker."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import soundfile
from null_sink import null_sink

from lipservo.runtime.servos.assembly import assemble_face
from lipsync.offline.performance import Performance, performed_sound, write_performance
from lipsync.phonemes import PhonemeEvent

# A PulseAudio server and a run in real time.
pytestmark = pytest.mark.slow

RATE_HZ = 16_000
PATIENCE_S = 120.0


def test_the_sound_of_a_performance_leaves_the_loudspeaker_whole(tmp_path):
    if shutil.which("parec") is None:
        pytest.skip("no parec: apt install pulseaudio-utils")
    sound, path = tmp_path / "tone.wav", tmp_path / "tone.perf"
    soundfile.write(sound, 0.3 * np.sin(2 * np.pi * 300 * np.arange(RATE_HZ) / RATE_HZ), RATE_HZ)
    face = assemble_face("face_sim", None).model
    faces = np.tile(face.rest.astype(np.float32), (101, 1))
    phonemes = (PhonemeEvent("AA", 0.0, 1.0),)
    kept = performed_sound(sound, included=True)
    write_performance(Performance(face.checksum, faces, phonemes, kept, "heard"), path)
    recorded = tmp_path / "heard.raw"
    with null_sink() as server, recorded.open("wb") as file:
        format_ = ["--format=s16le", f"--rate={RATE_HZ}", "--channels=1", "--latency-msec=20"]
        recorder = subprocess.Popen(
            ["parec", *format_, "-d", "speaker.monitor"], env=server.environment, stdout=file
        )
        try:
            done = subprocess.run(
                [sys.executable, "-m", "lipservo", "lines", "perform", path, "--json"],
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
    assert told["status"]["n_playout_underruns"] == 0
    loud = np.flatnonzero(np.abs(np.frombuffer(recorded.read_bytes(), "<i2") / 32_768.0) > 0.02)
    assert (loud[-1] - loud[0]) / RATE_HZ == pytest.approx(1.0, abs=0.05)
