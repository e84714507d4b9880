"""Nearest poses of a true robot, beside SciPy's bounded least squares."""

import numpy as np
import pytest
from lipservo_lab.bench.calibration.elastic_draws import draw_elastic_robot
from lipservo_lab.bench.calibration.shown_motion import NAMES, converged_poses_deg, wanted_shapes
from scipy.optimize import least_squares

from calibration.fit.measured import split_frames
from calibration.fit.retargeting import NEUTRAL_WEIGHT_MM_PER_DEG
from calibration.simulated.elastic_robot import ElasticFace
from lipsync.animpho.units import load_face_with_animphos


@pytest.mark.slow
def test_no_pose_that_scipy_finds_is_nearer_where_lips_stop_each_other():
    """Seed 106: from neutral, plain Gauss-Newton ends 0.8 mm of lips away from the nearest."""
    model = load_face_with_animphos()
    draw, servos = draw_elastic_robot(model.markers_mm(model.rest[None])[0], 106)
    face = ElasticFace(draw)
    frames = split_frames(model, 0)[1][5:400:66]
    wanted = wanted_shapes(model, face, servos, frames).features

    found = converged_poses_deg(face.markers_mm, wanted, NAMES.shape_features, servos.limits_deg)

    for row, pose_deg in enumerate(found):

        def off(angles_deg, row=row):
            shown = NAMES.shape_features.of(face.markers_mm(angles_deg[None]))[0]
            return np.concatenate([shown - wanted[row], NEUTRAL_WEIGHT_MM_PER_DEG * angles_deg])

        from_neutral = least_squares(off, np.zeros(len(pose_deg)), bounds=servos.limits_deg)
        assert np.sum(off(pose_deg) ** 2) / 2 <= 1.005 * from_neutral.cost
