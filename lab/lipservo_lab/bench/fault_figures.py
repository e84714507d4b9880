"""The campaigns in numbers: faults on a virtual clock, stops and signals on real processes."""

from collections.abc import Callable
from concurrent.futures import as_completed
from typing import Any

import numpy as np

from lipservo_lab.bench.stops.idle_connections import stop_beside_idle
from lipservo_lab.bench.stops.signal_campaign import play_signal, signal_cases, signal_figures
from lipservo_lab.bench.stops.started_again import LEVELS, play_starts
from lipservo_lab.bench.stops.starved_face import play_starved
from lipservo_lab.bench.stops.stop_campaign import play_batch
from lipservo_lab.bench.stops.stop_cases import StopOutcome, batches, stop_cases, stop_figures
from lipservo_lab.campaigns.fault_campaign import Outcome, cases, play, trials_of
from lipservo_lab.worker_pool import worker_pool


def campaign_figures(
    every: int, progress: Callable[[int, int], None], *, bus: str, whole: bool = False
) -> tuple[dict[str, float], list[str]]:
    """Play one case in `every`; what was survived, and a line for each case that was not."""
    trials = trials_of(bus)
    chosen = list(cases(bus, whole=whole))[::every]
    outcomes: list[Outcome] = []
    with worker_pool(2) as pool:
        for outcome in pool.map(play, chosen, chunksize=4):
            outcomes.append(outcome)
            progress(len(outcomes), len(chosen))
    recovered_s = [o.recovery_s for o in outcomes if o.recovery_s is not None]
    unstopped = [o for o in outcomes if o.case.stop is None]
    figures: dict[str, float] = {
        "kinds": len(trials.kinds),
        "cases": len(outcomes),
        "survived": sum(outcome.survived for outcome in outcomes),
        **{name: sum(o.counts[name] for o in outcomes) for name in trials.must_not},
        "recovery_p95_s": float(np.percentile(recovered_s, 95)) if recovered_s else 0.0,
        "never_recovered": len(unstopped) - len(recovered_s),
    }
    return figures, [str(o) for o in outcomes if not o.survived]


def stop_campaign_figures(
    every: int, progress: Callable[[int, int], None]
) -> tuple[dict[str, Any], list[str]]:
    """Play one stop in `every`, two at a time; the figures, and a line for each that failed."""
    chosen = list(stop_cases())[::every]
    outcomes: list[StopOutcome] = []
    with worker_pool(2) as pool:
        for played in as_completed([pool.submit(play_batch, each) for each in batches(chosen)]):
            outcomes += played.result()
            progress(len(outcomes), len(chosen))
    figures = stop_figures(outcomes) | stop_beside_idle()
    return figures, [str(o) for o in outcomes if not o.kept]


def signal_campaign_figures(
    every: int, progress: Callable[[int, int], None]
) -> tuple[dict[str, float], list[str]]:
    """Play one signal in `every`, two at a time; the figures, and a line for each that failed.

    Each in a process of its own, so that simulated servos answer in time.
    """
    chosen = list(signal_cases())[::every]
    outcomes = []
    with worker_pool(2) as pool:
        for outcome in pool.map(play_signal, chosen):
            outcomes.append(outcome)
            progress(len(outcomes), len(chosen))
    return signal_figures(outcomes), [str(o) for o in outcomes if not o.kept]


#: Starts after a failure, and how many of them one worker plays one after the other.
_STARTS, _STARTS_BATCH = 40, 10


def starved_figures(
    minutes: float, progress: Callable[[int, int], None]
) -> tuple[dict[str, float], list[str]]:
    """Starve a face for so many minutes, then start faces with servos that failed; the figures.

    20 minutes have 20 jams, 20 held processes and 40 starts, fewer minutes fewer in proportion. A
    line for each thing that must not be.
    """
    outcome = play_starved(minutes, progress)
    n_starts = max(len(LEVELS), round(_STARTS * min(minutes, 20.0) / 20.0))
    cases = [(number, LEVELS[number % len(LEVELS)]) for number in range(n_starts)]
    chunks = [cases[at : at + _STARTS_BATCH] for at in range(0, n_starts, _STARTS_BATCH)]
    starts: list[str] = []
    with worker_pool(2) as pool:
        for played in pool.map(play_starts, chunks):
            starts += played
            progress(len(starts), n_starts)
    figures = {
        "minutes": outcome.minutes,
        "driven_share": float(np.mean(outcome.driven)),
        "accused": outcome.accused,
        "called_silent": outcome.called_silent,
        "killed_starved": outcome.killed_starved,
        "jams": outcome.jams,
        "jams_named": outcome.jams_named / outcome.jams,
        "held": outcome.held,
        "hung_killed": outcome.hung_killed / outcome.held,
        "starts": n_starts,
        "started_again": starts.count("") / n_starts,
    }
    return figures, [*outcome.said, *filter(None, starts)]
