"""The campaigns in numbers: faults on a virtual clock, stops and signals on real processes."""

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from typing import Any, Final, TypeVar

import numpy as np

from lipservo_lab.bench.bus.feetech_restarts import MOST_OVER, over_bound, restarts
from lipservo_lab.bench.statements.campaign import play_scene, scenes
from lipservo_lab.bench.statements.claims import Tally
from lipservo_lab.bench.statements.freeze_cases import (
    freeze_batches,
    freeze_cases,
    freeze_figures,
    play_freezes,
)
from lipservo_lab.bench.stops.idle_connections import stop_beside_idle
from lipservo_lab.bench.stops.signal_campaign import play_signal, signal_cases, signal_figures
from lipservo_lab.bench.stops.started_again import LEVELS, play_starts
from lipservo_lab.bench.stops.starved_face import play_starved
from lipservo_lab.bench.stops.stop_campaign import play_batch
from lipservo_lab.bench.stops.stop_cases import batches, stop_cases, stop_figures
from lipservo_lab.campaigns.fault_campaign import cases, play, trials_of
from lipservo_lab.worker_pool import worker_pool

_Case = TypeVar("_Case")
_Outcome = TypeVar("_Outcome")


def campaign_figures(
    every: int, progress: Callable[[int, int], None], *, bus: str, whole: bool = False
) -> tuple[dict[str, float], list[str]]:
    """Play one fault case in `every`; return the figures, and a line for each case not survived.

    whole: every fault with every arming and stop.
    """
    trials = trials_of(bus)
    chosen = list(cases(bus, whole=whole))[::every]
    outcomes = _in_turn(play, chosen, progress, chunksize=4)
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
    every: int, progress: Callable[[int, int], None], part: str = ""
) -> tuple[dict[str, Any], list[str]]:
    """Play one stop case in `every`, of each part; return the figures, and a line for each failure.

    Two faces are played at a time. part: only this one of `STOP_PARTS`; empty: all.
    """
    figures: dict[str, Any] = {}
    failed: list[str] = []
    for name, play_part in STOP_PARTS.items():
        if part in ("", name):
            found, lines = play_part(every, progress)
            figures |= found
            failed += lines
    return figures, failed


def _stops(every: int, progress: Callable[[int, int], None]) -> tuple[dict[str, Any], list[str]]:
    chosen = list(stop_cases())[::every]
    outcomes = _played(play_batch, batches(chosen), len(chosen), progress)
    return stop_figures(outcomes), [str(o) for o in outcomes if not o.kept]


def _freezes(every: int, progress: Callable[[int, int], None]) -> tuple[dict[str, Any], list[str]]:
    chosen = list(freeze_cases())[::every]
    outcomes = _played(play_freezes, freeze_batches(chosen), len(chosen), progress)
    return freeze_figures(outcomes), [str(o) for o in outcomes if not o.kept]


def _statements(
    every: int, progress: Callable[[int, int], None]
) -> tuple[dict[str, Any], list[str]]:
    """Play scenes and judge all statements; a statement without a rule is a failure as well."""
    tally, errors = Tally(), list[str]()
    chosen = scenes()[::every]
    with worker_pool(2) as pool:
        futures = [pool.submit(play_scene, *each) for each in chosen]
        for n_done, played in enumerate(as_completed(futures), 1):
            heard, failed = played.result()
            tally.join(heard)
            errors += failed
            progress(n_done, len(chosen))
    return {**tally.figures, "scene_errors": len(errors)}, tally.lines + errors


def _restarts(every: int, progress: Callable[[int, int], None]) -> tuple[dict[str, Any], list[str]]:
    chosen = list(restarts())[::every]
    over = _in_turn(over_bound, chosen, progress, chunksize=4)
    fast = [
        f"{one}: {by:.2f} times" for one, by in zip(chosen, over, strict=True) if by > MOST_OVER
    ]
    return {"restarts": len(chosen), "restart_over_bound": max(over, default=0.0)}, fast


def _beside_idle(
    _every: int, _progress: Callable[[int, int], None]
) -> tuple[dict[str, Any], list[str]]:
    return stop_beside_idle(), []


Part = Callable[[int, Callable[[int, int], None]], tuple[dict[str, Any], list[str]]]
#: Of the campaign of stops, in the order in which they are played.
STOP_PARTS: Final[dict[str, Part]] = {
    "restarts": _restarts,
    "statements": _statements,
    "freezes": _freezes,
    "stops": _stops,
    "idle": _beside_idle,
}


def _in_turn(
    play_one: Callable[[_Case], _Outcome],
    cases: Sequence[_Case],
    progress: Callable[[int, int], None],
    chunksize: int = 1,
) -> list[_Outcome]:
    """The outcomes of cases in their order, played two at a time."""
    outcomes: list[_Outcome] = []
    with worker_pool(2) as pool:
        for outcome in pool.map(play_one, cases, chunksize=chunksize):
            outcomes.append(outcome)
            progress(len(outcomes), len(cases))
    return outcomes


def _played(
    play_all: Callable[[Sequence[Any]], list[Any]],
    parts: Sequence[Sequence[Any]],
    n_cases: int,
    progress: Callable[[int, int], None],
) -> list[Any]:
    """The outcomes of batches of cases, played two at a time."""
    outcomes: list[Any] = []
    with worker_pool(2) as pool:
        for played in as_completed([pool.submit(play_all, each) for each in parts]):
            outcomes += played.result()
            progress(len(outcomes), n_cases)
    return outcomes


def signal_campaign_figures(
    every: int, progress: Callable[[int, int], None]
) -> tuple[dict[str, float], list[str]]:
    """Play one signal in `every`, two at a time; the figures, and a line for each that failed.

    Each in a process of its own, so that simulated servos answer in time.
    """
    chosen = list(signal_cases())[::every]
    outcomes = _in_turn(play_signal, chosen, progress)
    return signal_figures(outcomes), [str(o) for o in outcomes if not o.kept]


#: Starts after a failure, and how many of them one worker plays one after the other.
_STARTS, _STARTS_BATCH = 40, 10


def starved_figures(
    minutes: float, progress: Callable[[int, int], None]
) -> tuple[dict[str, float], list[str]]:
    """Starve a face for `minutes`, then start faces with failed servos; return figures, failures.

    20 minutes have 20 jams, 20 held processes and 40 starts; fewer minutes have fewer in
    proportion. A failure is a line of text.
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
    return figures, [*outcome.failures, *filter(None, starts)]
