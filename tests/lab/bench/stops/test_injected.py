"""Troubles put into processes from outside: they take effect, and only while they are on."""

import importlib
import os
import subprocess
import sys

import pytest
from lipservo_lab.bench.stops import injected
from lipservo_lab.bench.stops.injected import SLOW_S, STATUS_MAKERS, Troubles


def test_what_is_delayed_is_slow_while_the_trouble_is_on_and_leaves_a_mark(tmp_path):
    slept_s = []
    slow = Troubles(str(tmp_path), slept_s.append).delayed(lambda value: value + 1, "disk")

    assert slow(1) == 2
    assert slept_s == []
    (tmp_path / "disk").touch()
    assert slow(1) == 2
    assert slept_s == [SLOW_S]
    assert (tmp_path / "seen.disk").exists()


def test_a_status_raises_and_one_that_hangs_goes_on_when_the_trouble_is_over(tmp_path):
    def end(_seconds):
        (tmp_path / "status_hangs").unlink()

    failing = Troubles(str(tmp_path), end).failing(lambda: "status", may_hang=True)

    (tmp_path / "status_hangs").touch()
    assert failing() == "status"
    assert not (tmp_path / "status_hangs").exists()
    (tmp_path / "status_raises").touch()
    with pytest.raises(RuntimeError, match="injected"):
        failing()


def test_the_functions_that_are_made_to_fail_exist():
    for module, name in STATUS_MAKERS:
        assert callable(getattr(importlib.import_module(module), name))


@pytest.mark.parametrize("is_on", [False, True])
def test_a_process_that_loads_it_has_the_trouble_in_the_module_that_makes_the_status(
    tmp_path, is_on
):
    with open(injected.__file__, encoding="utf-8") as file:
        (tmp_path / "sitecustomize.py").write_text(file.read())
    if is_on:
        (tmp_path / "status_raises").touch()
    code = "from lipservo.runtime.status.face_status import whole_status; whole_status({}, None)"
    environment = os.environ | {
        injected.FOLDER_VARIABLE: str(tmp_path),
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
    }

    ended = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )

    assert ("injected" in ended.stderr) == is_on
    assert (ended.returncode == 0) == (not is_on), ended.stderr
