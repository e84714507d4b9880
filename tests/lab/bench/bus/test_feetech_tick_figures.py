"""What `bench bus` times of Feetech servos, on a real pseudo-terminal."""

import pytest
from lipservo_lab.bench.bus import feetech_tick_figures, pulse_tick_figures

# Three simulators and real time.
pytestmark = pytest.mark.slow


def test_the_figures_have_the_names_that_are_promised(monkeypatch):
    monkeypatch.setattr(pulse_tick_figures, "_WARM_UP_BLOCKS", 1)
    monkeypatch.setattr(pulse_tick_figures, "_BLOCKS", 2)
    figures = feetech_tick_figures.feetech_tick_ratios()

    assert {"cpu_goals_feetech_ratio", "cpu_tick_feetech_ratio"} <= {*figures}
    assert all(value > 0.0 for value in figures.values())
