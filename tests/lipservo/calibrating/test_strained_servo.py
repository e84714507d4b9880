"""A capture on servos: which press, which get too little of a goal, and how long it still takes."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from dynamixel_chain import MemoryFace
from small_model import small_model

from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.errors import ServoError
from firmware_bridge.simulator.faults import Fault
from lipservo.calibrating import measured_calibration, on_page
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.measured_calibration import (
    calibrate_on_servos,
    computed_tracker,
    strained_servo,
)
from lipservo.runtime.servos.held_face import HeldFace
from lipservo.settings.settings import load_shipped_face


@pytest.mark.parametrize(
    ("cap_ma", "efforts", "named"),
    [
        (None, (1.0,), None),
        (300.0, (0.10,), None),
        (300.0, (0.19,), "jaw"),  # 0.19 x 1470 mA is 279
    ],
)
def test_nine_tenths_of_the_cap_are_pressing(cap_ma, efforts, named):
    """An XL330-M288 stalls at 1.47 A."""
    settings = load_shipped_face("face_jaw")
    servo = settings.servos["jaw"].model_copy(
        update={"model": "XL330-M288", "max_current_ma": cap_ma}
    )
    face = settings.model_copy(update={"servos": {"jaw": servo}})
    setup = CalibrationSetup(face, small_model())
    assert strained_servo(setup, np.array(efforts)) == named


def test_a_model_that_does_not_measure_current_is_never_pressing():
    settings = load_shipped_face("face_jaw")
    servo = settings.servos["jaw"].model_copy(update={"model": "XL430-W250"})
    setup = CalibrationSetup(settings.model_copy(update={"servos": {"jaw": servo}}), small_model())
    assert strained_servo(setup, np.array([1.0])) is None


def test_a_servo_that_grows_hot_ends_the_capture_and_its_pose_is_not_kept(tmp_path, monkeypatch):
    settings, keep = load_shipped_face("face_jaw"), tmp_path / "poses.jsonl"
    hot = Fault("overheat", servos=(0,), at_s=(2.0,), lasts_s=600.0, amount=65.0)
    face = MemoryFace(servos=mounted_servos(settings.wiring), faults=(hot,))
    robot = HeldFace(settings, face.clock, bus=face.bus)
    monkeypatch.setattr(measured_calibration, "held_servos", lambda _: robot)
    setup = CalibrationSetup(settings, small_model(), keep=keep, quiet=True)
    with pytest.raises(ServoError, match=r"jaw was sent .* too hot"):
        calibrate_on_servos(setup, lambda _: computed_tracker(setup))
    kept = [json.loads(line) for line in keep.read_text().splitlines()]
    assert all(abs(pose["reached_deg"][0] - pose["goals_deg"][0]) < 1.0 for pose in kept)


@pytest.mark.parametrize("change", [{"sign": -1}, {"zero_offset_deg": 3.0}, {"id": 9}])
def test_poses_that_were_captured_before_a_servo_was_mounted_anew_are_not_gone_on_with(change):
    settings = load_shipped_face("face_jaw")
    turned = settings.servos["jaw"].model_copy(update=change)
    face = settings.model_copy(update={"servos": {"jaw": turned}})
    before, after = (CalibrationSetup(each, small_model()).kept for each in (settings, face))
    assert before.mounting != after.mounting


def test_poses_that_were_stored_before_count_for_nothing_in_the_minutes_that_are_left(monkeypatch):
    now_s, told = [100.0], []
    monkeypatch.setattr(on_page, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    page = SimpleNamespace(tell=lambda _, left_min, **__: told.append(left_min))
    setup = CalibrationSetup(load_shipped_face("face_four"), small_model(), n_poses=100, lags=False)
    progress = on_page.PageWatch(page, setup).watch.progress
    n_left = setup.estimated_poses - 70
    for done, after_s in ((0, 0.0), (70, 0.1), (71, 6.0)):
        now_s[0] += after_s
        progress("poses", done, 100)
    assert told[0] is None
    assert told[1] == pytest.approx(setup.pose_s * n_left / 60.0, abs=0.01)
    assert told[2] == pytest.approx(6.0 * (n_left - 1) / 60.0, abs=0.01)
