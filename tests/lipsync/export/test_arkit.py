"""Frames as ARKit's 52 blendshapes: what holds for every face that speech makes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_model import small_model

from lipsync.animpho.units import load_face_with_animphos
from lipsync.export.arkit import (
    ARKIT_NAMES,
    GAP,
    MEASURES,
    MOUTH_NAMES,
    ArkitMap,
    MeasureError,
    lip_measures,
)
from lipsync.face.frame import Expression, Frame
from lipsync.markers import MARKERS_47, PointLayout
from lipsync.motion.finishing import BILABIAL_GAP_MM, lip_gap_of

MODEL = load_face_with_animphos()
MEASURED = lip_measures(MODEL)
ARKIT = ArkitMap(MEASURED)
FACES = MODEL.animphos.frames
COEFFICIENTS = st.lists(
    st.floats(-200.0, 200.0), min_size=MODEL.n_components, max_size=MODEL.n_components
)


def named(coefficients, expression=None):
    frame = Frame(0.0, np.asarray(coefficients), expression or Expression())
    return dict(zip(ARKIT_NAMES, ARKIT.values(frame), strict=True))


def test_there_are_apples_52_names():
    assert len(set(ARKIT_NAMES)) == 52
    mirrored = {n.replace("Left", "Right") for n in ARKIT_NAMES if n.endswith("Left")}
    assert mirrored == {name for name in ARKIT_NAMES if name.endswith("Right")}


def test_the_mouth_at_rest_is_all_zeros():
    assert set(named(MODEL.rest).values()) == {0.0}


@given(COEFFICIENTS)
def test_every_coefficient_is_from_0_to_1_whatever_the_face(coefficients):
    values = ARKIT.values(Frame(0.0, np.array(coefficients)))
    assert values.shape == (52,)
    assert values.min() >= 0.0
    assert values.max() <= 1.0


def test_recorded_speech_uses_the_whole_range_of_what_the_mouth_can_show():
    values = np.array([ARKIT.mouth(face, n % 2) for n, face in enumerate(FACES)])
    # mouthClose undoes the jaw, funnel and pucker share what the lips narrow: they reach less.
    for name, highest in zip(MOUTH_NAMES, values.max(axis=0), strict=True):
        assert highest > (0.4 if name in ("mouthClose", "mouthFunnel", "mouthPucker") else 0.99)
    assert 0.2 < np.median(values[:, MOUTH_NAMES.index("jawOpen")]) < 0.6


def test_lips_that_touch_are_closed_however_far_the_jaw_is_dropped():
    """What ARKit defines mouthClose as: it closes the lips of an open jaw."""
    gap = lip_gap_of(MODEL)
    closed = [gap.narrowed(face, BILABIAL_GAP_MM, 1.0) for face in FACES]
    seen = [named(face) for face in closed]
    jaws = np.array([each["jawOpen"] for each in seen])
    assert jaws.max() > 0.6
    for each in seen:
        assert each["jawOpen"] - each["mouthClose"] == pytest.approx(0.0, abs=0.02)
        for side in ("Left", "Right"):
            assert each[f"mouthUpperUp{side}"] <= 0.02
            assert each[f"mouthLowerDown{side}"] <= 0.02


def test_a_lower_lip_at_the_teeth_is_rolled_in_under_a_lifted_upper_lip_and_no_closure():
    """F and V on an avatar: `mouthClose` alone would show an M."""
    gap = lip_gap_of(MODEL)
    for face in FACES[::50]:
        at_teeth = gap.narrowed(face, MODEL.labiodental_gap_mm, 1.0)
        seen = named(at_teeth, Expression(lip_tuck=1.0))
        assert seen["mouthRollLower"] == 1.0
        assert seen["jawOpen"] - seen["mouthClose"] >= 0.1
        for side in ("Left", "Right"):
            assert seen[f"mouthUpperUp{side}"] >= 0.3
            assert seen[f"mouthLowerDown{side}"] == 0.0


@given(st.integers(0, len(FACES) - 1), st.floats(0.0, 15.0), st.floats(0.0, 15.0))
def test_the_opening_that_is_seen_never_falls_while_the_gap_grows(number, first_mm, second_mm):
    """The same face with its lips alone moved apart."""
    per_gap = np.linalg.pinv(MEASURED.per_face.T)[:, MEASURES.index(GAP)]
    openings = []
    for gap_mm in sorted((first_mm, second_mm)):
        each = named(FACES[number] + gap_mm * per_gap)
        openings.append(each["jawOpen"] - each["mouthClose"])
    assert openings[0] <= openings[1] + 1e-9


def test_each_movement_of_a_made_up_mouth_has_its_own_blendshapes():
    """Its components are opening, width, protrusion, upper lip, lower lip: of both sides alike."""
    model = small_model()
    arkit = ArkitMap(lip_measures(model))

    def moved(component, amount):
        face = model.rest.copy()
        face[component] += amount
        values = arkit.mouth(face)
        return {n for n, value in zip(MOUTH_NAMES, values, strict=True) if value > 0.05}

    assert moved(1, 6.0) == {"mouthStretchLeft", "mouthStretchRight"}
    assert moved(1, -6.0) == {"mouthPucker"}
    assert moved(3, 8.0) == {"mouthUpperUpLeft", "mouthUpperUpRight"}
    assert moved(4, 8.0) == {"mouthLowerDownLeft", "mouthLowerDownRight"}
    # The lips of this mouth part a little less than its jaw drops.
    assert moved(0, 30.0) == {"jawOpen", "mouthClose"}


def test_eyes_lids_and_brows_are_those_of_the_expression():
    said = named(MODEL.rest, Expression(lid_left=0.4, lid_right=2.0, brow=0.5, eye_yaw_deg=15.0))
    assert {name: value for name, value in said.items() if value} == {
        "eyeBlinkLeft": 0.4, "eyeBlinkRight": 1.0, "browInnerUp": 0.5, "browOuterUpLeft": 0.5,
        "browOuterUpRight": 0.5, "eyeLookOutLeft": 0.5, "eyeLookInRight": 0.5,
    }  # fmt: skip
    down = named(MODEL.rest, Expression(eye_pitch_deg=-60.0))
    assert {n for n, v in down.items() if v} == {"eyeLookDownLeft", "eyeLookDownRight"}


def test_a_face_without_the_needed_points_is_refused_in_one_line():
    model = small_model()
    groups = tuple(
        (name, tuple(n for n in numbers if n != 152)) for name, numbers in MARKERS_47.groups
    )
    object.__setattr__(model, "layout", PointLayout("few", groups, (13, 14)))
    with pytest.raises(MeasureError, match="layout few lacks landmark 152"):
        lip_measures(model)
