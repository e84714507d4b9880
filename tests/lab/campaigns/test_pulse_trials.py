"""What the auditor of hobby servos counts."""

import pytest
from lipservo_lab.campaigns.fault_campaign import Case
from lipservo_lab.campaigns.pulse_trials import PulseAuditor, wiring_of

from firmware_bridge.stopping import StopLevel


@pytest.fixture
def auditor():
    """Of one servo: 1200 to 1900 us about 1500, 60 us in a period."""
    auditor = PulseAuditor(wiring_of(Case("pca9685", "nack", 0, 2, 50.0)))
    for n in range(4):
        auditor.see(1.0 + 0.02 * n, 1, 1500.0 + 20.0 * n, comes_again=True)
    return auditor


@pytest.mark.parametrize(
    ("time_s", "channel", "pulse_us", "count"),
    [
        (1.08, 1, 1700.0, "steps_too_long"),
        (2.0, 1, 1700.0, "armed_wrongly"),
        (2.0, 1, 1560.0, "armed_late"),
        (1.3, 1, 1590.0, "armed_late"),
        (1.08, 5, 1500.0, "goals_outside"),
        (1.08, 1, 1910.0, "goals_outside"),
    ],
)
def test_the_auditor_counts_what_must_not_happen(auditor, time_s, channel, pulse_us, count):
    auditor.note_stop(1.1, StopLevel.SOFT)
    auditor.see(time_s, channel, pulse_us, comes_again=True)

    assert getattr(auditor, count) == 1


def test_a_frozen_servo_that_moves_is_counted(auditor):
    auditor.note_stop(1.05, StopLevel.FREEZE)
    for n in range(10):
        auditor.see(1.08 + 0.02 * n, 1, 1560.0 + 10.0 * (n > 7), comes_again=True)

    assert auditor.moved_frozen == 1
