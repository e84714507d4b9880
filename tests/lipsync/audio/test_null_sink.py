"""Real playback and capture, through PortAudio, ALSA and PulseAudio, into a sink without hardware.

What is judged is which samples were played and captured, never how long it took.
"""

import json
import subprocess
import sys

import numpy as np
import pytest
import soxr
from null_sink import null_sink
from places import ROOT
from two_servo_face import FACE

from lipservo.settings.settings import load_face

pytestmark = pytest.mark.slow

RATE_HZ = 16_000
PLAYED_S = 1.5

PLAY_AND_RECORD = """
import math, sys, time
import numpy as np
from lipsync.audio.loudspeaker import LoudspeakerOutput
from lipsync.audio.microphone import MicrophoneSource

sound = np.load(sys.argv[1])
heard, reports, captured = [], [], []
with MicrophoneSource() as microphone, LoudspeakerOutput() as speaker:
    assert speaker.rate_hz == 48_000
    speaker.write(sound)
    n_after = 0
    while n_after < 12_000:
        for block in microphone.blocks(math.inf):
            heard.append(block.samples)
            is_over = bool(reports) and reports[-1][1] >= len(sound) / 48_000
            n_after += is_over * len(block.samples)
        if speaker.position() is not None:
            reports.append(speaker.position())
        if microphone.captured is not None:
            captured.append(microphone.captured)
        time.sleep(0.005)
    underruns = speaker.n_underruns
    assert (microphone.n_losses, speaker.watch.n_losses, speaker._ring.n_lost) == (0, 0, 0)
np.savez(sys.argv[2], heard=np.concatenate(heard), reports=reports, captured=captured,
         counts=[underruns, microphone.lost_blocks])
"""

LOSE_AND_FIND = """
import math, sys, time
import numpy as np
from lipsync.audio.loudspeaker import LoudspeakerOutput
from lipsync.audio.microphone import MicrophoneSource

def wait_for(condition):
    global n_blocks
    while not condition():
        position = speaker.position()
        if position and n_blocks / 100 < position[1] + 0.5:
            speaker.write(np.zeros(480, np.float32))
            n_blocks += 1
        microphone.blocks(math.inf)
        time.sleep(0.005)

with MicrophoneSource() as microphone, LoudspeakerOutput() as speaker:
    n_blocks = 0
    wait_for(lambda: speaker.position() and speaker.position()[1] > 0.3)
    print("plays", flush=True)
    wait_for(lambda: speaker.is_lost and microphone.is_lost)
    print("lost", flush=True)
    stood_s, n_lost = speaker.position()[1], microphone.lost_blocks
    wait_for(lambda: not speaker.is_lost and not microphone.is_lost)
    wait_for(lambda: speaker.position()[1] > stood_s + 0.3)
    assert microphone.lost_blocks > n_lost
    assert (speaker.watch.n_losses, microphone.n_losses) == (1, 1)
print("found", flush=True)
"""


@pytest.fixture(scope="module")
def sink():
    with null_sink() as server:
        yield server


@pytest.fixture(scope="module")
def recording(sink, tmp_path_factory):
    """Play noise; return it at 16 kHz, and the arrays recorded meanwhile, by name.

    Up to three times, as long as the devices count underruns or lost blocks (a busy computer).
    """
    folder = tmp_path_factory.mktemp("sound")
    rng = np.random.default_rng(3)
    sound = (0.2 * rng.standard_normal(round(PLAYED_S * 48_000))).astype(np.float32)
    np.save(folder / "sound.npy", sound)
    command = [sys.executable, "-c", PLAY_AND_RECORD, folder / "sound.npy", folder / "heard.npz"]
    for _ in range(3):
        done = subprocess.run(
            command, cwd=ROOT, env=sink.environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        told = dict(np.load(folder / "heard.npz"))
        if not np.any(told["counts"]):
            break
    return soxr.resample(sound, 48_000, RATE_HZ), told


def place_in(heard, stretch):
    """(first sample at which a stretch is found, how like it that is: 1 for the same)."""
    n = len(heard) + len(stretch)
    matched = np.fft.irfft(np.fft.rfft(heard, n) * np.conj(np.fft.rfft(stretch, n)), n)
    first = int(np.argmax(matched[: len(heard) - len(stretch)]))
    found = heard[first : first + len(stretch)]
    return first, float(np.corrcoef(found, stretch)[0, 1])


def test_what_is_played_is_recorded_in_order_and_without_gaps(recording):
    """Every stretch of 0.1 s lies where the first one says, to a sample."""
    played, told = recording
    length = RATE_HZ // 10
    stretches = [played[n : n + length] for n in range(1_600, len(played) - length, length)]
    found = [place_in(told["heard"], stretch) for stretch in stretches]
    begins = [first - n * length for n, (first, _) in enumerate(found)]

    assert list(told["counts"]) == [0, 0]
    assert min(likeness for _, likeness in found) > 0.95
    assert max(begins) - min(begins) <= 1


def test_the_time_stamps_of_both_devices_say_when_the_sound_was_played_and_heard(recording):
    """The loudspeaker's say when the first sample left, the microphone's when it came back.

    Those of the time in which the sound is heard: while the sink wakes up, its monitor loses some.
    """
    played, told = recording
    first, _ = place_in(told["heard"], played[1_600:8_000])
    first -= 1_600
    captured, reports = told["captured"], told["reports"]
    later = captured[captured[:, 1] > first / RATE_HZ + 0.5]
    heard_s = np.median(later[:, 0] - later[:, 1]) + first / RATE_HZ
    steady = reports[(reports[:, 1] > 0.3) & (reports[:, 1] < PLAYED_S)]
    left_s = np.median(steady[:, 0] - steady[:, 1])

    assert abs(heard_s - left_s) < 0.02


def test_the_position_grows_by_a_second_a_second(recording):
    """By the device's own time stamps, while it plays."""
    _, told = recording
    reports = np.unique(told["reports"], axis=0)
    times_s, positions_s = reports[(reports[:, 1] > 0.3) & (reports[:, 1] < PLAYED_S - 0.02)].T
    assert len(times_s) > 20
    slope = np.polyfit(times_s - times_s[0], positions_s, 1)[0]
    assert slope == pytest.approx(1.0, abs=0.02)
    assert told["reports"][-1, 1] == pytest.approx(PLAYED_S)


def test_calibrate_audio_finds_the_delay_of_the_sink_and_writes_it(sink, tmp_path):
    """The sink says itself how late it is: next to nothing is left."""
    face = tmp_path / "face.yaml"
    face.write_text(FACE)
    command = [sys.executable, "-m", "lipservo", "calibrate", "audio", "--config", face, "--json"]
    done = subprocess.run(
        command, cwd=ROOT, env=sink.environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)

    assert told["clicks_played"] == 7
    assert told["clicks_found"] >= 6
    assert abs(told["output_offset_ms"]) < 20.0
    stored = load_face(face).sound.output_offset_ms
    assert dict(stored) == {told["output"]: told["output_offset_ms"]}


def test_a_device_that_goes_and_comes_again_is_found_by_both():
    """The server ends, and another one takes its place."""
    with (
        null_sink() as server,
        subprocess.Popen(
            [sys.executable, "-c", LOSE_AND_FIND],
            cwd=ROOT,
            env=server.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as process,
    ):
        assert process.stdout.readline() == "plays\n"
        server.stop()
        assert process.stdout.readline() == "lost\n"
        server.start()
        assert process.stdout.readline() == "found\n"
