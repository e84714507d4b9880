"""What a robot should do with speech is defined by hand here, and found by the bench."""

from dataclasses import replace

import numpy as np
import pytest
from linear_face import MODEL, NEUTRAL_MM, SERVOS, LinearFace
from lipservo_lab.bench.calibration.shown_motion import (
    MOST_SCALE,
    NAMES,
    wanted_shapes,
    widest_gap_mm,
)

from calibration.mouth_servos import JointRange

FRAMES = MODEL.animphos.frames[::9]
SPEAKERS_MM = np.array([MODEL.lip_gap_mm(frame) for frame in FRAMES])
CLOSED_MM = MODEL.lip_gap_mm(MODEL.rest)
#: Upper right, middle, left; lower right, middle, left.
OFF_EDGE_MM = np.array([0.5, 0.7, 0.9, 0.1, 0.2, 0.4])
GAP_WEIGHT = 4.0


def jaw_to(most_deg):
    return replace(SERVOS, joints=(JointRange("jaw", -3.0, most_deg), SERVOS.joints[1]))


def wanted_gaps_mm(wanted):
    """(n, 3) heights: of the middle, of 82 and 87 on the right, of 312 and 317 on the left."""
    return wanted.features[:, -9:].reshape(-1, 3, 3)[..., 1] / GAP_WEIGHT


def test_the_widest_gap_is_that_of_the_jaws_end():
    assert widest_gap_mm(LinearFace(), jaw_to(24.0)) == pytest.approx(12.0)
    assert widest_gap_mm(LinearFace(), jaw_to(6.0)) == pytest.approx(3.0)


def test_scale_is_the_ratio_of_the_widest_gaps_and_at_most_1_3():
    usual_mm = [MODEL.lip_gap_mm(frame) for frame in MODEL.animphos.frames[::7]]
    speakers_widest_mm = np.quantile(usual_mm, 0.98) - CLOSED_MM
    small = wanted_shapes(MODEL, LinearFace(), jaw_to(4.0), FRAMES)
    assert small.scale == pytest.approx(2.0 / speakers_widest_mm)
    assert small.scale < MOST_SCALE
    wide = wanted_shapes(MODEL, LinearFace(), jaw_to(200.0), FRAMES)
    assert wide.scale == MOST_SCALE == 1.3


@pytest.mark.parametrize("most_deg", [4.0, 200.0])
def test_the_wanted_gap_is_the_robots_closed_gap_and_the_speakers_opening_at_scale(most_deg):
    wanted = wanted_shapes(MODEL, LinearFace(OFF_EDGE_MM), jaw_to(most_deg), FRAMES)
    of = NAMES.shape_features
    opened_mm = of.gaps_mm(MODEL.markers_mm(FRAMES))[..., 1]
    opened_mm = opened_mm - of.gaps_mm(MODEL.markers_mm(MODEL.rest[None]))[..., 1]
    own_closed_mm = [0.9, 0.6, 1.3]

    assert wanted_gaps_mm(wanted) == pytest.approx(
        own_closed_mm + wanted.scale * np.maximum(opened_mm, 0.0)
    )
    assert wanted.gap_mm == pytest.approx(wanted.scale * np.maximum(opened_mm[:, 0], 0.0), abs=1e-9)
    assert wanted.human_gap_mm == pytest.approx(SPEAKERS_MM)


def test_a_speaker_at_rest_asks_for_the_robots_own_closed_mouth():
    wanted = wanted_shapes(MODEL, LinearFace(OFF_EDGE_MM), SERVOS, MODEL.rest[None])
    assert wanted.gap_mm == pytest.approx([0.0])
    assert wanted_gaps_mm(wanted)[0] == pytest.approx([0.9, 0.6, 1.3])


def test_shapes_are_poses_of_the_robot_nearest_to_the_copies():
    """Opening is a thing that this robot does as the speaker does."""
    frame = MODEL.rest + np.array([24.0, 0.0, 0.0, 0.0, 0.0])
    wanted = wanted_shapes(MODEL, LinearFace(), SERVOS, frame[None])
    moved_mm = wanted.shapes_mm[0] - NEUTRAL_MM
    human_mm = MODEL.markers_mm(frame[None])[0] - NEUTRAL_MM
    assert moved_mm == pytest.approx(wanted.scale * human_mm, abs=0.02)
