"""Axes and units of markers: what is wrong is named; a robot's own proportions are right."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_model import small_model

from calibration.calibration import CalibrationError
from calibration.capture.sanity import check_frame, frame_faults
from lipsync.markers import MARKERS_47

NAMES = MARKERS_47.names
MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
SIZES = st.floats(0.8, 1.25)


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (REST_MM * [-1, 1, 1], "are mirrored: x should grow to the robot's own left"),
        (REST_MM * [1, -1, 1], "are upside down: y should grow upwards"),
        (REST_MM * [1, 1, -1], "are turned back to front: z should grow forwards"),
        (REST_MM * [-1, -1, 1], "are turned by half a turn"),
        (REST_MM * [-1, 1, -1], "are seen from behind"),
        (REST_MM * [1, -1, -1], "are upside down and back to front"),
        (REST_MM * [-1, -1, -1], "are turned round on all three axes"),
        (REST_MM[:, [1, 0, 2]], "axes are exchanged (x is y, y is x, z is z)"),
        (REST_MM[:, [0, 2, 1]] * [1, -1, 1], "axes are exchanged (x is x, y is -z, z is y)"),
        (REST_MM[:, [2, 0, 1]], "axes are exchanged (x is z, y is x, z is y)"),
        (REST_MM * [6, -6, 0] + [640, 360, 0], "look like pixels of a picture (y grows downwards"),
        (REST_MM * [6, 6, 0] + [640, 360, 0], "look like pixels of a picture"),
    ],
)
def test_wrong_axes_are_named_and_are_never_accepted(seen, said):
    axes, size = frame_faults(NAMES, seen, MODEL)

    assert said in axes
    assert size is None
    with pytest.raises(CalibrationError, match="correct the tracker's axes and capture again"):
        check_frame(NAMES, seen, MODEL, accept=True)


@pytest.mark.parametrize(
    ("times", "said"),
    [(0.001, "0.00 times"), (0.1, "0.10 times"), (0.5, "0.50 times"), (2.0, "2.00 times")],
)
def test_metres_and_other_units_are_named_and_only_accepted_when_asked(times, said):
    with pytest.raises(CalibrationError, match=f"{said} as large .* in millimetres.*--accept"):
        check_frame(NAMES, times * REST_MM, MODEL, accept=False)
    (warning,) = check_frame(NAMES, times * REST_MM, MODEL, accept=True)
    assert said in warning


@settings(deadline=None, max_examples=60)  # machines are shared
@given(size=st.tuples(SIZES, SIZES, SIZES), seed=st.integers(0, 999), flat=st.booleans())
def test_a_face_of_other_proportions_anywhere_in_space_is_right(size, seed, flat):
    rng = np.random.default_rng(seed)
    seen_mm = REST_MM * size + rng.normal(0.0, 2.0, REST_MM.shape) + rng.normal(0.0, 300.0, 3)
    if flat:
        seen_mm[:, 2] = 0.0

    assert frame_faults(NAMES, seen_mm, MODEL) == (None, None)


def test_lost_markers_and_names_of_nobody_do_not_count():
    seen_mm = np.vstack([REST_MM * [-1, 1, 1], [[1e4, -1e4, 1e4]]])
    seen_mm[3] = np.nan
    axes, _ = frame_faults((*NAMES, "dot_7"), seen_mm, MODEL)
    assert "mirrored" in axes


def test_of_too_few_markers_nothing_is_said():
    assert frame_faults(NAMES[:7], -REST_MM[:7], MODEL) == (None, None)
    assert frame_faults(NAMES[:8], REST_MM[:8] * 0.001, MODEL)[1] is not None
