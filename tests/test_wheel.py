"""The wheel holds what it must, and runs alone in an empty environment."""

import json
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = {"config": "lipservo.config"}


def test_every_package_folder_is_listed_in_pyproject():
    """The list is explicit, so a forgotten sub-package would be missing from the wheel only."""
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())
    listed = set(pyproject["tool"]["setuptools"]["packages"])
    found = set()
    for top in ("calibration", "config", "firmware_bridge", "lipservo", "lipsync"):
        for init in (ROOT / top).rglob("__init__.py"):
            name = ".".join(init.parent.relative_to(ROOT).parts)
            found.add(SOURCES.get(name, name))
    assert listed == found


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--wheel", "--outdir", str(out), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    (built,) = out.glob("*.whl")
    return built


@pytest.mark.packaging
def test_the_wheel_holds_data_and_no_top_level_config(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {
        "calibration", "firmware_bridge", "lipservo", "lipsync",
    }  # fmt: skip
    for needed in (
        "firmware_bridge/dynamixel/control_tables.yaml",
        "lipservo/config/lipservo.service",
        "lipservo/config/face_sim.yaml",
        "lipservo/config/face_sim.calibration.yaml",
        "lipservo/clips/welcome.flac",
        "lipsync/models/grid_s1.npz",
        "lipsync/models/grid_s1.md",
        "lipsync/models/recognizer.npz",
        "lipsync/models/recognizer.md",
        "lipsync/models/recognizer_grid.npz",
        "lipsync/models/recognizer_grid.md",
        "lipservo/py.typed",
    ):
        assert needed in names


@pytest.mark.packaging
def test_the_installed_wheel_runs_the_main_job_in_an_empty_environment(wheel, tmp_path):
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    install = [str(python), "-m", "pip", "install", "--quiet", str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    command = [str(tmp_path / "venv" / "bin" / "lipservo"), "run", "--json"]
    run = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path)
    summary = json.loads(run.stdout)
    assert summary["source"] == "welcome.flac"
    assert summary["frames_sent"] > 200
    assert summary["phonemes"] > 40
