"""Which stops the campaign plays, and what it makes of what came of them."""

from itertools import product

import pytest
from lipservo_lab.bench.stops.faces_on_buses import BUSES
from lipservo_lab.bench.stops.stop_cases import (
    TIMES_S,
    StopCase,
    StopOutcome,
    batches,
    stop_cases,
    stop_figures,
)
from lipservo_lab.bench.stops.stop_clients import CLIENTS, StopClient
from lipservo_lab.bench.stops.troubles import FIRST_TROUBLES, FOR_EVERY_CLIENT, NEED_START, Trouble

from firmware_bridge.stopping import StopLevel

CASES = list(stop_cases())
#: No signal freezes a face.
BY_CLIENT = {
    (client, level)
    for client, level in product(CLIENTS, StopLevel)
    if (client, level) != (StopClient.SIGNAL, StopLevel.FREEZE)
}


def test_the_campaign_plays_every_trouble_and_no_case_twice():
    assert len(set(CASES)) == len(CASES) >= 400
    assert {case.trouble for case in CASES} == set(Trouble)


@pytest.mark.parametrize("trouble", [Trouble.EVERYBODY_KILLED, Trouble.START_AGAIN])
def test_everybody_is_killed_and_a_starting_face_is_stopped_on_every_bus(trouble):
    assert {case.bus for case in CASES if case.trouble is trouble} == set(BUSES)


@pytest.mark.parametrize("trouble", FOR_EVERY_CLIENT)
def test_in_every_new_trouble_every_client_requests_every_stop(trouble):
    assert {(case.client, case.level) for case in CASES if case.trouble is trouble} == BY_CLIENT


@pytest.mark.parametrize("trouble", FIRST_TROUBLES)
def test_the_first_conditions_keep_their_levels_and_moments(trouble):
    by_socket = {
        (case.level, case.moment_s)
        for case in CASES
        if case.trouble is trouble and case.client is StopClient.SOCKET
    }

    assert by_socket == set(product(StopLevel, TIMES_S))


def test_a_batch_needs_one_face_with_the_same_doors_and_what_ends_a_face_comes_last():
    made = batches(CASES)

    assert sorted(str(case) for batch in made for case in batch) == sorted(map(str, CASES))
    for batch in made:
        assert len({(case.trouble, case.page, case.agents) for case in batch}) == 1
        by_signal = [case.client is StopClient.SIGNAL for case in batch]
        assert by_signal == sorted(by_signal)


def test_a_stop_by_a_client_leaves_a_daemon_that_waits_a_signal_and_a_freeze_do_not():
    def is_plain(level, client):
        return StopCase(level, Trouble.RUNNING, 0.0, client).is_plain

    assert is_plain(StopLevel.SOFT, StopClient.COMMAND)
    assert is_plain(StopLevel.LIMP, StopClient.PAGE_EARLY)
    assert not is_plain(StopLevel.FREEZE, StopClient.SOCKET)
    assert not is_plain(StopLevel.SOFT, StopClient.SIGNAL)


CASE = StopCase(StopLevel.LIMP, Trouble.NAME_SERVICE, 0.0, StopClient.API)


@pytest.mark.parametrize(
    "failed",
    [
        StopOutcome(CASE, late=1),
        StopOutcome(CASE, undone=1),
        StopOutcome(CASE, torque_left_on=1),
        StopOutcome(CASE, moved_frozen=1),
        StopOutcome(CASE, fault_unseen=1),
        StopOutcome(CASE, came_back=False),
        StopOutcome(CASE, broken=["does not wait"]),
        StopOutcome(CASE, error="RuntimeError: no port"),
    ],
    ids=str,
)
def test_whatever_was_not_kept_fails_the_case_and_is_in_its_line(failed):
    assert not failed.kept
    assert "kept" not in str(failed)
    assert stop_figures([failed, StopOutcome(CASE)])["kept"] == 1


def test_a_face_that_nothing_could_start_again_is_counted_and_no_failure():
    outcome = StopOutcome(CASE, no_start=True)

    assert outcome.kept
    assert stop_figures([outcome])["starts_unavailable"] == 1


def test_the_figures_are_counted_for_each_client_and_each_trouble():
    other = StopCase(StopLevel.SOFT, Trouble.POLLERS, 0.0, StopClient.SOCKET)
    outcomes = [
        StopOutcome(CASE, late=4, limp_after_s=5.0),
        StopOutcome(CASE, came_back=True, limp_after_s=0.1),
        StopOutcome(other, undone=3),
    ]

    figures = stop_figures(outcomes)

    assert (figures["cases"], figures["kept"], figures["late"], figures["undone"]) == (3, 1, 1, 3)
    assert (figures["starts"], figures["came_back"]) == (1, 1)
    assert figures["limp_after_worst_s"] == 5.0
    assert figures["by_client"]["api"]["late"] == 1
    assert figures["by_client"]["socket"]["undone"] == 3
    assert figures["by_trouble"]["name_service"]["cases"] == 2


def test_starts_and_stops_that_meet_need_the_word_start():
    assert {case.trouble for case in CASES if case.trouble in NEED_START} == set(NEED_START)
