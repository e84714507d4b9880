"""`make docs`: a site of all pages, and the reference of all public names beside it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT


@pytest.mark.packaging
def test_the_reference_is_built_without_a_warning_and_has_every_package(tmp_path):
    """With this environment in place of .venv, and without what CI has not; warnings are errors."""
    pytest.importorskip("material", reason="mkdocs-material is not installed: extra `docs`")
    for absent in ("torch", "pipecat", "livekit", "wyoming"):
        (tmp_path / f"{absent}.py").write_text(f"raise ModuleNotFoundError(name={absent!r})\n")
    site = tmp_path / "site"
    command = ["make", "--old-file=.venv/.installed-docs", "docs"]
    command += [f"BIN={Path(sys.executable).parent}", f"SITE={site}", f"PAGES={tmp_path / 'pages'}"]
    done = subprocess.run(
        command,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )

    assert done.returncode == 0, done.stderr
    index = (site / "search" / "search_index.json").read_text("utf-8")
    assert "simulated_face" in index
    assert 'src="http' not in (site / "index.html").read_text("utf-8")
    for page, name in {
        "calibration/calibration.html": "Calibration.positions_deg",
        "firmware_bridge/bus.html": "ServoBus.write_positions",
        "lipservo/runtime/street.html": "Street.tick",
        "lipsync/phonemes.html": "LiveRecognizer.feed",
    }.items():
        text = (site / "api" / page).read_text("utf-8")
        assert f'id="{name}"' in text
        assert 'src="http' not in text
