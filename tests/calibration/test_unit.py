"""A design's calibration on another unit: what its poses tell, and what its map becomes."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_model import small_model

from calibration.calibration import CalibrationError
from calibration.capture.capture import CapturedPose, KeptPoses, plan_around
from calibration.closure import Closure
from calibration.grade import HoldOutErrors
from calibration.mouth_servos import JointRange, MouthServos, linear_calibration
from calibration.unit import Unit, unit_by_eye, unit_by_markers

MODEL = small_model()
SERVOS = MouthServos(tuple(JointRange(name, -90.0, 90.0) for name in ("jaw", "lip", "corner")))
LIMITS_DEG = SERVOS.limits_deg
RNG = np.random.default_rng(4)
UNIT = Unit(np.array([3.0, -5.0, 1.5]), np.array([1.05, 0.93, 1.0]), 0.4)


@pytest.fixture
def design():
    """Return a design of three joints with bends, a trim and lips that meet."""
    n = MODEL.n_components
    closure = Closure(
        speaker_mm=np.zeros((3, n)), speaker_rest_mm=np.array([0.0, 9.0, 0.0]),
        opens_mm=np.zeros((1, n)), at_deg=np.array([1.0, 2.0, 3.0]), gaps_mm=np.array([0.2]),
        slopes=RNG.normal(size=(1, 3)), bends=RNG.normal(size=(1, 6)) / 50.0,
        turns_deg=np.zeros((3, 1)), press_mm=1.0,
    )  # fmt: skip
    return linear_calibration(
        MODEL, SERVOS, RNG.normal(size=(3, n)), errors=HoldOutErrors(joint_rms_deg=(0.0,) * 3),
        rest_deg=RNG.normal(size=3), closure=closure, trim={"P": np.array([2.1, 0.0, -1.0])},
        quadratic_weights=RNG.normal(size=(3, n * (n + 1) // 2)) / 9.0,
    )  # fmt: skip


def bent_face(design_deg, later_mm=0.0):
    """Return markers (n, 20, 3) that are bent in three joints; `later_mm` moves four of them."""
    turn_rad = np.deg2rad(design_deg)
    parts = np.concatenate([np.sin(turn_rad), 1.0 - np.cos(turn_rad)], axis=1)
    shapes = np.random.default_rng(2).normal(0.0, 10.0, (6, 20, 3))
    places = np.random.default_rng(3).normal(0.0, 30.0, (20, 3))
    touched = np.zeros((20, 3))
    touched[:4, 1] = later_mm
    return (
        places
        + np.tensordot(parts, shapes, axes=1)
        + touched * (design_deg[:, :1] < 0.0)[..., None]
    )


def test_a_units_map_makes_the_designs_angles_and_its_lips_meet_later(design):
    unit = UNIT.calibration(design, LIMITS_DEG)
    faces = MODEL.rest + RNG.normal(size=(30, MODEL.n_components))
    assert UNIT.design_deg(unit.poses_deg(faces)) == pytest.approx(design.poses_deg(faces))
    unit_deg = RNG.uniform(-20.0, 20.0, (9, 3))
    later_mm = unit.closure.open_mm(unit_deg) - design.closure.open_mm(UNIT.design_deg(unit_deg))
    assert later_mm == pytest.approx(0.4)
    assert unit.trim["P"] == pytest.approx([2.0, 0.0, -1.0])


def test_a_tracker_that_stands_elsewhere_and_lost_dots_tell_horns_links_and_contact():
    poses_deg = RNG.uniform(-25.0, 25.0, (15, 3))
    turn = Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix()
    seen_mm = bent_face(UNIT.design_deg(poses_deg), 0.4) @ turn.T + [40.0, -7.0, 3.0]
    seen_mm[3, 5] = np.nan
    seen_mm[:, 7, 2] = np.nan
    found = unit_by_markers(bent_face, poses_deg, seen_mm, 0.02)
    assert found.unit.zero_deg == pytest.approx(UNIT.zero_deg, abs=0.1)
    assert found.unit.scale == pytest.approx(UNIT.scale, abs=0.01)
    assert found.unit.later_mm == pytest.approx(0.4, abs=0.05)
    elsewhere_deg = RNG.uniform(-25.0, 25.0, (8, 3))
    expected_mm = bent_face(UNIT.design_deg(elsewhere_deg)) @ turn.T + [40.0, -7.0, 3.0]
    known = [n for n in range(20) if n != 7]
    made_mm = found.markers_mm(bent_face(found.unit.design_deg(elsewhere_deg)))
    assert made_mm[:, known] == pytest.approx(expected_mm[:, known], abs=0.1)


def test_without_depth_horns_are_told_by_what_is_seen_from_the_front():
    poses_deg = RNG.uniform(-25.0, 25.0, (15, 3))
    seen_mm = bent_face(UNIT.design_deg(poses_deg), 0.4) + np.array([40.0, -7.0, 0.0])
    seen_mm[..., 2] = np.nan
    found = unit_by_markers(bent_face, poses_deg, seen_mm, 0.02)
    assert found.unit.zero_deg == pytest.approx(UNIT.zero_deg, abs=0.2)
    assert np.isfinite(found.markers_mm(bent_face(poses_deg))).all()


def test_poses_of_something_else_are_refused_and_the_worst_is_named():
    poses_deg = RNG.uniform(-25.0, 25.0, (15, 3))
    seen_mm = bent_face(poses_deg) + RNG.normal(0.0, 0.1, (15, 20, 3))
    seen_mm[11] += RNG.normal(0.0, 5.0, (20, 3))
    with pytest.raises(CalibrationError, match=r"do not fit the design, by .* worst in pose 12"):
        unit_by_markers(bent_face, poses_deg, seen_mm, 0.1)


def test_a_persons_poses_tell_horns_and_where_lips_meet(design):
    made_deg = RNG.uniform(-25.0, 25.0, (14, 3))
    unit = unit_by_eye(design, UNIT.design_deg(made_deg), made_deg)
    assert unit.zero_deg == pytest.approx(UNIT.zero_deg, abs=0.5)
    assert unit.scale == pytest.approx(UNIT.scale, abs=0.05)  # drawn to the design's, 1
    assert np.sign(unit.scale[:2] - 1.0).tolist() == [1.0, -1.0]
    met_mm = unit.calibration(design, LIMITS_DEG).closure.open_mm(made_deg[:1])[0, 0]
    assert met_mm == pytest.approx(0.0, abs=1e-9)


def test_a_servo_that_turns_the_other_way_is_named(design):
    made_deg = np.linspace(-40.0, 40.0, 14)[:, None] * np.ones(3)
    with pytest.raises(CalibrationError, match="the poses of lip do not fit"):
        unit_by_eye(design, made_deg * [1.0, -1.0, 1.0], made_deg)


def test_a_horn_a_tooth_off_is_named_and_one_put_on_askew_is_not():
    Unit(np.array([7.0, -7.0, 0.0]), np.ones(3), 0.0).check_horns(SERVOS.names)
    with pytest.raises(CalibrationError, match=r"tooth of a horn: lip -14 deg; put it"):
        Unit(np.array([7.0, -14.4, 0.0]), np.ones(3), 0.0).check_horns(SERVOS.names)


def test_a_designs_poses_come_back_from_its_file_with_sides_and_ladders(tmp_path):
    plan = plan_around(RNG.uniform(-30.0, 30.0, (5, 3)), SERVOS.joints, seed=1)
    plan = dataclasses.replace(plan, ladders=np.array([0, 0, 1, 1, 2]))
    kept = KeptPoses(tmp_path / "base.yaml.poses", mounting="another robot's")
    seen_mm = RNG.normal(size=(5, 2, 3)).round(4)
    for row in (0, 4, 2, 1, 3):
        kept.add(CapturedPose(row, plan.goals_deg[row], seen_mm[row]), plan, ("a", "b"))
    found = KeptPoses(kept.path).capture()
    assert (found.servo_names, found.marker_names) == (SERVOS.names, ("a", "b"))
    assert found.goals_deg == pytest.approx(plan.goals_deg, abs=1e-4)
    assert np.array_equal(found.from_below, plan.from_below)
    assert found.ladders.tolist() == [0, 0, 1, 1, 2]
    assert np.array_equal(found.markers_mm, seen_mm)


@pytest.mark.parametrize(
    "change", [(', "from_below": [', ', "side": ['), ('"goals_deg": [', '"goals_deg": [[')]
)
def test_poses_without_their_sides_or_half_a_line_are_refused(tmp_path, change):
    plan = plan_around(np.zeros((1, 3)), SERVOS.joints)
    kept = KeptPoses(tmp_path / "base.yaml.poses")
    kept.add(CapturedPose(0, plan.goals_deg[0], np.zeros((1, 3))), plan, ("a",))
    kept.path.write_text(kept.path.read_text().replace(*change))
    with pytest.raises(CalibrationError, match=r"base\.yaml\.poses"):
        kept.capture()
    kept.path.unlink()
    with pytest.raises(CalibrationError, match="measure the design anew"):
        kept.capture()
