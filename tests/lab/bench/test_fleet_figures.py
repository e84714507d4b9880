"""The bench of many faces, with one real daemon beside endpoints that answer as it did."""

import pytest
from lipservo_lab.bench.fleet_figures import N_DEAD, N_HUNG, fleet_figures


@pytest.mark.slow
def test_all_good_faces_confirm_and_the_dead_and_hung_ones_are_named():
    steps = []
    figures = fleet_figures(1, 4, lambda *step: steps.append(step))

    assert steps == [("fleet", n, 4) for n in (1, 2, 3, 4)]
    assert (figures["faces"], figures["confirmed"]) == (5, 1.0)
    assert figures["named"] == figures["dead_and_hung"] == N_DEAD + N_HUNG
    assert figures["stop_s"] > 0.0
