"""Every example runs as its docstring says and prints what it promises."""

import re
import subprocess
import sys

import numpy as np
import pytest
import soundfile
from places import DATA, ROOT

EXAMPLES = ROOT / "examples"
PROGRAMS = sorted(path.name for path in EXAMPLES.glob("*.py"))


def run(name, *arguments):
    """What an example prints; it must end well and say nothing on stderr."""
    command = [sys.executable, EXAMPLES / name, *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_a_recording_moves_a_simulated_face(tmp_path):
    sound = tmp_path / "vowel.wav"
    time_s = np.arange(24_000) / 16_000
    soundfile.write(sound, 0.3 * np.sin(2 * np.pi * 150 * time_s), 16_000)

    printed = run("speak_recording.py", sound)

    assert "vowel.wav: 1.50 s of sound\n" in printed
    assert int(re.search(r"^(\d+) goals were sent", printed, re.M)[1]) > 1.5 * 30
    assert int(re.search(r"is (\d+) ms behind", printed)[1]) > 200


def test_scripted_phonemes_close_the_lips_and_open_the_jaw():
    pattern = r"(\d\.\d\d) s +(\w+) +lips +(-?[\d.]+) mm +jaw +(-?[\d.]+) deg"
    rows = re.findall(pattern, run("scripted_phonemes.py"))

    assert len(rows) == 30
    gaps_mm = {said: [float(gap) for _, each, gap, _ in rows if each == said] for said in "BM"}
    assert min(gaps_mm["B"]) <= 1.0
    assert min(gaps_mm["M"]) <= 1.0
    assert max(float(gap) for _, said, gap, _ in rows if said == "AA") > 5.0
    jaws_deg = [float(jaw) for *_, jaw in rows]
    assert max(jaws_deg) > jaws_deg[0] + 2.0


def test_the_gate_keeps_a_jaw_inside_its_limits_and_its_torque_goes_off():
    printed = run("simulated_servos.py")

    rows = re.findall(r"wanted +(-?[\d.]+) deg +sent +(-?[\d.]+) deg", printed)
    wanted_deg, sent_deg = np.array(rows, dtype=float).T
    assert wanted_deg.max() == 90.0
    assert 24.0 < sent_deg.max() <= 25.0  # max_deg of config/face_jaw.yaml
    assert printed.splitlines()[-1] == (
        "stopped; the face is at rest and limp: confirmed by 1 servo"
    )


@pytest.mark.parametrize(
    ("second", "lips"), [("clip", "0.00"), ("slow_and_noisy", r"[\d.]*[1-9][\d.]*")]
)
def test_two_traces_are_compared(second, lips):
    traces = DATA / "traces"

    printed = run("compare_traces.py", traces / "clip.jsonl.gz", traces / f"{second}.jsonl.gz")

    assert re.search(rf"^lips are at most {lips} mm apart$", printed, re.M)
    assert "deg off" in printed
    assert "ms later" in printed


def test_every_example_is_listed_and_says_how_it_is_started():
    listed = (EXAMPLES / "README.md").read_text()
    for name in PROGRAMS:
        assert f"[{name}]({name})" in listed
        assert f"python examples/{name}" in (EXAMPLES / name).read_text()
