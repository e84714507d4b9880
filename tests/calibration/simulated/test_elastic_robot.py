"""Lips that touch press and do not pass each other; a jaw that turns; servos with play."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.bench.calibration.elastic_draws import draw_elastic_robot
from small_model import small_model

from calibration.simulated.elastic_robot import ElasticFace
from calibration.simulated.robot import SimulatedRobot
from lipsync.markers import MARKERS_47

MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
UPPER, LOWER = (MARKERS_47.landmarks.index(n) for n in (13, 14))
#: The jaw's servo, from wide open to pressed shut.
CLOSING_DEG = np.array([20.0, 10.0, 5.0, 2.0, 0.0, -1.0, -2.0, -3.0, -4.0, -6.0])


def exact(seed: int = 0, n_servos: int = 4) -> ElasticFace:
    """A drawn robot that is warm from the start, hangs nowhere, and whose zeros are true."""
    draw, _ = draw_elastic_robot(REST_MM, seed, n_servos)
    none = np.zeros(n_servos)
    return ElasticFace(replace(draw, sag_deg=0.0, zero_deg=none, drift_deg=none))


@pytest.fixture(scope="module")
def face() -> ElasticFace:
    return exact()


def jaw_poses(face: ElasticFace, degrees: np.ndarray) -> np.ndarray:
    """Of the jaw's horn, whichever way its servo is mounted."""
    poses_deg = np.zeros((len(degrees), len(face.draw.signs)))
    poses_deg[:, face.draw.jaw] = degrees * face.draw.signs[face.draw.jaw]
    return poses_deg


def test_at_rest_no_dot_is_off_its_place_and_nothing_presses(face):
    state = face.state(np.zeros((1, 4)))
    assert state.markers_mm[0] == pytest.approx(face.draw.skin.dots_mm, abs=1e-9)
    assert state.force_n == pytest.approx(0.0)
    rest_gaps_mm = face.draw.skin.places_mm[:9, 1] - face.draw.skin.places_mm[9:18, 1]
    assert state.gaps_mm[0] == pytest.approx(rest_gaps_mm)


def test_lips_that_touch_press_and_lips_that_press_touch(face):
    """Complementarity, over many poses of all joints."""
    poses_deg = np.random.default_rng(3).uniform(-15.0, 15.0, (60, 4))
    state = face.state(poses_deg)
    touch = (state.gaps_mm <= 1e-6).any(axis=1)
    assert 10 < touch.sum() < 50
    assert (state.force_n[~touch] == 0.0).all()
    assert (state.force_n[touch] >= 0.0).all()
    assert (state.force_n[touch] > 0.0).any()
    assert (state.gaps_mm[state.force_n > 0.0].min(axis=1) <= 1e-6).all()


@pytest.mark.parametrize("seed", [0, 2, 5])
def test_more_closing_brings_more_force_and_no_nearer_lips(seed):
    face = exact(seed)
    state = face.state(jaw_poses(face, CLOSING_DEG))
    seen_mm = state.markers_mm[:, UPPER, 1] - state.markers_mm[:, LOWER, 1]
    pressed = state.force_n > 0.0
    assert pressed[-4:].all()
    assert not pressed[:4].any()
    assert (np.diff(state.force_n[pressed]) > 0.5).all()
    assert (np.diff(state.gaps_mm, axis=0) <= 1e-9).all()
    # Until they touch the dots come nearer by a millimetre and more a degree; then by less than a
    # tenth of that: lips are soft.
    by_deg = np.diff(seen_mm) / np.diff(CLOSING_DEG)
    assert (by_deg[:3] > 1.0).all()
    assert (by_deg[-3:] < 0.15).all()
    # Dots beside the edges: they are still apart, when lips touch, by as much as they lie off.
    off_mm = face.draw.skin.off_edge_mm[[1, 4]].sum()
    softness_mm = 0.1 * state.force_n
    assert (seen_mm >= off_mm - softness_mm - 0.01).all()
    first = int(np.flatnonzero(pressed)[0])
    assert seen_mm[first] == pytest.approx(off_mm, abs=0.25)


def test_closing_force_grows_with_the_overlap_from_nothing(face):
    force_n = [face.closing_force_n(overlap_mm) for overlap_mm in (-1.0, 0.0, 0.5, 1.0, 2.0)]
    assert force_n[:2] == [0.0, 0.0]
    # Linear while all pairs touch.
    assert force_n[3] == pytest.approx(2.0 * force_n[2], rel=1e-6)
    assert force_n[4] == pytest.approx(2.0 * force_n[3], rel=1e-6)
    assert force_n[2] > 0.1


def test_the_chin_follows_the_jaw_round_its_axis_and_the_nose_stays(face):
    moved_mm = face.markers_mm(jaw_poses(face, np.array([0.0, 10.0]))) - face.draw.skin.dots_mm
    chin, nose = (MARKERS_47.landmarks.index(n) for n in (152, 2))
    angle = np.deg2rad(face.draw.four_bar.jaw_deg(np.array([10.0]))[0])
    arm_mm = np.linalg.norm((face.draw.skin.dots_mm[chin] - face.draw.axis_mm)[1:])
    went_mm = np.linalg.norm(moved_mm[1, chin])
    assert 0.7 < went_mm / (2.0 * arm_mm * np.sin(angle / 2.0)) < 1.1
    assert moved_mm[1, chin, 1] < -5.0
    assert np.linalg.norm(moved_mm[1, nose]) < 0.1 * went_mm


def test_the_left_side_is_weak(face):
    """The rods of the corners at 30 degrees: 0.7 of the travel on the left, or nearly."""
    pose_deg = np.zeros((1, 4))
    pose_deg[0, 3] = 30.0 * face.draw.signs[3]
    moved_mm = face.markers_mm(pose_deg)[0] - face.draw.skin.dots_mm
    right, left = (MARKERS_47.landmarks.index(n) for n in (61, 291))
    ratio = np.linalg.norm(moved_mm[left]) / np.linalg.norm(moved_mm[right])
    assert 0.55 < ratio < 0.85


def test_play_leaves_the_horn_behind_by_half_of_it_on_either_side(face):
    robot = SimulatedRobot(face)
    half_deg = face.draw.play_deg / 2
    goal_deg = np.array([8.0, 8.0, 8.0, 8.0])
    assert robot.move(goal_deg) == pytest.approx(goal_deg)
    assert robot.output_deg == pytest.approx(goal_deg - half_deg)
    robot.move(goal_deg - half_deg)
    assert robot.output_deg == pytest.approx(goal_deg - half_deg)
    robot.move(goal_deg - 5.0)
    assert robot.output_deg == pytest.approx(goal_deg - 5.0 + half_deg)


def test_the_tracker_is_noisy_around_the_truth_and_the_same_for_a_seed(face):
    looks_mm = [SimulatedRobot(face, noise_seed=seed, noise_mm=0.5).measure() for seed in (1, 1, 2)]
    assert np.array_equal(looks_mm[0], looks_mm[1])
    assert not np.array_equal(looks_mm[0], looks_mm[2])
    off_mm = looks_mm[0] - face.draw.skin.dots_mm
    assert off_mm.std() == pytest.approx(0.5, rel=0.2)


def test_zeros_drift_as_the_servos_warm():
    draw, _ = draw_elastic_robot(REST_MM, 0, 4)
    face = ElasticFace(replace(draw, drift_deg=np.array([0.0, 3.0, 0.0, 0.0])))
    robot = SimulatedRobot(face, noise_mm=0.0)
    goal_deg = np.array([10.0, 0.0, 0.0, 0.0])
    seen_mm = []
    for n_moves in (1, 20, 60, 400):
        for _ in range(n_moves):
            robot.move(goal_deg)
        seen_mm.append(robot.measure())
    middle_mm = np.array(seen_mm)[:, MARKERS_47.landmarks.index(0), 1]
    assert (np.diff(middle_mm) > 0.0).all()
    warm_mm = face.markers_mm(robot.output_deg[None])[0, MARKERS_47.landmarks.index(0), 1]
    assert middle_mm[-1] == pytest.approx(warm_mm, abs=0.01)
    assert middle_mm[-1] - middle_mm[0] > 0.2
