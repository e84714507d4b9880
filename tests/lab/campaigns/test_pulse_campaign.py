"""Hobby servos against scripted faults; the full campaign is `lipservo bench faults --bus NAME`."""

import pytest
from lipservo_lab.bench.fault_figures import CAMPAIGN_BUSES, campaign_of
from lipservo_lab.campaigns.pulse_campaign import PulseAuditor, PulseCase, play_pulses, pulse_cases

from firmware_bridge.bus_kinds import bus_kind
from firmware_bridge.stopping import StopLevel

BUSES = [each for each in CAMPAIGN_BUSES if each != "dynamixel"]
KINDS = [(bus, kind) for bus in BUSES for kind in bus_kind(bus).simulator().FAULTS]


@pytest.mark.parametrize(("bus", "kind"), KINDS)
def test_a_fault_is_survived_without_a_wrong_pulse_or_an_untrue_word(bus, kind):
    outcome = play_pulses(PulseCase(bus, kind, 1, 5, 50.0))

    assert outcome.survived, outcome


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("stop", [StopLevel.SOFT, StopLevel.FREEZE])
def test_a_servo_whose_turn_comes_after_a_stop_gets_no_pulse(bus, stop):
    """Sixteen come on one after another when a person stops the face."""
    outcome = play_pulses(PulseCase(bus, "brown-out", 0, 16, 50.0, True, stop))

    assert outcome.survived, outcome


@pytest.mark.parametrize("bus", BUSES)
def test_a_campaign_has_every_fault_of_its_simulator(bus):
    faults = campaign_of(bus).kinds

    assert {case.kind for case in pulse_cases(bus)} == set(faults)
    assert len(list(pulse_cases(bus))) == len(faults) * 3 * 3 * 2


@pytest.fixture
def auditor():
    """Of one servo: 1200 to 1900 us about 1500, 60 us in a period."""
    auditor = PulseAuditor(PulseCase("pca9685", "nack", 0, 2, 50.0).wiring())
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
