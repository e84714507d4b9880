"""The map as it runs: lips meet where the speaker's do."""

from dataclasses import replace

import numpy as np
import pytest
from small_model import small_model

from calibration.calibration import Calibration
from calibration.fit.retargeting import (
    Retargeting,
    RobotMouth,
    correspond,
    fit_retargeting,
    gap_heights_mm,
)
from calibration.fit.run_time_map import fit_closure, fit_run_time_map
from calibration.grade import HoldOutErrors
from calibration.mouth_servos import JointRange, MouthServos, linear_calibration
from lipsync.markers import MARKERS_47

MODEL = small_model()
JOINTS = (JointRange("jaw", -8.0, 25.0), JointRange("out", -30.0, 30.0))
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
LIPS = ("outer_lip_61", "outer_lip_291", "inner_lip_13", "inner_lip_14", "outer_lip_0")
NAMES = correspond(LIPS)
NEUTRAL_MM = REST_MM[[MARKERS_47.names.index(name) for name in LIPS]]
N_DIRECT = MODEL.rest.shape[0]


def spoken(n: int) -> np.ndarray:
    """(n, n_components) off rest: from open to closed and back, otherwise at random."""
    rng = np.random.default_rng(5)
    samples = MODEL.animphos.samples.reshape(-1, N_DIRECT) - MODEL.rest
    return samples[rng.integers(0, len(samples), n)] * rng.uniform(0.0, 1.2, (n, 1))


def lowers(poses_deg: np.ndarray) -> np.ndarray:
    """(n, 2): a jaw that lowers the lower lip and a servo that widens."""
    markers_mm = np.repeat(NEUTRAL_MM[None], len(poses_deg), axis=0)
    markers_mm[:, 3, 1] -= 0.8 * poses_deg[:, 0]
    markers_mm[:, 0, 0] -= 0.2 * poses_deg[:, 1]
    markers_mm[:, 1, 0] += 0.2 * poses_deg[:, 1]
    return markers_mm


def wanted(frames: np.ndarray, press_mm: float = 0.4) -> Retargeting:
    mouth = RobotMouth(lowers, NAMES, MouthServos(JOINTS).limits_deg)
    return fit_retargeting(MODEL, frames + MODEL.rest, mouth, np.zeros(1), press_mm)


def fitted(asked: Retargeting, frames: np.ndarray) -> Calibration:
    """The map of these frames off rest."""
    poses_deg = asked.poses_deg(frames)
    return linear_calibration(
        MODEL,
        MouthServos(JOINTS),
        **fit_run_time_map(frames, poses_deg),
        closure=fit_closure(asked, frames, poses_deg),
        errors=HoldOutErrors(),
    )


def heights_mm(run: Calibration, frames: np.ndarray) -> np.ndarray:
    """(n,): of the middle gap, as the map runs; below 0 where lips press."""
    shown_mm = lowers(run.poses_deg(frames + MODEL.rest))
    return gap_heights_mm(shown_mm, NAMES.shape_features.gaps)[:, 0]


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    return spoken(200)


@pytest.fixture(scope="module")
def chosen(frames: np.ndarray) -> Calibration:
    return fitted(wanted(frames), frames)


def test_all_closures_go_as_far_past_contact_as_asked_and_no_open_mouth_is_shut(frames, chosen):
    asked = wanted(frames)
    closing = asked.closing(frames)
    # Nearer to the rest lips are pressed less: a silent mouth just touches.
    closes, opens = (closing >= 1.0) & (np.linalg.norm(frames, axis=1) >= 1.0), closing <= 0.0
    assert closes.sum() > 20
    assert opens.sum() > 50
    heights = heights_mm(chosen, frames)
    np.testing.assert_allclose(heights[closes], -0.4, atol=0.02)
    assert (heights[opens] > 0.8).all()


def test_a_jaw_that_stands_at_its_limit_closes_as_far_as_it_can(frames):
    unable = wanted(frames)
    unable = replace(unable, closed_mm=np.full(1, -8.0))
    poses_deg = fitted(unable, frames).poses_deg(frames + MODEL.rest)
    assert poses_deg[:, 0].min() == -8.0


def test_the_closure_of_a_map_knows_how_far_lips_are_apart_beyond_contact(chosen):
    assert chosen.closure is not None
    poses_deg = np.array([[3.0, 5.0], [-1.0, 0.0]])
    np.testing.assert_allclose(
        chosen.closure.open_mm(poses_deg)[:, 0],
        gap_heights_mm(lowers(poses_deg), NAMES.shape_features.gaps)[:, 0],
        atol=1e-3,
    )
