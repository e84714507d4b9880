"""Ladders that close lips: contact is what moves on although the gap does not, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from small_model import small_model

from calibration.calibration import CalibrationError
from calibration.capture.capture import Capture, plan_around
from calibration.closure import CLOSED_GAP_MM, Closure, pairs
from calibration.fit.closing import find_kink, plan_ladders
from calibration.fit.learnt_face import fit_calibration
from calibration.fit.measured import closing_of
from calibration.fit.retargeting import RobotMouth, correspond, fit_retargeting
from calibration.fit.robot_face import fit_robot_face
from calibration.fit.touch import (
    touch_plan,
    touched_by_current,
    touched_by_eye,
    touched_by_markers,
)
from calibration.grade import CONTACT, LIMITS, LearntLips
from calibration.mouth_servos import JointRange, MouthServos
from lipsync.animpho.units import load_face_with_animphos
from lipsync.markers import MARKERS_47

MODEL = small_model()
NAMES = correspond(MARKERS_47.names)
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
UPPER = [i for i, name in enumerate(MARKERS_47.names) if name in (
    "inner_lip_13", "inner_lip_82", "inner_lip_312", "outer_lip_0", "outer_lip_37", "outer_lip_267",
    "outer_lip_39", "outer_lip_269",
)]  # fmt: skip
LOWER = [i for i, name in enumerate(MARKERS_47.names) if name in (
    "inner_lip_14", "inner_lip_87", "inner_lip_317", "outer_lip_17", "outer_lip_84",
    "outer_lip_314", "outer_lip_181", "outer_lip_405", "chin_199", "chin_18", "jaw_152",
)]  # fmt: skip
STEPS_MM = np.arange(0.0, 5.2, 0.4)


def seen_mm(goals_deg: np.ndarray, stops_mm: float) -> np.ndarray:
    """A jaw that lowers the lower lip by .5 mm a degree; lips that stop each other at a gap."""
    markers_mm = np.repeat(REST_MM[None], len(goals_deg), axis=0)
    markers_mm[:, 0, 0] -= 0.1 * goals_deg[:, 1]
    lowered = 0.5 * goals_deg[:, 0]
    pressed = np.maximum(stops_mm - lowered, 0.0)
    markers_mm[:, LOWER, 1] -= (lowered + pressed / 2)[:, None]
    markers_mm[:, UPPER, 1] += (pressed / 2)[:, None]
    return markers_mm


@pytest.mark.parametrize("at", [1.2, 1.6, 2.0, 2.4, 2.8])
@pytest.mark.parametrize("seed", range(4))
def test_ladders_that_stall_are_contact_where_they_stall(at, seed):
    rng = np.random.default_rng(seed)
    stalls = -np.minimum(STEPS_MM, at) - 0.2 * np.maximum(STEPS_MM - at, 0.0)
    ladders = [stalls + rng.normal(0.0, 0.15, len(STEPS_MM)) for _ in range(3)]
    kink = find_kink([STEPS_MM] * 3, ladders, 0.15)
    assert kink.is_contact
    assert np.median(kink.at_mm) == pytest.approx(at, abs=0.8)


def test_ladders_that_go_on_to_a_limit_are_hardly_ever_contact():
    """A decision by noise: two of 1,500 such mouths are mistaken, those that bend most."""
    rng = np.random.default_rng(11)
    mistaken = 0
    for slope, curve in rng.uniform((0.7, -0.03), (1.3, 0.03), (200, 2)):
        goes_on = -slope * STEPS_MM + curve * STEPS_MM**2
        ladders = [goes_on + rng.normal(0.0, 0.25, len(STEPS_MM)) for _ in range(3)]
        mistaken += find_kink([STEPS_MM] * 3, ladders, 0.25).is_contact
    assert mistaken <= 1


def captured(low_deg: float, stops_mm: float, open_deg: float = 0.0) -> tuple[Capture, RobotMouth]:
    """A jaw from its lower limit up, at random, then ladders of closing steps."""
    joints = (JointRange("jaw", low_deg, 20.0), JointRange("out", -20.0, 20.0))
    servos = MouthServos(joints)
    mounted = np.array([open_deg, 0.0])
    mouth = RobotMouth(lambda deg: seen_mm(deg + mounted, -99.0), NAMES, servos.limits_deg)
    frames = MODEL.animphos.frames
    asked = fit_retargeting(MODEL, frames, mouth, np.full(3, stops_mm + 0.5 * open_deg))
    closes = asked.closing(frames - MODEL.rest) >= 1.0
    ladders = plan_ladders(asked, frames[closes] - MODEL.rest, 14)
    rng = np.random.default_rng(3)
    range_deg = rng.uniform((low_deg, -20.0), (20.0, 20.0), (40, 2))
    goals_deg = np.concatenate([range_deg, *(each.goals_deg for each in ladders)])
    numbers = [0] * 40 + [n + 1 for n, each in enumerate(ladders) for _ in each.goals_deg]
    noisy_mm = seen_mm(goals_deg + mounted, stops_mm)
    noisy_mm += rng.normal(0.0, 0.3, noisy_mm.shape)
    sides = rng.choice([-1.0, 1.0], goals_deg.shape)
    return (
        Capture(
            servos.names, MARKERS_47.names, goals_deg, sides, noisy_mm, ladders=np.array(numbers)
        ),
        mouth,
    )


def test_a_jaw_at_its_limit_is_named_with_the_degrees_that_are_missing():
    capture, mouth = captured(low_deg=0.0, stops_mm=0.0, open_deg=5.0)
    face = fit_robot_face(capture, NAMES.shape_features)
    closing = closing_of(face, mouth, capture)
    assert face.contact is None
    assert closing is not None
    assert (closing.evidence, closing.joint, closing.closes) == (LIMITS, "jaw", False)
    own_mm = REST_MM[MARKERS_47.upper_lip, 1] - REST_MM[MARKERS_47.lower_lip, 1]
    assert closing.apart_mm == pytest.approx(2.5 + own_mm, abs=0.4)
    assert closing.missing_deg == pytest.approx(closing.apart_mm / 0.5, rel=0.2)
    assert "jaw is at its limit" in closing.description


def test_lips_that_stop_each_other_before_the_limit_are_contact():
    capture, mouth = captured(low_deg=-10.0, stops_mm=0.0)
    face = fit_robot_face(capture, NAMES.shape_features)
    closing = closing_of(face, mouth, capture)
    assert closing is not None
    assert (closing.evidence, closing.closes) == (CONTACT, True)
    assert face.contact is not None
    own_mm = REST_MM[MARKERS_47.upper_lip, 1] - REST_MM[MARKERS_47.lower_lip, 1]
    assert face.contact.closed_mm[0] == pytest.approx(own_mm, abs=0.25)


#: A jaw that closes from 2 degrees on, by half a millimetre a degree.
CLOSURE = Closure(
    speaker_mm=np.zeros((3, MODEL.rest.shape[0])),
    speaker_rest_mm=np.zeros(3),
    opens_mm=np.zeros((1, MODEL.rest.shape[0])),
    at_deg=np.array([2.0, 0.0]),
    gaps_mm=np.zeros(1),
    slopes=np.array([[0.5, 0.0]]),
    bends=np.zeros((1, len(pairs(2)[0]))),
    turns_deg=np.array([[2.0], [0.0]]),
    press_mm=0.7,
)
SERVOS = MouthServos((JointRange("jaw", -10.0, 20.0), JointRange("out", -20.0, 20.0)))


@pytest.mark.parametrize(("from_rest_mm", "pressed_mm"), [(0.0, 0.0), (0.5, 0.35), (3.0, 0.7)])
def test_lips_press_in_speech_and_just_touch_at_rest(from_rest_mm, pressed_mm):
    """A servo that presses all day burns; recorded closures are 2.9 mm or more from the rest."""
    face = np.zeros((1, MODEL.n_components))
    face[0, 0] = from_rest_mm
    poses_deg = CLOSURE.corrected_deg(face, np.array([[6.0, 1.0]]), *SERVOS.limits_deg)
    assert CLOSURE.open_mm(poses_deg)[0, 0] == pytest.approx(-pressed_mm)


def test_no_recorded_closure_is_pressed_less():
    model = load_face_with_animphos()
    frames = model.animphos.frames
    closed = frames[model.lip_gaps_mm(model.markers_mm(frames)) <= CLOSED_GAP_MM] - model.rest
    closure = replace(CLOSURE, opens_mm=np.zeros((1, model.n_components)))
    pressed = [closure.wanted_mm(face, 0.0)[0] for face in closed]
    assert len(pressed) > 1000
    assert set(pressed) == {-closure.press_mm}


def with_closure():
    face = MouthServos((JointRange("jaw", -10.0, 20.0), JointRange("corner_left_out", -20.0, 20.0)))
    fitted = fit_calibration(MODEL, face.joints, "f" * 16)
    lips = LearntLips(0.3, 0.3, 0.0, stop=True)
    return replace(fitted, closure=CLOSURE, learnt_lips=lips)


@pytest.mark.parametrize("later_mm", [-0.5, 0.0, 0.6])
def test_touch_finds_how_much_later_lips_meet(later_mm):
    plan = touch_plan(with_closure(), MODEL, SERVOS)
    rng = np.random.default_rng(1)
    markers_mm = seen_mm(plan.goals_deg, 1.0 - later_mm)
    markers_mm += rng.normal(0.0, 0.2, markers_mm.shape)
    seen = Capture(
        SERVOS.names, MARKERS_47.names, plan.goals_deg, plan.from_below, markers_mm,
        ladders=plan.ladders,
    )  # fmt: skip
    found, told_mm = touched_by_markers(with_closure(), seen)
    assert told_mm == pytest.approx(later_mm, abs=0.25)
    assert found.closure is not None
    np.testing.assert_allclose(found.closure.gaps_mm, CLOSURE.gaps_mm + told_mm)


def test_touch_without_markers_goes_by_what_servos_draw():
    calibration = with_closure()
    plan = touch_plan(calibration, MODEL, SERVOS)
    closes_mm = -CLOSURE.open_mm(plan.goals_deg)[:, 0]
    effort = 0.1 + 0.01 * closes_mm + 0.1 * np.maximum(closes_mm - 0.4, 0.0)
    effort = effort + np.random.default_rng(2).normal(0.0, 0.004, len(effort))
    found = touched_by_current(calibration, plan, effort[:, None])
    assert found[1] == pytest.approx(0.4, abs=0.15)
    with pytest.raises(CalibrationError, match="current does not rise"):
        touched_by_current(calibration, plan, (0.1 + 0.02 * closes_mm)[:, None])


@pytest.mark.parametrize("later_mm", [-0.6, 0.0, 0.8])
def test_touch_by_eye_goes_by_the_steps_at_which_a_person_saw_the_lips_meet(later_mm):
    calibration = with_closure()
    plan = touch_plan(calibration, MODEL, SERVOS)
    closes_mm = -CLOSURE.open_mm(plan.goals_deg)[:, 0]
    rows = [np.flatnonzero(plan.ladders == number) for number in np.unique(plan.ladders)]
    touching_rows = [int(own[closes_mm[own] >= later_mm][0]) for own in rows]

    found, told_mm = touched_by_eye(calibration, plan, touching_rows)

    assert told_mm == pytest.approx(later_mm, abs=0.2)
    np.testing.assert_allclose(found.closure.gaps_mm, CLOSURE.gaps_mm + told_mm)


@pytest.mark.parametrize("off_mm", [-1.5, 2.0])
def test_contact_at_the_edge_of_what_touch_looks_at_is_refused(off_mm):
    """A horn a tooth off; whoever looked, the answer would be a guess."""
    calibration = with_closure()
    plan = touch_plan(calibration, MODEL, SERVOS)
    closes_mm = -CLOSURE.open_mm(plan.goals_deg)[:, 0]
    rows = [np.flatnonzero(plan.ladders == number) for number in np.unique(plan.ladders)]
    touching_rows = [int(own[closes_mm[own] >= off_mm][0]) for own in rows]
    with pytest.raises(CalibrationError, match="too far to correct"):
        touched_by_eye(calibration, plan, touching_rows)
    if off_mm > 0.0:
        effort = 0.1 + 0.1 * np.maximum(closes_mm - 1.4, 0.0)
        with pytest.raises(CalibrationError, match="too far to correct"):
            touched_by_current(calibration, plan, effort[:, None])


def test_a_calibration_of_before_says_that_it_knows_nothing_of_contact():
    fitted = fit_calibration(MODEL, (JointRange("jaw", -10.0, 20.0),), "f" * 16)
    with pytest.raises(CalibrationError, match="has no contact"):
        touch_plan(fitted, MODEL, SERVOS)


def test_plans_that_are_no_ladders_have_none():
    plan = plan_around(np.zeros((2, 2)), SERVOS.joints)
    assert len(plan.ladders) == 0
