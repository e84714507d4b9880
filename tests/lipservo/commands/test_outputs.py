"""The command line as its users meet it: output, files, exit status."""

import json
import os
import signal
import subprocess
import sys
import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import soundfile
from in_process import lipservo
from small_corpus import write_corpus

CLIP = Path(str(resources.files("lipservo.clips") / "welcome.flac"))


def new_process(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "lipservo", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **options)


@pytest.fixture
def short_clip(tmp_path) -> Path:
    """The first 1.5 s of the bundled clip."""
    samples, rate_hz = soundfile.read(CLIP)
    path = tmp_path / "short.wav"
    soundfile.write(path, samples[: int(1.5 * rate_hz)], rate_hz)
    return path


def trace_of(path: Path) -> tuple[dict, list[dict], dict]:
    header, *ticks, end = [json.loads(line) for line in path.read_text().splitlines()]
    return header, ticks, end


def test_replay_prints_one_json_object_with_the_figures():
    done = lipservo("replay", CLIP, "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["frames_sent"] == pytest.approx(30 * (summary["duration_s"] + 0.77 + 0.5), abs=3)
    assert summary["phonemes"] > 40
    assert summary["late_ticks"] == 0
    assert summary["stale_ticks"] == 0


def test_two_replays_leave_identical_traces(tmp_path):
    for name, play in (("a", lipservo), ("b", new_process)):
        assert play("replay", CLIP, "-q", "--trace", tmp_path / name).returncode == 0
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_the_trace_tells_every_tick_and_the_mouth_opens_and_ends_closed(tmp_path):
    trace = tmp_path / "trace.jsonl"
    assert lipservo("replay", CLIP, "-q", "--trace", trace).returncode == 0
    header, ticks, end = trace_of(trace)
    jaw = header["servos"].index("jaw")
    assert end == {"ticks": len(ticks), "dropped": 0}
    angles_deg = [tick["sent_deg"][jaw] for tick in ticks]
    assert max(angles_deg) > 4.0
    assert abs(angles_deg[-1]) < 0.5
    assert {tick["phoneme"] for tick in ticks} > {"SIL", "M"}
    assert not list(tmp_path.glob("*.partial"))


def test_run_plays_a_file_in_real_time_and_prints_a_table(short_clip):
    done = new_process("run", "--wav", short_clip)
    assert done.returncode == 0, done.stderr
    assert "frames sent" in done.stdout
    assert "delay from sound to face" in done.stderr


@pytest.mark.parametrize("command", ["run", "daemon"])
def test_ctrl_c_eases_to_neutral_and_completes_the_trace(tmp_path, command):
    trace = tmp_path / "trace.jsonl"
    arguments = [command, "--trace", str(trace), "--json"]
    if command == "daemon":
        arguments += ["--wav", str(CLIP)]
    process = subprocess.Popen(
        [sys.executable, "-m", "lipservo", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    partial = trace.with_name(trace.name + ".partial")
    while not partial.exists() or partial.stat().st_size < 2_000:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=120)
    assert process.returncode == (130 if command == "run" else 0), stderr
    assert json.loads(stdout)["frames_sent"] > 0
    _, ticks, end = trace_of(trace)
    assert end["ticks"] == len(ticks) > 0


def test_an_idle_daemon_keeps_the_mouth_closed_until_stopped(tmp_path):
    trace = tmp_path / "trace.jsonl"
    process = subprocess.Popen(
        [sys.executable, "-m", "lipservo", "daemon", "--trace", str(trace), "--quiet"],
        stderr=subprocess.PIPE,
    )
    partial = trace.with_name(trace.name + ".partial")
    while not partial.exists() or partial.stat().st_size < 8_000:
        assert process.poll() is None
        time.sleep(0.02)
    process.terminate()
    assert process.wait(timeout=120) == 0
    process.stderr.close()
    _, ticks, _ = trace_of(trace)
    assert np.abs([tick["sent_deg"] for tick in ticks]).max() == 0.0


def write_sound(tmp_path: Path, samples: np.ndarray, **options: object) -> Path:
    path = tmp_path / "sound.wav"
    soundfile.write(path, samples, 16_000, **options)
    return path


def silent(tmp_path: Path) -> Path:
    return write_sound(tmp_path, np.zeros(16_000))


def nan(tmp_path: Path) -> Path:
    samples = np.full(16_000, 0.1, np.float32)
    samples[800] = np.nan
    return write_sound(tmp_path, samples, subtype="FLOAT")


def no_samples(tmp_path: Path) -> Path:
    return write_sound(tmp_path, np.zeros(0))


def text(tmp_path: Path) -> Path:
    path = tmp_path / "sound.wav"
    path.write_text("not a sound")
    return path


def missing(tmp_path: Path) -> Path:
    return tmp_path / "none.wav"


@pytest.mark.parametrize("make", [silent, nan, no_samples, text, missing])
@pytest.mark.parametrize("command", [("replay",), ("run", "--wav")])
def test_bad_sound_ends_in_one_clear_line_and_writes_nothing(tmp_path, make, command):
    sound = make(tmp_path)
    before = set(tmp_path.iterdir())
    done = lipservo(*command, sound, "--trace", tmp_path / "trace.jsonl")
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("lipservo: ")
    assert sound.name in line
    assert set(tmp_path.iterdir()) == before


FACE = (resources.files("lipservo.config") / "face_sim.yaml").read_text()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("name: simulated", "nam: simulated", "face.yaml.nam: unknown setting; did you mean name?"),
        ("id: 11", "id: eleven", "face.yaml.servos.jaw.id: 'eleven' is not a whole number"),
        ("id: 12", "id: 11", "jaw and upper_lip_left both have id 11"),
        ("max_deg: 25", "max_deg: -5", "needs min_deg <= 0 <= max_deg"),
        ("lip_protrusion:", "lip_pout:", "servo 'lip_pout' has no calibration"),
        ("max_deg: 25", "max_deg: 24", "its servos or limits have changed since"),
        (
            "calibration: face_sim",
            "calibration: other",
            "calibration 'other.calibration.yaml' is not",
        ),
    ],
)
def test_a_mistake_in_the_face_is_explained(tmp_path, old, new, said):
    assert old in FACE
    path = tmp_path / "face.yaml"
    path.write_text(FACE.replace(old, new))
    done = lipservo("replay", CLIP, "--config", path)
    assert done.returncode == 1
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_a_damaged_model_is_refused(tmp_path):
    path = tmp_path / "model.npz"
    path.write_bytes(b"PK nonsense")
    done = lipservo("replay", CLIP, "--model", path)
    assert done.returncode == 1
    assert "damaged or not a lipservo model" in done.stderr


def test_a_trace_that_cannot_be_written_is_refused_before_anything_moves(tmp_path):
    done = lipservo("replay", CLIP, "--trace", tmp_path / "no" / "folder.jsonl")
    assert done.returncode == 1
    assert "cannot be written" in done.stderr


def test_wav_and_mic_together_are_refused():
    done = lipservo("run", "--wav", CLIP, "--mic", "default")
    assert done.returncode == 2
    assert "not both" in done.stderr


def test_train_writes_a_model_that_a_calibration_and_a_replay_accept(tmp_path, short_clip):
    folder = write_corpus(tmp_path / "corpus", 8)
    model = tmp_path / "model.npz"
    done = lipservo("learn", "face", folder, "-o", model, "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["sentences"] == 8
    assert 0.5 < figures["variance_held"] <= 1.0
    face = tmp_path / "face.yaml"
    face.write_text(FACE)
    calibration = tmp_path / "face_sim.calibration.yaml"
    done = lipservo(
        "calibrate", "fit", "--config", face, "--model", model, "--no-lags", "-o", calibration
    )
    assert done.returncode == 0, done.stderr
    done = lipservo("replay", short_clip, "--config", face, "--model", model, "--json")
    assert done.returncode == 0, done.stderr


def test_train_names_the_bad_file_and_goes_on_with_skip_bad(tmp_path):
    folder = write_corpus(tmp_path / "corpus", 4)
    (folder / "audio" / "s2.flac").unlink()
    model = tmp_path / "model.npz"
    done = lipservo("learn", "face", folder, "-o", model)
    assert done.returncode == 1
    assert "s2.flac" in done.stderr
    assert not model.exists()
    done = lipservo("learn", "face", folder, "-o", model, "--skip-bad", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["skipped"] == 1


def test_without_portaudio_the_microphone_names_the_debian_package(tmp_path):
    """A sounddevice module that fails as the real one does without its library."""
    (tmp_path / "sounddevice.py").write_text("raise OSError('PortAudio library not found')\n")
    done = new_process("run", "--mic", env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert done.returncode == 1
    assert "libportaudio2" in done.stderr
    assert "Traceback" not in done.stderr
