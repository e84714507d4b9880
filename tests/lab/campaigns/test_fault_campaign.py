"""The whole bridge against scripted faults; the full campaign is `lipservo bench faults`."""

import json
import subprocess
import sys

import pytest
from lipservo_lab.campaigns.endurance import MUST_NOT, Endurance
from lipservo_lab.campaigns.fault_campaign import CAMPAIGN_BUSES, Case, cases, play, trials_of

from firmware_bridge.stopping import StopLevel

HOBBY = ("maestro", "pca9685")


@pytest.mark.parametrize(
    ("bus", "kind"), [(bus, kind) for bus in HOBBY for kind in trials_of(bus).kinds]
)
def test_a_fault_is_survived_without_a_wrong_pulse_or_an_untrue_word(bus, kind):
    outcome = play(Case(bus, kind, 1, 5, 50.0))

    assert outcome.survived, outcome


@pytest.mark.parametrize("bus", HOBBY)
@pytest.mark.parametrize("stop", [StopLevel.SOFT, StopLevel.FREEZE])
def test_a_servo_whose_turn_comes_after_a_stop_gets_no_pulse(bus, stop):
    """Sixteen come on one after another when a person stops the face."""
    outcome = play(Case(bus, "brown-out", 0, 16, 50.0, True, stop))

    assert outcome.survived, outcome


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bus", "kind"),
    [(bus, kind) for bus in ("dynamixel", "feetech") for kind in trials_of(bus).kinds],
)
def test_every_kind_of_fault_is_survived(bus, kind):
    for case in cases(bus):
        if case.kind == kind and (case.n_servos, case.rate_hz) == (5, 30.0):
            outcome = play(case)
            assert outcome.survived, outcome


@pytest.mark.slow
def test_a_servo_that_was_not_heard_when_the_face_froze_stands_as_soon_as_it_is():
    """It had come back a moment before: slow, and half a second away from its goal."""
    outcome = play(Case("dynamixel", "late_reply", 2, 20, 100.0, True, StopLevel.FREEZE))

    assert outcome.counts["moved_frozen"] == 0


@pytest.mark.slow
def test_a_goal_that_was_withheld_is_made_up_for_by_a_period_s_way_at_most():
    """A tick that waited for spoilt answers lasted longer, and a freeze came with it."""
    outcome = play(Case("feetech", "spoilt", 1, 10, 50.0, True, StopLevel.FREEZE))

    assert outcome.counts["steps_above_clamp"] == 0


@pytest.mark.parametrize("bus", CAMPAIGN_BUSES)
def test_the_campaign_has_every_fault_of_its_simulator(bus):
    kinds = trials_of(bus).kinds

    assert {case.kind for case in cases(bus)} == set(kinds)
    assert len(list(cases(bus))) == len(kinds) * 3 * 3 * 2
    assert len(kinds) >= {"dynamixel": 25}.get(bus, 5)


ENDURE = """
import dataclasses, json, sys
from lipservo_lab.campaigns.endurance import endure
print(json.dumps(dataclasses.asdict(endure(int(sys.argv[1]), lambda _: None))))
"""


def endured(n_cycles):
    """Drive a face for a while; what must not have happened is checked here.

    In a process of its own: whatever other tests left running here opens and closes files too.
    """
    done = subprocess.run(
        [sys.executable, "-c", ENDURE, str(n_cycles)], capture_output=True, text=True, check=True
    )
    result = Endurance(**json.loads(done.stdout))

    assert result.cycles == n_cycles
    assert result.goals > 4 * n_cycles
    assert [name for name in MUST_NOT if getattr(result, name)] == []
    assert result.descriptors_at_end == result.descriptors_at_tenth
    return result


@pytest.mark.slow
def test_two_thousand_cycles_leave_nothing_open_and_send_nothing_wrong():
    endured(2_000)


@pytest.mark.campaign
def test_a_hundred_thousand_cycles_do_not_grow():
    result = endured(100_000)

    assert result.replugs >= 1
    assert result.rss_mb_at_end - result.rss_mb_at_tenth < 2.0
