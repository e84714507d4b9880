"""Jaw rotation, viseme trim, and range files of LeRobot."""

import io
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.learning.motion.trained_model import load_trained_model
from rich.console import Console
from small_model import small_model

from calibration.calibration import CalibrationError
from calibration.capture.lerobot_ranges import read_ranges
from calibration.fit.guided import landmark_poses
from calibration.fit.jaw import JAW_LINE, jaw_blend, speakers_jaw, steady_alphas
from calibration.mouth_servos import JointRange
from calibration.run.compensation import VisemeTrim
from calibration.simulated.face import marker_positions_mm, simulated_face
from lipservo.calibrating.guided_calibration import KeysFront
from lipservo.calibrating.posing import make_poses

RANGES = {
    "jaw": {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 2048, "range_max": 2332},
    "lip": {"id": 2, "drive_mode": 1, "homing_offset": -7, "range_min": 1000, "range_max": 3048},
}


@settings(deadline=None)  # machines are shared
@given(seed=st.integers(0, 999))
def test_the_jaw_blend_is_where_its_line_is_nearest(seed):
    """Of the least squares of LAPACK."""
    rng = np.random.default_rng(seed)
    closed, opened = rng.normal(size=(2, 9, 3)) * 10
    points = rng.normal(size=(5, 9, 3)) * 10
    towards = opened - closed
    off = (points - closed).reshape(5, -1).T
    oracle = np.linalg.lstsq(towards.reshape(-1, 1), off, rcond=None)[0][0]
    assert jaw_blend(closed, opened).alpha(points) == pytest.approx(oracle, abs=1e-8)


def test_the_jaw_of_a_simulated_face_is_found_in_degrees():
    model = small_model()
    face = simulated_face(model.markers_mm(model.rest[None])[0], ["jaw"])
    line = list(JAW_LINE)
    sweep = np.linspace(0.0, 25.0, 6)
    swept_mm = marker_positions_mm(face, sweep[:, None])[:, line]
    blend = jaw_blend(swept_mm[0], swept_mm[-1])
    alphas = steady_alphas(blend, sweep, swept_mm)
    between = np.array([2.0, 7.5, 13.0, 24.0])
    points_mm = marker_positions_mm(face, between[:, None])[:, line]
    found = np.interp(blend.alpha(points_mm), alphas, sweep)
    assert found == pytest.approx(between, abs=0.2)


def test_the_speakers_jaw_opens_with_the_lips():
    """On the shipped speaker alpha follows the lip gap: 0 at rest, near 1 in the widest frames."""
    model = load_trained_model()
    frames = model.animphos.samples[::10].reshape(-1, model.n_components)
    jaw = speakers_jaw(model)
    alpha = jaw.alpha(model.markers_mm(frames)[:, list(JAW_LINE)])
    assert jaw.alpha(model.markers_mm(model.rest[None])[:, list(JAW_LINE)])[0] == pytest.approx(0)
    assert 0.6 < np.quantile(alpha, 0.99) < 1.3
    gaps_mm = [model.lip_gap_mm(frame) for frame in frames]
    assert np.corrcoef(alpha, gaps_mm)[0, 1] > 0.7


def test_a_jaw_that_does_not_move_or_moves_back_is_refused():
    line_mm = np.random.default_rng(0).normal(size=(9, 3))
    with pytest.raises(CalibrationError, match=r"the jaw line moves by 0\.1 mm"):
        jaw_blend(line_mm, line_mm + 0.05)
    open_mm = line_mm - np.array([0.0, 9.0, 0.0])
    with pytest.raises(CalibrationError, match="does not open steadily"):
        steady_alphas(
            jaw_blend(line_mm, open_mm), np.array([0.0, 9.0]), np.array([open_mm, line_mm])
        )


def test_a_trim_comes_and_goes_within_a_phone():
    trim = VisemeTrim({"P": np.array([-2.0, 1.0])}, 2, 0.01)
    for _ in range(10):
        added = trim.feed("B")  # of the same class as P
    assert added == pytest.approx([-2.0, 1.0], rel=0.05)
    for _ in range(10):
        added = trim.feed("AA")
    assert added == pytest.approx([0.0, 0.0], abs=0.1)


def test_no_trim_adds_nothing():
    assert not VisemeTrim({}, 3, 0.01).feed("AA").any()


def write(tmp_path, content):
    path = tmp_path / "ranges.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_a_range_file_gives_ids_and_ticks(tmp_path):
    ranges = read_ranges(write(tmp_path, RANGES))
    assert (ranges["jaw"].least_tick, ranges["jaw"].most_tick) == (2048, 2332)
    assert (ranges["lip"].servo_id, ranges["lip"].homing_offset_ticks) == (2, -7)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not readable as JSON"),
        ("[]", "one entry for each joint"),
        ({"jaw": 3}, "jaw: must have the keys id, drive_mode"),
        ({"jaw": RANGES["jaw"] | {"range_max": "x"}}, r"jaw\.range_max is 'x', expected a whole"),
        ({"jaw": RANGES["jaw"] | {"id": 300}}, r"jaw\.id is 300; ids are 0 to 253"),
        ({"jaw": RANGES["jaw"] | {"range_min": 2332}}, "needs 0 <= range_min < range_max"),
    ],
)
def test_a_damaged_range_file_says_where(tmp_path, content, message):
    with pytest.raises(CalibrationError, match=message):
        read_ranges(write(tmp_path, content))


def guided_by(keys, tmp_path, keep="kept.json"):
    moved = []
    pressed = iter(keys)
    model = small_model()
    shown = model.markers_mm(model.rest[None])[0]
    console = Console(file=io.StringIO())
    made = make_poses(
        [JointRange("jaw", -2.0, 7.0), JointRange("lip_protrusion", -25.0, 40.0)],
        landmark_poses(model),
        KeysFront(model, lambda: next(pressed), console, drawn=lambda _: shown),
        moved.append,
        tmp_path / keep,
    )
    return made, moved


def test_keys_turn_the_chosen_servo_within_its_limits_and_enter_keeps_the_pose(tmp_path):
    made, moved = guided_by("dd\rDDsaA\rq", tmp_path)
    assert {name: pose.tolist() for name, pose in made.items()} == {
        "closed": [2.0, 0.0],
        "open": [7.0, -6.0],
    }
    assert not moved[-1].any()  # left in neutral


def test_a_guided_session_goes_on_where_it_was_stopped_and_poses_can_be_left_out(tmp_path):
    guided_by("d\rq", tmp_path)
    made, _ = guided_by("xdd\rbA\rq", tmp_path)
    assert {name: pose.tolist() for name, pose in made.items()} == {
        "closed": [1.0, 0.0],
        "wide": [-2.0, 0.0],
    }


def test_a_pose_made_again_is_kept_as_it_is_now(tmp_path):
    guided_by("d\rbd\rq", tmp_path)
    made, _ = guided_by("q", tmp_path)
    assert made["closed"].tolist() == [2.0, 0.0]


def test_kept_poses_of_another_face_are_refused(tmp_path):
    (tmp_path / "kept.json").write_text('{"closed": {"tail": 1.0}}')
    with pytest.raises(CalibrationError, match=r"kept\.json: not the poses of this face"):
        guided_by("q", tmp_path)
