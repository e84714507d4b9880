"""Poses made with the fingers: what keys do, and what a calibration learns from the poses."""

import contextlib
import dataclasses
import io

import numpy as np
import pytest
from dynamixel_chain import MemoryFace
from rich.console import Console
from rich.live import Live

from calibration.calibration import CalibrationError
from calibration.files.calibration_file import load_calibration, parse_calibration
from calibration.files.calibration_text import calibration_text
from calibration.fit.guided import kept_poses
from calibration.mouth_servos import JointRange, MouthServos
from firmware_bridge.dynamixel.mounting import mounted_servos
from lipservo.calibrating.guided_calibration import LimpFront
from lipservo.calibrating.hand_poses import (
    CLOSED,
    HAND_POSES,
    ROUNDED,
    TOUCHED,
    WIDEST,
    beyond_limits,
    pose_lines,
    with_hand_poses,
)
from lipservo.calibrating.posing import make_poses
from lipservo.runtime.servos.limp_servos import LimpServos
from lipservo.settings.settings import calibration_file, load_shipped_face


class Hands:
    """Keys of a script; a callable in their place is something that fingers do before the next."""

    def __init__(self, *steps):
        self.steps = list(steps)

    def next_key(self, _timeout_s):
        while self.steps and callable(self.steps[0]):
            self.steps.pop(0)()
        return self.steps.pop(0) if self.steps else "q"


@pytest.fixture
def face():
    settings = load_shipped_face("face_four")
    face = MemoryFace(servos=mounted_servos(settings.wiring))
    face.limp = LimpServos(settings, face.bus, face.clock)
    face.mouth = MouthServos(
        tuple(JointRange(n, s.min_deg, s.max_deg) for n, s in settings.mouth_servos.items()),
        positive=tuple(s.positive for s in settings.mouth_servos.values()),
    )
    with face.bus:
        yield face


def turn(face, *angles_deg):
    def turned():
        for index, angle_deg in enumerate(angles_deg):
            face.chain.servos[index].stand_at(face.servos[index].pulse(angle_deg))

    return turned


@pytest.fixture
def pose(face, tmp_path):
    """Make hand poses by keys and fingers; a file goes on from one call to the next."""

    def made_by(*steps):
        console = Console(file=io.StringIO())
        with Live(console=console, auto_refresh=False) as live:
            front = LimpFront(face.limp, face.mouth, Hands(*steps), live, contextlib.nullcontext)
            made = make_poses(
                face.mouth.joints, HAND_POSES, front, lambda _: None, tmp_path / "kept.json"
            )
        return made, console.file.getvalue()

    return made_by


def test_a_key_keeps_the_pose_that_the_fingers_hold(face, pose, tmp_path):
    made, _ = pose(
        turn(face, 0.0), " ", turn(face, 18.0, 4.0), "\n", "x", turn(face, 1.0, -3.0), "\r"
    )
    assert list(made) == [CLOSED, WIDEST, TOUCHED]
    assert made[WIDEST] == pytest.approx([18.0, 4.0, 0.0, 0.0], abs=0.1)
    assert made[TOUCHED] == pytest.approx([1.0, -3.0, 0.0, 0.0], abs=0.1)
    kept = kept_poses(face.limp.names, tmp_path / "kept.json")
    assert list(kept) == [CLOSED, WIDEST, TOUCHED]


def test_a_pose_is_made_again_and_a_session_goes_on(face, pose):
    made, _ = pose(" ", turn(face, 18.0), " ", "b", turn(face, 15.0), " ", "q")
    assert made[WIDEST][0] == pytest.approx(15.0, abs=0.1)
    further, _ = pose(turn(face, 3.0), " ", "q")
    assert list(further) == [CLOSED, WIDEST, ROUNDED]
    assert further[WIDEST][0] == pytest.approx(15.0, abs=0.1)


def test_a_joint_outside_its_limits_is_named_and_the_pose_not_kept(face, pose):
    made, shown = pose(turn(face, 40.0), " ", turn(face, 5.0), " ", "q")
    assert "jaw: 40.0 deg is outside its limits, -2..25" in " ".join(shown.split())
    assert made[CLOSED][0] == pytest.approx(5.0, abs=0.1)
    assert list(made) == [CLOSED]


def test_a_servo_that_holds_is_named_and_the_pose_not_kept(face, pose):
    made, shown = pose(lambda: face.bus.enable_torque(2), " ", "q")
    assert not made
    assert f"{face.limp.names[2]}: holds" in shown


@pytest.fixture
def shipped():
    settings = load_shipped_face("face_four")
    return load_calibration(calibration_file(settings))


def test_poses_become_touch_pose_and_limits_and_are_in_the_file(face, shipped):
    words = dict(zip(face.limp.names, face.mouth.positive, strict=True))
    assert words["jaw"] == "opens"
    made = {
        CLOSED: np.zeros(4),
        WIDEST: np.array([16.0, 0.0, 0.0, 0.0]),
        TOUCHED: np.array([1.0, 2.0, 0.0, 0.0]),
    }
    after = with_hand_poses(shipped, face.mouth, made, 200.0)
    assert after.max_deg[0] == 16.0
    assert np.array_equal(after.min_deg, shipped.min_deg)
    assert np.array_equal(after.max_deg[1:], shipped.max_deg[1:])
    assert after.touch.positions_deg.tolist() == [1.0, 2.0, 0.0, 0.0]
    assert np.array_equal(after.weights, shipped.weights)
    read = parse_calibration(calibration_text(after), "x")
    assert {name: deg.tolist() for name, deg in read.hand_poses.items()} == {
        name: deg.tolist() for name, deg in made.items()
    }
    told = "\n".join(pose_lines(shipped, after))
    assert "jaw: limits -2.0..16.0 deg, were -2..25" in told
    assert "touched is the touch pose" in told


def test_a_closed_mouth_that_differs_from_the_maps_comes_with_its_trim(face, shipped):
    rest_deg = shipped.positions_deg(shipped.rest)
    closed = {CLOSED: rest_deg + np.array([0.0, 3.5, 0.0, 0.0])}
    told = "\n".join(pose_lines(shipped, with_hand_poses(shipped, face.mouth, closed, 200.0)))
    assert f"`lipservo calibrate trim FILE SIL {shipped.servo_names[1]} 3.5`" in told
    near = {CLOSED: rest_deg + np.array([0.0, 1.0, 0.0, 0.0])}
    told = "\n".join(pose_lines(shipped, with_hand_poses(shipped, face.mouth, near, 200.0)))
    assert "trim FILE" not in told


def test_no_joint_opens_wider_than_the_widest_pose(face, shipped):
    after = with_hand_poses(shipped, face.mouth, {WIDEST: np.array([3.0, 0.0, 0.0, 0.0])}, 200.0)
    wide = shipped.rest + np.array([30.0] + [0.0] * (len(shipped.rest) - 1))
    angles_deg = [
        each.positions_deg(shipped.rest + sign * (wide - shipped.rest))[0]
        for each in (shipped, after)
        for sign in (1.0, -1.0)
    ]
    assert max(angles_deg[:2]) > 3.0
    assert max(angles_deg[2:]) == 3.0


def test_a_pose_that_does_not_move_a_joint_does_not_lock_it(face, shipped):
    after = with_hand_poses(shipped, face.mouth, {WIDEST: np.zeros(4)}, 200.0)
    assert np.array_equal(after.max_deg, shipped.max_deg)


def test_poses_of_an_earlier_session_stay(face, shipped):
    first = with_hand_poses(shipped, face.mouth, {WIDEST: np.array([16.0, 0, 0, 0])}, 200.0)
    second = with_hand_poses(first, face.mouth, {TOUCHED: np.zeros(4)}, 200.0)
    assert set(second.hand_poses) == {WIDEST, TOUCHED}
    assert second.max_deg[0] == 16.0


def test_no_pose_or_one_with_a_servo_never_heard_is_refused(face, shipped):
    with pytest.raises(CalibrationError, match="no pose was kept"):
        with_hand_poses(shipped, face.mouth, {}, 200.0)
    with pytest.raises(CalibrationError, match="gave no position"):
        with_hand_poses(shipped, face.mouth, {CLOSED: np.full(4, np.nan)}, 200.0)


def test_a_degree_beyond_a_limit_counts_as_at_it(face, shipped):
    nearly = np.array([25.6, 0.0, 0.0, 0.0])
    assert beyond_limits(face.mouth, nearly) == {}
    kept = with_hand_poses(shipped, face.mouth, {CLOSED: nearly}, 200.0)
    assert kept.hand_poses[CLOSED][0] == 25.0


def test_a_calibration_without_touch_gets_the_cap_that_is_proposed(face, shipped):
    bare = dataclasses.replace(shipped, touch=None)
    assert with_hand_poses(bare, face.mouth, {TOUCHED: np.zeros(4)}, 200.0).touch is not None
