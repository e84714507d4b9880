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
    """Play every `every`-th fault case of a kind of bus, two at a time, on a virtual clock.

    Returns figures (cases survived, how often each of `Trials.must_not` happened, 95th percentile
    of the seconds until all servos follow again) and a line for each case not survived.
    bus: a key of the campaign's trials, such as "dynamixel". whole: every fault with every way of
    arming and every stop. progress: called with the number of cases done and of all.
    """
    trials = trials_of(bus)
    chosen = list(cases(bus, whole=whole))[::every]
    outcomes = _play_each(play, chosen, progress, chunksize=4)
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
    """Play every `every`-th case of each part of the stop campaign, two faces at a time.

    Returns the figures of all parts in one dict, and a line of text for each failure.
    part: a key of `STOP_PARTS`, to play that part only; empty: all.
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
    """Play every `every`-th stop case; return its figures and a line for each broken promise."""
    chosen = list(stop_cases())[::every]
    outcomes = _play_batches(play_batch, batches(chosen), len(chosen), progress)
    return stop_figures(outcomes), [str(o) for o in outcomes if not o.kept]


def _freezes(every: int, progress: Callable[[int, int], None]) -> tuple[dict[str, Any], list[str]]:
    """Play every `every`-th freeze case; return its figures and a line for each wrong outcome."""
    chosen = list(freeze_cases())[::every]
    outcomes = _play_batches(play_freezes, freeze_batches(chosen), len(chosen), progress)
    return freeze_figures(outcomes), [str(o) for o in outcomes if not o.kept]


def _statements(
    every: int, progress: Callable[[int, int], None]
) -> tuple[dict[str, Any], list[str]]:
    """Play every `every`-th scene and check each statement that the face made against its rule.

    A statement without a rule is a failure as well. Returns the tally's figures with the number of
    scenes that raised, and a line of text for each failure.
    """
    tally, errors = Tally(), list[str]()
    chosen = scenes()[::every]
    with worker_pool(2) as pool:
        futures = [pool.submit(play_scene, *scene) for scene in chosen]
        for n_done, played in enumerate(as_completed(futures), 1):
            scene_tally, failed = played.result()
            tally.join(scene_tally)
            errors += failed
            progress(n_done, len(chosen))
    return {**tally.figures, "scene_errors": len(errors)}, tally.lines + errors


def _restarts(every: int, progress: Callable[[int, int], None]) -> tuple[dict[str, Any], list[str]]:
    """Simulate every n-th restart of Feetech servos, n = `every`; return figures and lines of text.

    `restart_over_bound`: the highest speed after a restart, divided by the speed that the soft
    start allows. The lines name the restarts in which this ratio exceeds `MOST_OVER`.
    """
    chosen = list(restarts())[::every]
    over = _play_each(over_bound, chosen, progress, chunksize=4)
    too_fast = [
        f"{case}: {by:.2f} times" for case, by in zip(chosen, over, strict=True) if by > MOST_OVER
    ]
    return {"restarts": len(chosen), "restart_over_bound": max(over, default=0.0)}, too_fast


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


def _play_each(
    play_case: Callable[[_Case], _Outcome],
    cases: Sequence[_Case],
    progress: Callable[[int, int], None],
    chunksize: int = 1,
) -> list[_Outcome]:
    """Play cases in two processes; return their outcomes in the order of the cases.

    chunksize: number of cases that a process gets at once. progress: cases done, all cases.
    """
    outcomes: list[_Outcome] = []
    with worker_pool(2) as pool:
        for outcome in pool.map(play_case, cases, chunksize=chunksize):
            outcomes.append(outcome)
            progress(len(outcomes), len(cases))
    return outcomes


def _play_batches(
    play_batch: Callable[[Sequence[Any]], list[Any]],
    case_batches: Sequence[Sequence[Any]],
    n_cases: int,
    progress: Callable[[int, int], None],
) -> list[Any]:
    """Play batches of cases in two processes; return all outcomes, in the order of completion.

    play_batch: plays one batch and returns one outcome for each of its cases.
    n_cases: number of cases in all batches together, for `progress`.
    """
    outcomes: list[Any] = []
    with worker_pool(2) as pool:
        for played in as_completed([pool.submit(play_batch, each) for each in case_batches]):
            outcomes += played.result()
            progress(len(outcomes), n_cases)
    return outcomes


def signal_campaign_figures(
    every: int, progress: Callable[[int, int], None]
) -> tuple[dict[str, float], list[str]]:
    """Play every `every`-th signal case, two at a time, each in a worker process.

    Returns the figures, and a line of text for each case that failed.
    """
    chosen = list(signal_cases())[::every]
    outcomes = _play_each(play_signal, chosen, progress)
    return signal_figures(outcomes), [str(o) for o in outcomes if not o.kept]


#: Starts after a failure, and how many of them one worker plays one after the other.
_STARTS, _STARTS_BATCH = 40, 10


def starved_figures(
    minutes: float, progress: Callable[[int, int], None]
) -> tuple[dict[str, float], list[str]]:
    """Run a face short of processor time for `minutes`, then start faces with failed servos.

    20 minutes have 20 jammed joints, 20 held processes and 40 starts; fewer minutes have fewer in
    proportion. Returns the figures, and a line of text for each failure.
    """
    outcome = play_starved(minutes, progress)
    n_starts = max(len(LEVELS), round(_STARTS * min(minutes, 20.0) / 20.0))
    cases = [(number, LEVELS[number % len(LEVELS)]) for number in range(n_starts)]
    chunks = [cases[at : at + _STARTS_BATCH] for at in range(0, n_starts, _STARTS_BATCH)]
    start_failures: list[str] = []  # one text a start; empty: it succeeded
    with worker_pool(2) as pool:
        for played in pool.map(play_starts, chunks):
            start_failures += played
            progress(len(start_failures), n_starts)
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
        "started_again": start_failures.count("") / n_starts,
    }
    return figures, [*outcome.failures, *filter(None, start_failures)]
