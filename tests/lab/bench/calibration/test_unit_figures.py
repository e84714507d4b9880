"""Sister units: another robot of the same design, and the figures of a map taken over to it."""

import numpy as np
import pytest
from lipservo_lab.bench.calibration.elastic_draws import draw_elastic_robot
from lipservo_lab.bench.calibration.unit_figures import UnitErrors, sister_of, unit_figures
from small_model import small_model

from calibration.simulated.elastic_robot import N_PAIRS, ElasticFace

MODEL = small_model()


def test_a_sister_has_other_horns_dots_and_contact_and_the_same_joints():
    draw, _ = draw_elastic_robot(MODEL.markers_mm(MODEL.rest[None])[0], 3, 8)
    sister = sister_of(draw, 3)
    assert sister.servo_names == draw.servo_names
    askew_deg = np.abs(sister.zero_deg - draw.zero_deg)
    assert askew_deg.max() <= 5.0
    assert askew_deg[draw.jaw] <= 2.5
    tooth = np.abs(sister_of(draw, 3, 2).zero_deg - sister.zero_deg)
    assert tooth == pytest.approx(np.where(np.arange(8) == 2, 14.4, 0.0))
    both = ElasticFace(draw), ElasticFace(sister)
    gaps_mm = [face.state(np.zeros((1, 8))).gaps_mm[0, N_PAIRS // 2] for face in both]
    assert gaps_mm[0] != pytest.approx(gaps_mm[1], abs=1e-3)
    # The dots of the inner lips tell the gap and what they lie beside the edges, of both alike.
    for face in both:
        skin = face.draw.skin
        rows = [i for i, n in enumerate(MODEL.layout.landmarks) if n in (13, 14)]
        upper, lower = sorted(skin.dots_mm[rows, 1])[::-1]
        edges_mm = skin.places_mm[N_PAIRS // 2, 1] - skin.places_mm[N_PAIRS + N_PAIRS // 2, 1]
        assert upper - lower == pytest.approx(edges_mm + skin.off_edge_mm[[1, 4]].sum(), abs=0.05)


def test_a_refused_unit_counts_as_infinite_and_a_tooth_must_be_named_alone():
    good = UnitErrors(1.0, 1.1, 2.0, "", tooth_named=True)
    refused = UnitErrors(1.0, np.inf, 2.0, "no", tooth_named=False)
    unmeasured = UnitErrors(np.nan, np.nan, np.nan, "", tooth_named=False)
    figures = unit_figures([good, good, refused, unmeasured])
    assert np.isnan(unit_figures([unmeasured])["unit_ratio"])
    assert (figures["unit_ratio"], figures["unit_ratio_worst"]) == (1.1, np.inf)
    assert figures["unit_eye_ratio"] == 2.0
    assert (figures["unit_refused"], figures["unit_tooth_named"]) == (["no"], pytest.approx(2 / 3))
