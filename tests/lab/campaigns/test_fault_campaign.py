"""The whole bridge against scripted faults; the full campaign is `lipservo bench faults`."""

import json
import subprocess
import sys

import pytest
from lipservo_lab.campaigns.endurance import MUST_NOT, Endurance
from lipservo_lab.campaigns.fault_campaign import Case, cases, play

from firmware_bridge.simulator.faults import KINDS
from firmware_bridge.stopping import StopLevel


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["drop_reply", "unplug", "overload", "reboot", "encoder_fault"])
def test_a_fault_is_survived_without_a_wrong_goal(kind):
    outcome = play(Case(kind, 1, 5, 30.0))

    assert outcome.survived, outcome


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_fault_is_survived(kind):
    for case in cases():
        if case.kind == kind and (case.n_servos, case.rate_hz) == (5, 30.0):
            assert play(case).survived, case


@pytest.mark.slow
def test_a_servo_that_was_not_heard_when_the_face_froze_stands_as_soon_as_it_is():
    """It had come back a moment before: slow, and half a second away from its goal."""
    outcome = play(Case("late_reply", 2, 20, 100.0, True, StopLevel.FREEZE))

    assert outcome.moved_frozen == 0


def test_the_campaign_is_as_large_as_promised():
    assert len(KINDS) >= 25
    assert len(list(cases())) == len(KINDS) * 3 * 3 * 2


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
