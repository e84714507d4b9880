"""Errors that are known give the grade that they are; where the line is drawn to a bad one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from linear_face import MODEL, SERVOS, LinearFace

from calibration.calibration import (
    Calibration,
    CalibrationError,
    Origin,
    linear_calibration_parts,
)
from calibration.capture.capture import Capture
from calibration.fit.measured import MeasuredFit
from calibration.fit.measured_grade import N_GRADED, GradedPoses, graded, graded_poses, too_bad
from calibration.fit.retargeting import RobotMouth, correspond, fit_retargeting
from calibration.grade import (
    CLOSED_GAP_MM,
    Grade,
    HoldOutErrors,
    LearntLips,
    VisemeReach,
    lips_off_mm,
)
from lipsync.markers import MARKERS_47

NAMES = correspond(MARKERS_47.names)
UPPER, LOWER = ([pair[i] for pair in NAMES.shape_features.gaps] for i in (0, 1))
FRAMES = MODEL.animphos.frames
GOOD = Grade(N_GRADED, lip_rms_mm=0.5, gap_rms_mm=0.4, closed_gap_mm=0.1, gap_slope=0.95)

ERRORS = HoldOutErrors(
    *(100, 0.5, 0.4, 0.0, 0.3, 0.99, 12, 0.1, 0.05, (1.0, 1.0)), gap_slope=0.9, small_gaps_kept=1.0
)


@pytest.fixture(scope="module")
def fit() -> MeasuredFit:
    """Of a face whose truth is known: only what a grade asks of it."""
    mouth = RobotMouth(LinearFace().markers_mm, NAMES, SERVOS.limits_deg)
    retargeting = fit_retargeting(MODEL, FRAMES, mouth, np.zeros(3), press_mm=0.0)
    face = SimpleNamespace(noise_mm=0.0, backlash_deg=np.zeros(2))
    low_deg, high_deg = SERVOS.limits_deg
    quadratic_weights, rest_deg, x_range = linear_calibration_parts(2, MODEL.n_components)
    calibration = Calibration(
        servo_names=SERVOS.names,
        weights=np.ones((2, MODEL.n_components)),
        quadratic_weights=quadratic_weights,
        rest=MODEL.rest,
        rest_deg=rest_deg,
        x_range=x_range,
        min_deg=low_deg,
        max_deg=high_deg,
        errors=ERRORS,
        model_checksum=MODEL.checksum,
        face_checksum=SERVOS.face_checksum,
        origin=Origin("measured"),
    )
    return MeasuredFit(calibration, face, retargeting, NAMES, FRAMES, ())


def asked_of(fit: MeasuredFit) -> GradedPoses:
    """Poses in which the map is off, by the learnt face, as it is in all speech."""
    usual_mm = np.full(N_GRADED, ERRORS.lip_rms_mm)
    return replace(graded_poses(fit, SERVOS), expected_mm=usual_mm)


@pytest.fixture(scope="module")
def poses(fit):
    return asked_of(fit)


@pytest.fixture(scope="module")
def targets_mm(poses):
    return poses.targets_mm


@pytest.fixture(scope="module")
def own_slope(poses):
    """Of the robot's own nearest shapes: two joints do not make every opening asked for."""
    heights_mm = (poses.targets_mm[:, UPPER, 1] - poses.targets_mm[:, LOWER, 1]).mean(axis=1)
    weights = np.sqrt(poses.shares)
    return np.polyfit(poses.wanted_open_mm, heights_mm, 1, w=weights)[0]


def captured(seen_mm, rows=None) -> Capture:
    n = len(seen_mm)
    rows = range(n) if rows is None else rows
    goals_deg, sides = np.zeros((n, 2)), np.ones((n, 2))
    return Capture(SERVOS.names, MARKERS_47.names, goals_deg, sides, seen_mm, rows=tuple(rows))


def grade_of(fit: MeasuredFit, seen_mm, rows=None) -> Grade:
    return graded(fit.calibration, asked_of(fit), captured(seen_mm, rows))[0].grade


def test_the_poses_are_speech_that_was_left_out_and_three_are_closed(poses):
    """Every pose is a real frame's: its gap is one that the speaker made."""
    assert len(poses) == N_GRADED
    gaps_mm = MODEL.lip_gaps_mm(MODEL.markers_mm(FRAMES))
    assert all(np.isclose(gaps_mm, gap_mm).any() for gap_mm in poses.human_gap_mm)
    assert (poses.human_gap_mm <= CLOSED_GAP_MM).sum() == 3
    assert poses.shares.sum() == pytest.approx(1.0)
    low_deg, high_deg = SERVOS.limits_deg
    assert ((poses.plan.goals_deg >= low_deg) & (poses.plan.goals_deg <= high_deg)).all()


def test_closed_poses_count_by_the_share_of_closed_lips_in_speech(poses):
    gaps_mm = MODEL.lip_gaps_mm(MODEL.markers_mm(FRAMES))
    closed = poses.human_gap_mm <= CLOSED_GAP_MM
    assert poses.shares[closed].sum() == pytest.approx((gaps_mm <= CLOSED_GAP_MM).mean())


def test_each_pose_is_of_the_class_that_is_spoken_there(fit, poses):
    """Graded by classes: an error in one pose is its class's alone."""
    known = {viseme: VisemeReach(1.0, 0.2) for viseme in set(poses.visemes)}
    calibration = replace(fit.calibration, coverage=known)
    seen_mm = poses.targets_mm.copy()
    seen_mm[0, list(NAMES.shape_features.lips)] += [0.0, 0.0, 3.0]
    found = graded(calibration, poses, captured(seen_mm))[0].coverage
    assert sum(reach.n_measured for reach in found.values()) == N_GRADED
    assert set(found) <= {"SIL", "P", "AA", "IY", "UW"}
    for viseme, reach in found.items():
        assert reach.off_mm == 0.2
        assert (reach.measured_mm > 0.5) == (viseme == poses.visemes[0])


def test_one_wild_reading_is_left_out_and_counted_by_marker(fit, poses):
    seen_mm = poses.targets_mm.copy()
    seen_mm[4, NAMES.shape_features.lips[3]] = 9999.0
    found, lines = graded(fit.calibration, poses, captured(seen_mm))
    assert found.grade.lip_rms_mm < 0.05
    wild = MARKERS_47.names[NAMES.shape_features.lips[3]]
    assert lines == (f"1 readings were far off and left out: {wild} 1",)


def test_a_tracker_that_was_set_up_anew_is_told_by_the_nose(fit, poses):
    """Turned by 6 degrees and shifted by 3 cm: a second visit."""
    turn, at = np.deg2rad(6.0), poses.targets_mm.mean(axis=(0, 1))
    rotation = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    seen_mm = (poses.targets_mm - at) @ rotation.T + at + [30.0, -5.0, 2.0]
    found, lines = graded(fit.calibration, poses, captured(seen_mm))
    assert found.grade.lip_rms_mm < 0.05
    assert lines == ("the tracker was moved since the fit: markers are counted from the nose",)


def test_a_robot_that_does_what_it_is_asked_has_no_errors(fit, targets_mm, own_slope):
    grade = grade_of(fit, targets_mm)
    assert grade.n_poses == N_GRADED
    assert [grade.lip_rms_mm, grade.gap_rms_mm, grade.closed_gap_mm] == pytest.approx(
        [0.0, 0.0, 0.0], abs=0.05
    )
    assert grade.gap_slope == pytest.approx(own_slope)
    assert 0.9 < own_slope < 1.1


def test_lips_all_off_by_1_5_mm_are_graded_so(fit, targets_mm):
    """What jaw and chin do does not count, and lips that all go forward open nothing."""
    seen_mm = targets_mm.copy()
    lips = list(NAMES.shape_features.lips)
    seen_mm[:, lips] += [0.0, 0.0, 1.5]
    others = [i for i, name in enumerate(MARKERS_47.names) if name.startswith(("jaw", "chin"))]
    seen_mm[:, others] += 9.0
    grade = grade_of(fit, seen_mm)
    assert grade.lip_rms_mm == pytest.approx(1.5)
    assert grade.gap_rms_mm == pytest.approx(0.0, abs=0.05)


def test_poses_that_are_harder_than_speech_do_not_make_a_grade_worse(fit, poses):
    """A map 1.2 mm off there and 0.4 in all speech, the lips 1.5 mm off: 0.9 squared is beyond."""
    hard = replace(poses, expected_mm=np.full(N_GRADED, 1.2))
    seen_mm = poses.targets_mm.copy()
    seen_mm[:, list(NAMES.shape_features.lips)] += [0.0, 0.0, 1.5]
    grade = graded(fit.calibration, hard, captured(seen_mm))[0].grade
    assert grade.lip_rms_mm == pytest.approx(np.hypot(ERRORS.lip_rms_mm, 0.9))


def test_the_trackers_noise_is_taken_off(fit, targets_mm):
    """0.5 mm in each of three axes: what is left of sqrt(1.5^2 + 3 x 0.5^2) is 1.5."""
    seen_mm = targets_mm + np.random.default_rng(0).normal(0.0, 0.5, targets_mm.shape)
    seen_mm[:, list(NAMES.shape_features.lips), 2] += 1.5
    noisy = replace(fit, face=SimpleNamespace(noise_mm=0.5, backlash_deg=np.zeros(2)))
    assert grade_of(noisy, seen_mm).lip_rms_mm == pytest.approx(1.5, abs=0.1)
    assert grade_of(fit, seen_mm).lip_rms_mm == pytest.approx(np.sqrt(3.0), abs=0.1)
    assert grade_of(noisy, targets_mm).lip_rms_mm == 0.0


def test_openings_of_which_six_tenths_are_made_are_0_6_of_the_slope(fit, targets_mm, own_slope):
    seen_mm = targets_mm.copy()
    wanted_mm = targets_mm[:, UPPER, 1] - targets_mm[:, LOWER, 1]
    seen_mm[:, LOWER, 1] += 0.4 * wanted_mm
    grade = grade_of(fit, seen_mm)
    assert grade.gap_slope == pytest.approx(0.6 * own_slope)
    middle_mm = wanted_mm.mean(axis=1)
    rms_mm = np.sqrt(np.average(middle_mm**2, weights=graded_poses(fit, SERVOS).shares))
    assert grade.gap_rms_mm == pytest.approx(0.4 * rms_mm)


def test_lips_that_stay_apart_are_a_closed_gap_and_no_slope(fit, targets_mm, own_slope):
    seen_mm = targets_mm.copy()
    seen_mm[:, UPPER, 1] += 0.7
    grade = grade_of(fit, seen_mm)
    assert grade.closed_gap_mm == pytest.approx(0.7, abs=0.05)
    assert grade.gap_slope == pytest.approx(own_slope)
    assert 0.9 < own_slope < 1.1


def test_poses_that_were_not_captured_are_not_compared(fit, targets_mm):
    rows = np.array([0, 2, 3, 5, 7, 9])
    grade = grade_of(fit, targets_mm[rows], rows)
    assert (grade.n_poses, grade.lip_rms_mm) == (6, 0.0)
    with pytest.raises(CalibrationError, match="4 of 10 poses to grade by were captured"):
        grade_of(fit, targets_mm[:4], np.arange(4))


def test_a_lost_lip_does_not_spoil_the_grade(fit, targets_mm, own_slope):
    seen_mm = targets_mm.copy()
    seen_mm[1, LOWER[0]] = np.nan
    grade = grade_of(fit, seen_mm)
    assert grade.gap_slope == pytest.approx(own_slope, abs=0.1)
    assert 0.9 < own_slope < 1.1
    assert np.isfinite([grade.lip_rms_mm, grade.gap_rms_mm, grade.closed_gap_mm]).all()


def test_closed_lips_of_which_a_dot_is_hidden_are_as_far_apart_as_the_others_show(fit, poses):
    seen_mm = poses.targets_mm.copy()
    closed = poses.human_gap_mm <= CLOSED_GAP_MM
    seen_mm[:, UPPER, 1] += 5.0 * closed[:, None]
    seen_mm[closed, UPPER[0]] = np.nan
    assert grade_of(fit, seen_mm).closed_gap_mm == pytest.approx(5.0, abs=0.1)


def test_what_no_closed_pose_shows_is_an_estimate_and_said(fit, poses):
    seen_mm = poses.targets_mm.copy()
    seen_mm[np.ix_(poses.human_gap_mm <= CLOSED_GAP_MM, UPPER)] = np.nan
    found, lines = graded(fit.calibration, poses, captured(seen_mm))
    assert found.grade.closed_gap_mm == ERRORS.closed_gap_mm
    (line,) = lines
    assert "how far closed lips stay apart is estimated" in line
    seen_mm[:, UPPER] = np.nan
    with pytest.raises(CalibrationError, match="no pose shows dots of both lips"):
        graded(fit.calibration, poses, captured(seen_mm))


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({"lip_rms_mm": 2.1}, "the lips are 2.1 mm from where they should be"),
        ({"gap_slope": 0.45}, "only 45% of an opening is made"),
        ({"gap_slope": -0.3}, "only 0% of an opening is made"),
        ({"closed_gap_mm": 1.2}, "closed lips stay 1.2 mm apart"),
    ],
)
def test_a_bad_grade_says_why(fit, bad, said):
    def why(grade):
        return too_bad(replace(fit.calibration, grade=grade))

    assert why(replace(GOOD, **bad)) == said
    assert why(GOOD) is None
    assert why(None) is None
    edge = Grade(N_GRADED, lip_rms_mm=2.0, gap_rms_mm=9.0, closed_gap_mm=1.0, gap_slope=0.5)
    assert why(edge) is None


def test_an_estimate_that_is_bad_says_so_too(fit):
    """Nothing measured yet: by files."""
    bad = replace(fit.calibration, errors=replace(ERRORS, gap_slope=0.2))
    assert too_bad(bad) == "only 20% of an opening is made (estimated)"
    assert too_bad(fit.calibration) is None
    assert too_bad(replace(bad, origin=Origin("jaw alone"))) is None


def test_what_is_printed_counts_what_the_shapes_asked_for_may_be_off_by():
    """By hand: 0.3 mm in each axis beyond 0.4 of noise is 0.3 sqrt 3 in space."""
    learnt = LearntLips(left_out_rms_mm=0.5, noise_mm=0.4, own_gap_mm=1.0, stop=True)
    assert learnt.doubt_mm == pytest.approx(0.3 * np.sqrt(3))
    assert lips_off_mm(GOOD, learnt) == pytest.approx(np.sqrt(0.25 + 0.27))
    assert lips_off_mm(GOOD, None) == 0.5
    assert replace(learnt, left_out_rms_mm=0.39).doubt_mm == 0.0
