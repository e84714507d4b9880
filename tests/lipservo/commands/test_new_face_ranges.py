"""`new-face --ranges` at an SCS0009, whose steps are not those of a Dynamixel."""

import json
import subprocess
import sys

import pytest

from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.settings.settings import load_face

# Real processes in real time.
pytestmark = pytest.mark.slow


def test_a_range_file_of_an_scs0009_keeps_its_neutral_where_it_stands(tmp_path):
    """400 to 620 of 1024 steps over 300 degrees, standing in the middle, at 512."""
    path, ranges = tmp_path / "mine.yaml", tmp_path / "ranges.json"
    entry = {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 400, "range_max": 620}
    ranges.write_text(json.dumps({"jaw": entry, "neck": entry | {"id": 9}}))
    with simulated_port(["--kind", "feetech", "--servos", "1", "--model", "SCS0009"]) as port:
        command = ("new-face", "-o", path, "--bus", "feetech", "--port", port, "--ranges", ranges)
        done = subprocess.run(
            [sys.executable, "-m", "lipservo", *map(str, command)],
            capture_output=True,
            text=True,
            timeout=180,
            input="\nopens\ny\n",
        )
    assert done.returncode == 0, done.stderr
    assert "id 9 (neck in " in done.stderr
    jaw = load_face(path).servos["jaw"]
    # It stands within a step of 0.3 degrees.
    assert (jaw.min_deg, jaw.max_deg) == pytest.approx((-32.8, 31.6), abs=0.35)
    assert jaw.zero_offset_deg == pytest.approx(0.0, abs=0.3)
