"""A model of other points is calibrated at the 47 markers."""

import numpy as np
import pytest
from small_model import small_model

from lipsync.animpho.units import in_layout
from lipsync.markers import MARKERS_39, MARKERS_47, LayoutError, layout_of

OUTER = in_layout(small_model(), MARKERS_39)
FRAMES = np.random.default_rng(0).normal(0.0, 10.0, (20, 5))


def test_points_that_both_have_are_where_they_were():
    np.testing.assert_allclose(
        OUTER.markers_mm(FRAMES), small_model().markers_mm(FRAMES)[:, :39], atol=1e-12
    )
    assert in_layout(OUTER, MARKERS_39) is OUTER


def test_inner_lips_touch_at_rest_and_open_with_the_outer_ones():
    whole = in_layout(OUTER, MARKERS_47)
    assert whole.checksum == OUTER.checksum == small_model().checksum
    assert whole.lip_gap_mm(whole.rest) == pytest.approx(0.0, abs=1e-9)
    found = [whole.lip_gap_mm(frame) for frame in FRAMES]
    np.testing.assert_allclose(found, [OUTER.lip_gap_mm(frame) for frame in FRAMES], atol=1e-9)


def test_the_gap_of_outer_lips_is_counted_from_where_they_touch():
    """The upper and the lower lip of the small model move as one: both gaps are then the same."""
    opening = small_model().rest + np.linspace(0.0, 40.0, 5)[:, None] * np.eye(5)[0]
    inner_mm = [small_model().lip_gap_mm(frame) for frame in opening]
    np.testing.assert_allclose([OUTER.lip_gap_mm(frame) for frame in opening], inner_mm, atol=1e-9)
    np.testing.assert_allclose(OUTER.lip_gaps_mm(OUTER.markers_mm(opening)), inner_mm, atol=1e-9)


def test_a_point_that_cannot_be_told_is_named():
    nose = layout_of({"name": "nose", "groups": {"nose": [2, 98, 327]}, "lip_gap": [2, 98]})
    with pytest.raises(LayoutError, match="landmark 61 is unknown"):
        in_layout(in_layout(small_model(), nose), MARKERS_47)
