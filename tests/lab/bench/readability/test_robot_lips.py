"""What `face_sim` shows of a motion, by its encoders."""

import numpy as np
import pytest
from lipservo_lab.bench.readability.robot_lips import calibrated_robot, shown_markers_mm
from small_model import small_model

from lipservo.runtime.servos.assembly import assemble_face
from lipsync.animpho.units import load_face_with_animphos
from lipsync.errors import UserError
from lipsync.markers import MARKERS_39

RATE_HZ, SEEN_AT_HZ = 100.0, 25.0


def test_the_robots_lips_follow_the_motion_in_time():
    """Two openings of the mouth in a second, by the way from rest to a recorded open mouth."""
    robot = assemble_face("face_sim", None)
    model = load_face_with_animphos()
    gaps_mm = model.lip_gaps_mm(model.markers_mm(model.animphos.frames))
    open_face = model.animphos.frames[gaps_mm.argmax()] - model.rest
    times_s = np.arange(0.0, 1.0, 1.0 / RATE_HZ)
    opening = 0.25 * (1.0 - np.cos(4.0 * np.pi * times_s))
    faces = {"a": model.rest + opening[:, None] * open_face, "b": np.tile(model.rest, (50, 1))}
    progress = []
    shown = shown_markers_mm(
        robot, faces, RATE_HZ, SEEN_AT_HZ, lambda done, whole: progress.append((done, whole))
    )
    assert {name: each.shape for name, each in shown.items()} == {
        "a": (25, 47, 3),
        "b": (13, 47, 3),
    }
    wanted_mm = model.lip_gaps_mm(model.markers_mm(faces["a"]))[::4]
    seen_mm = model.lip_gaps_mm(shown["a"])
    assert np.corrcoef(wanted_mm, seen_mm)[0, 1] > 0.97
    assert np.abs(seen_mm - wanted_mm).max() < 0.35 * wanted_mm.max()
    assert model.lip_gaps_mm(shown["b"]).max() < 1.0
    assert progress[-1][0] == progress[-1][1] > 2


def test_a_model_of_other_points_is_refused():
    from dataclasses import replace

    with pytest.raises(UserError, match="face_sim needs a model of 47 markers, not markers-39"):
        calibrated_robot(replace(small_model(), layout=MARKERS_39))
