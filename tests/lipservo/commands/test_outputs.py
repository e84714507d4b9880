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
from speech import CLIP_PATH as CLIP
from speech import clip_start


def new_process(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "lipservo", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **options)


def trace_of(path: Path) -> tuple[dict, list[dict], dict]:
    header, *ticks, end = [json.loads(line) for line in path.read_text().splitlines()]
    return header, ticks, end


def test_a_replay_prints_its_figures_and_every_replay_leaves_the_same_trace(tmp_path):
    """The trace tells every tick; the mouth opens and ends closed."""
    done = lipservo("replay", CLIP, "--json", "--trace", tmp_path / "a")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["frames_sent"] == pytest.approx(30 * (summary["duration_s"] + 0.77 + 0.5), abs=3)
    assert summary["phonemes"] > 40
    assert (summary["late_ticks"], summary["stale_ticks"]) == (0, 0)

    header, ticks, end = trace_of(tmp_path / "a")
    jaw = header["servos"].index("jaw")
    assert end == {"ticks": len(ticks), "dropped": 0}
    angles_deg = [tick["sent_deg"][jaw] for tick in ticks]
    assert max(angles_deg) > 4.0
    assert abs(angles_deg[-1]) < 0.5
    assert {tick["phoneme"] for tick in ticks} > {"SIL", "M"}

    assert new_process("replay", CLIP, "-q", "--trace", tmp_path / "b").returncode == 0
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}


def test_run_plays_a_file_in_real_time_as_the_yaml_says_and_prints_a_table(tmp_path):
    face = tmp_path / "face.yaml"
    face.write_text(f"{FACE}\nmotion: {{strategy: naive}}\n")
    done = new_process("run", "--wav", clip_start(tmp_path), "--config", face)
    assert done.returncode == 0, done.stderr
    assert "strategy naive" in done.stderr
    assert "frames sent" in done.stdout
    assert "delay from sound to face" in done.stderr


def ended(trace: Path, n_bytes: int, number: signal.Signals, *arguments: object):
    """A face that gets a signal once its trace has so many bytes; status, output and errors."""
    with subprocess.Popen(
        [sys.executable, "-m", "lipservo", *map(str, arguments), "--trace", str(trace)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        partial = trace.with_name(trace.name + ".partial")
        while not partial.exists() or partial.stat().st_size < n_bytes:
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(number)
        stdout, stderr = process.communicate(timeout=120)
    return process.returncode, stdout, stderr


@pytest.mark.parametrize(
    ("command", "expected"), [(["run"], 130), (["daemon", "--wav", CLIP], 0)], ids=["run", "daemon"]
)
def test_ctrl_c_eases_to_neutral_and_completes_the_trace(tmp_path, command, expected):
    trace = tmp_path / "trace.jsonl"
    status, stdout, stderr = ended(trace, 2_000, signal.SIGINT, *command, "--json")
    assert status == expected, stderr
    assert json.loads(stdout)["frames_sent"] > 0
    _, ticks, end = trace_of(trace)
    assert end["ticks"] == len(ticks) > 0


def test_an_idle_daemon_keeps_the_mouth_closed_until_stopped(tmp_path):
    trace = tmp_path / "trace.jsonl"
    status, _, stderr = ended(trace, 8_000, signal.SIGTERM, "daemon", "--quiet")
    assert status == 0, stderr
    _, ticks, _ = trace_of(trace)
    assert np.abs([tick["sent_deg"] for tick in ticks]).max() == 0.0


#: Of one second each; no sound is text, and None is no file. tests/data/bad_inputs.txt has more.
BAD_SOUNDS = {
    "silent": np.zeros(16_000),
    "nan": np.where(np.arange(16_000) == 800, np.nan, 0.1),
    "no samples": np.zeros(0),
    "text": "not a sound",
    "missing": None,
}


@pytest.mark.parametrize("bad", BAD_SOUNDS.values(), ids=BAD_SOUNDS)
@pytest.mark.parametrize("command", [("replay",), ("run", "--wav")])
def test_bad_sound_ends_in_one_clear_line_and_writes_nothing(tmp_path, bad, command):
    sound = tmp_path / "sound.wav"
    if isinstance(bad, str):
        sound.write_text(bad)
    elif bad is not None:
        soundfile.write(sound, bad, 16_000, subtype="FLOAT")
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
        ("lip_protrusion:", "lip_pout:", "servo 'lip_pout' has no calibration"),
        ("max_deg: 25", "max_deg: 24", "its servos or limits have changed since"),
        ("calibration: face_", "calibration: my", "calibration 'mysim.calibration.yaml' is not"),
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


def test_without_portaudio_the_microphone_names_the_debian_package(tmp_path):
    """A sounddevice module that fails as the real one does without its library."""
    (tmp_path / "sounddevice.py").write_text("raise OSError('PortAudio library not found')\n")
    done = new_process("run", "--mic", env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert done.returncode == 1
    assert "libportaudio2" in done.stderr
    assert "Traceback" not in done.stderr
