"""Every command that moves servos ends limp, whatever ends it: real processes, simulated servos.

A handful here, a dozen in `make check`; all of them are `lipservo bench faults --signals` and
`--stops`.
"""

import pytest
from lipservo_lab.bench.fault_figures import signal_campaign_figures, stop_campaign_figures
from lipservo_lab.bench.stops.signal_campaign import (
    COMMANDS,
    SIGNALS,
    Ending,
    Moment,
    SignalCase,
    play_signal,
    signal_cases,
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        SignalCase("jog", Ending.HUP),
        SignalCase("new-face", Ending.STOP),
        SignalCase("neutral", Ending.KILL, then="limp"),
    ],
    ids=str,
)
def test_a_command_that_is_ended_leaves_limp_servos_and_says_who_confirmed(case):
    outcome = play_signal(case)

    assert outcome.kept, str(outcome)


def test_the_campaign_plays_every_command_every_ending_and_every_moment():
    cases = list(signal_cases())

    assert len(set(cases)) == len(cases)
    for command in COMMANDS.values():
        endings = {(each.ending, each.twice) for each in cases if each.command == command.name}
        assert endings >= {(number, twice) for number in SIGNALS for twice in (False, True)}
        if not command.own_servos:
            assert (Ending.KILL, False) in endings
            assert ((Ending.STOP, False) in endings) == command.arms
    assert {each.moment for each in cases} == set(Moment)


def nothing(_n_done, _n_cases):
    """Nobody watches the progress."""


@pytest.mark.slow
def test_of_half_a_dozen_signals_each_is_kept():
    figures, broken = signal_campaign_figures(29, nothing)

    assert figures["cases"] == figures["kept"] >= 6, broken


@pytest.mark.slow
def test_of_a_few_stops_each_is_kept():
    figures, broken = stop_campaign_figures(103, nothing)

    assert figures["cases"] == figures["kept"] >= 4, broken
