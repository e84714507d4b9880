"""A face started in a folder that has a folder `lipservo` of somebody else's in it."""

import pytest
from places import ROOT

from lipservo.runtime.servos.sim_process import simulated_port

WHEEL = ("calibration", "firmware_bridge", "lipservo", "lipsync")


@pytest.mark.usefixtures("foreign_folder")
def test_a_child_process_imports_lipservo_and_not_a_folder_of_that_name():
    with simulated_port(["--config", "face_sim"]) as port:
        assert port.startswith("/dev/")


def test_no_module_starts_a_child_process_that_imports_from_the_working_directory():
    """Python's option -P keeps the working directory out of where modules are looked for."""
    sources = [path for top in WHEEL for path in (ROOT / top).rglob("*.py")]
    starting = [path for path in sources if 'sys.executable, "-P", "-m"' in path.read_text()]
    assert len(starting) > 5
    assert [path for path in sources if 'sys.executable, "-m"' in path.read_text()] == []


@pytest.fixture
def foreign_folder(tmp_path, monkeypatch):
    for name in WHEEL:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('not this one')\n")
    monkeypatch.chdir(tmp_path)
