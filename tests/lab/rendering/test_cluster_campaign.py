"""Lines on a Dask cluster whose workers and scheduler are killed: none is lost."""

import pytest
from lipservo_lab.campaigns.cluster_campaign import cluster_figures

pytest.importorskip("distributed", reason="pip install 'lipservo-lab[cluster]'")


def held(n_lines, kill_every_s):
    figures = cluster_figures(n_lines, kill_every_s, lambda *_: None)

    assert figures["lost"] == 0
    assert figures["schedulers_killed"] == 1
    assert figures["workers_killed"] >= 1
    assert figures["computed_twice"] <= 0.01 * n_lines + figures["schedulers_killed"] * 4
    return figures


@pytest.mark.slow
def test_a_few_lines_survive_a_worker_and_the_scheduler():
    held(24, 4.0)


@pytest.mark.campaign
def test_two_thousand_lines_survive_a_worker_a_minute_and_the_scheduler_once():
    assert held(2_000, 60.0)["computed_twice"] <= 20
