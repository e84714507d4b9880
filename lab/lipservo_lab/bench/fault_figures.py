"""The campaigns in numbers: faults on a virtual clock, stops and signals on real processes."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from firmware_bridge.bus_kinds import bus_kind
from firmware_bridge.simulator.faults import KINDS
from lipservo_lab.bench.stops.signal_campaign import play_signal, signal_cases, signal_figures
from lipservo_lab.bench.stops.stop_campaign import play_batch
from lipservo_lab.bench.stops.stop_cases import StopOutcome, batches, stop_cases, stop_figures
from lipservo_lab.campaigns.fault_campaign import cases, play
from lipservo_lab.campaigns.pulse_campaign import SETTINGS, PulseOutcome, play_pulses, pulse_cases
from lipservo_lab.worker_pool import worker_pool

#: Counts of `Outcome` that must all be 0.
_MUST_NOT = (
    "goals_outside_limits",
    "steps_above_clamp",
    "motion_too_fast",
    "moved_outside",
    "moved_frozen",
    "armed_wrongly",
    "undone",
    "contention",
    "torque_unknown",
    "torque_left_on",
)


@dataclass(frozen=True, slots=True)
class Campaign:
    """What is played against one kind of bus.

    cases: all of them, given `whole`. play: one to its end, in a process of its own. must_not:
    counts of an outcome that must all be 0; it also has `case`, `error`, `survived`, `recovery_s`.
    """

    kinds: Sequence[str]
    cases: Callable[..., Iterator[Any]]
    play: Callable[[Any], Any]
    must_not: Sequence[str]


def campaign_of(bus: str) -> Campaign:
    """By the name of its kind. Raises KeyError where there is none."""
    return _CAMPAIGNS[bus]()


def _pulse_campaign(bus: str) -> Campaign:
    kinds = bus_kind(bus).simulator().FAULTS
    return Campaign(kinds, partial(pulse_cases, bus), play_pulses, PulseOutcome.MUST_NOT)


_CAMPAIGNS: Final[dict[str, Callable[[], Campaign]]] = {
    "dynamixel": lambda: Campaign(KINDS, cases, play, _MUST_NOT),
    **{bus: partial(_pulse_campaign, bus) for bus in SETTINGS},
}
#: Kinds of bus that have one.
CAMPAIGN_BUSES: Final = tuple(_CAMPAIGNS)


def campaign_figures(
    every: int, progress: Callable[[int, int], None], *, bus: str, whole: bool = False
) -> tuple[dict[str, float], list[str]]:
    """Play one case in `every`; what was survived, and a line for each case that was not."""
    campaign = campaign_of(bus)
    chosen = list(campaign.cases(whole=whole))[::every]
    outcomes: list[Any] = []
    with worker_pool(2) as pool:
        for outcome in pool.map(campaign.play, chosen, chunksize=4):
            outcomes.append(outcome)
            progress(len(outcomes), len(chosen))
    recovered_s = [o.recovery_s for o in outcomes if o.recovery_s is not None]
    unstopped = [o for o in outcomes if o.case.stop is None]
    figures: dict[str, float] = {
        "kinds": len(campaign.kinds),
        "cases": len(outcomes),
        "survived": sum(outcome.survived for outcome in outcomes),
        **{name: sum(getattr(o, name) for o in outcomes) for name in campaign.must_not},
        "recovery_p95_s": float(np.percentile(recovered_s, 95)) if recovered_s else 0.0,
        "never_recovered": len(unstopped) - len(recovered_s),
    }
    return figures, [_told(o, campaign.must_not) for o in outcomes if not o.survived]


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
    return stop_figures(outcomes), [str(o) for o in outcomes if not o.kept]


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


def _told(outcome: Any, must_not: Sequence[str]) -> str:
    wrong = {name: getattr(outcome, name) for name in ("error", *must_not)}
    found = ", ".join(f"{name} {value}" for name, value in wrong.items() if value)
    return f"{outcome.case}: {found}"
