"""Which stops the campaign plays: clients x levels x troubles, in batches that share a face.

What came of the stops of the campaign: a record each, and the figures of all.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby, product
from typing import Any, Final

import numpy as np

from firmware_bridge.stopping import StopLevel
from lipservo_lab.bench.stops.faces_on_buses import BUSES
from lipservo_lab.bench.stops.stop_clients import CLIENTS, NEEDS_AGENTS, NEEDS_PAGE, StopClient
from lipservo_lab.bench.stops.troubles import (
    FIRST_TROUBLES,
    FOR_EVERY_CLIENT,
    Trouble,
    needs_agents,
    needs_page,
)

#: After what has gone wrong, the stop comes so much later, seconds.
TIMES_S: Final = (0.0, 0.15, 0.6)
#: A daemon that has been launched so long ago is opening its port, or arms its servos.
_STARTING_S: Final = (0.8, 1.6, 2.4, 3.2)
#: A start and a stop that meet: the second comes so much after the first.
_MEETINGS_S: Final = {
    Trouble.START_AGAIN: (0.0, 0.02, 0.15),
    Trouble.START_AFTER_STOP: (0.02, 0.15),
    Trouble.START_AT_ONCE: (0.0,),
}
#: So long after a start that is obeyed at once its servos are being armed, one after another.
_ARMING_S: Final = (0.01, 0.3)
#: Driven for so long; everybody is killed then.
_KILLED_S: Final = (0.0, 0.3, 1.0)
#: Of the first conditions, those in which the process that owns the servos is away or is replaced.
_FOR_MORE_CLIENTS: Final = (
    Trouble.UNPLUGGED,
    Trouble.HUNG_BRIDGE,
    Trouble.FROZEN,
    Trouble.DURING_RESTART,
)
_MOST_OF_A_FACE: Final = 8


@dataclass(frozen=True, slots=True)
class StopCase:
    """One stop of the campaign: its level, the trouble before it, and the client that requests it.

    moment_s: from the trouble to the stop; for `EVERYBODY_KILLED`, how long the face had been
    driven. bus: kind of bus.
    """

    level: StopLevel
    trouble: Trouble
    moment_s: float = 0.0
    client: StopClient = StopClient.SOCKET
    bus: str = "dynamixel"

    def __str__(self) -> str:
        return f"{self.client} {self.level}, {self.trouble}, {self.moment_s:g} s later, {self.bus}"

    @property
    def page(self) -> bool:
        """Whether the face needs its page."""
        return self.client in NEEDS_PAGE or needs_page(self.trouble)

    @property
    def agents(self) -> bool:
        """Whether the face needs its agent server."""
        return self.client in NEEDS_AGENTS or needs_agents(self.trouble)

    @property
    def is_plain(self) -> bool:
        """Whether a daemon waits afterwards, limp, until a person starts it."""
        by_person = self.client not in (StopClient.SIGNAL, StopClient.NO_ONE)
        return self.level is not StopLevel.FREEZE and by_person


def stop_cases() -> Iterator[StopCase]:
    """Yield every stop of the campaign; a freeze by a signal does not exist."""
    for level, trouble, moment_s, client in product(
        StopLevel, FIRST_TROUBLES, TIMES_S, (StopClient.SOCKET, StopClient.SIGNAL)
    ):
        if _is_possible(level, client):
            yield StopCase(level, trouble, moment_s, client)
    for level, trouble, client in product(
        (StopLevel.SOFT, StopLevel.LIMP),
        _FOR_MORE_CLIENTS,
        (StopClient.COMMAND, StopClient.PAGE_SCRIPT),
    ):
        yield StopCase(level, trouble, 0.0, client)
    for level, trouble, client in product(StopLevel, FOR_EVERY_CLIENT, CLIENTS):
        if _is_possible(level, client):
            yield StopCase(level, trouble, 0.0, client)
    for level in StopLevel:
        yield StopCase(level, Trouble.FOREIGN_ENDLESS, 0.0, StopClient.COMMAND)
    for level, client in product(
        StopLevel,
        (StopClient.SOCKET, StopClient.SIGNAL, StopClient.PAGE_SCRIPT, StopClient.CONTROL),
    ):
        if _is_possible(level, client):
            yield StopCase(level, Trouble.CLOCK_JUMPS, 0.0, client)
    yield from _overlapping_stops()
    yield from _stops_on_all_buses()


def _overlapping_stops() -> Iterator[StopCase]:
    """Yield stops that overlap with another stop, or with a start."""
    for client in (StopClient.SOCKET, StopClient.PAGE_SCRIPT, StopClient.COMMAND):
        yield StopCase(StopLevel.LIMP, Trouble.EASING, 0.0, client)
    for level, moment_s in zip((StopLevel.LIMP, StopLevel.SOFT) * 2, _STARTING_S, strict=True):
        yield StopCase(level, Trouble.STARTING, moment_s)
    for level, (trouble, times_s) in product((StopLevel.SOFT, StopLevel.LIMP), _MEETINGS_S.items()):
        for moment_s in times_s:
            yield StopCase(level, trouble, moment_s)


def _stops_on_all_buses() -> Iterator[StopCase]:
    """Yield stops of a starting face, and the death of all processes, on every kind of bus."""
    for bus, level, moment_s in product(BUSES, StopLevel, _ARMING_S):
        yield StopCase(level, Trouble.START_AGAIN, moment_s, bus=bus)
    for bus, moment_s in product(BUSES, _KILLED_S):
        yield StopCase(StopLevel.LIMP, Trouble.EVERYBODY_KILLED, moment_s, StopClient.NO_ONE, bus)


def _is_possible(level: StopLevel, client: StopClient) -> bool:
    return not (level is StopLevel.FREEZE and client is StopClient.SIGNAL)


def batches(cases: Sequence[StopCase]) -> list[list[StopCase]]:
    """Return the cases in batches that one face can serve, of `_MOST_OF_A_FACE` cases at most.

    A batch has one trouble, one kind of bus, and one set of servers (page, agents); cases after
    which the face cannot be used again come last.
    """

    def needed_face(case: StopCase) -> tuple[str, str, bool, bool]:
        return case.trouble, case.bus, case.page, case.agents

    def sort_key(case: StopCase) -> tuple[tuple[str, str, bool, bool], bool, bool]:
        return needed_face(case), case.client is StopClient.SIGNAL, case.level is StopLevel.FREEZE

    case_batches = []
    for _, group in groupby(sorted(cases, key=sort_key), needed_face):
        group_cases = list(group)
        first_numbers = range(0, len(group_cases), _MOST_OF_A_FACE)
        case_batches += [group_cases[n : n + _MOST_OF_A_FACE] for n in first_numbers]
    return case_batches


@dataclass(slots=True)
class StopOutcome:
    """The outcome of one stop.

    late: servos that still had torque 2 s after both the stop was requested and they could be
    reached; easing is within these. torque_left_on: servos that had it at the end of the watch.
    undone: how many times a servo got torque after the stop, without a start, also while processes
    were killed and the plug went out and in. moved_frozen: shafts that moved. fault_unseen: a fault
    that the status of a frozen face did not show. came_back: whether a start drove the face again;
    None: none was sent. no_start: one was due, and this program has none. broken: what else was not
    kept, a line each. error: the case itself did not work.
    """

    case: StopCase
    late: int = 0
    torque_left_on: int = 0
    undone: int = 0
    moved_frozen: int = 0
    fault_unseen: int = 0
    limp_after_s: float | None = None
    came_back: bool | None = None
    no_start: bool = False
    broken: list[str] = field(default_factory=list)
    answers: list[str] = field(default_factory=list)
    error: str = ""

    @property
    def counts(self) -> dict[str, int]:
        """Return the counts that must be 0, by name."""
        names = ("late", "torque_left_on", "undone", "moved_frozen", "fault_unseen")
        return {name: getattr(self, name) for name in names}

    @property
    def kept(self) -> bool:
        """Whether the promise was kept."""
        failed = bool(self.error or self.broken) or self.came_back is False
        return not (failed or any(self.counts.values()))

    def __str__(self) -> str:
        """Describe case and outcome in one line; answers only where something was not kept."""
        found = [f"{name} {count}" for name, count in self.counts.items() if count]
        if self.limp_after_s is not None and self.late:
            found.append(f"torque until {self.limp_after_s:.1f} s after it")
        found += ["a start did not bring it back"] if self.came_back is False else []
        found += [*self.broken, *([self.error] if self.error else [])]
        answers = f" (answered: {'; '.join(self.answers)})" if found and self.answers else ""
        return f"{self.case}: {'; '.join(found) or 'kept'}{answers}"


def stop_figures(outcomes: Sequence[StopOutcome]) -> dict[str, Any]:
    """Return the figures of the campaign.

    late counts cases; torque_left_on and moved_frozen count servos, undone how often a servo got
    torque. starts: faces that were started again; starts_unavailable: faces that could not be,
    since the program has no start. by_client, by_trouble, by_bus: the counts of each.
    """
    limp_s = [o.limp_after_s for o in outcomes if o.limp_after_s is not None]
    return {
        **_count_outcomes(outcomes),
        "starts": sum(o.came_back is not None for o in outcomes),
        "came_back": sum(o.came_back is True for o in outcomes),
        "starts_unavailable": sum(o.no_start for o in outcomes),
        "limp_after_p95_s": float(np.percentile(limp_s, 95)) if limp_s else 0.0,
        "limp_after_worst_s": max(limp_s, default=0.0),
        "by_client": _counts_by(outcomes, lambda case: case.client.value),
        "by_trouble": _counts_by(outcomes, lambda case: case.trouble.value),
        "by_bus": _counts_by(outcomes, lambda case: case.bus),
    }


def _count_outcomes(outcomes: Sequence[StopOutcome]) -> dict[str, int]:
    """Return how many outcomes there are, and how often each fault occurred in them.

    `undone` counts how often a servo got torque, `torque_left_on` and `moved_frozen` count servos,
    the others cases.
    """
    return {
        "cases": len(outcomes),
        "kept": sum(o.kept for o in outcomes),
        "late": sum(o.late > 0 for o in outcomes),
        "undone": sum(o.undone for o in outcomes),
        "torque_left_on": sum(o.torque_left_on for o in outcomes),
        "moved_frozen": sum(o.moved_frozen for o in outcomes),
        "faults_unseen": sum(o.fault_unseen for o in outcomes),
        "broken": sum(bool(o.broken) for o in outcomes),
        "errors": sum(bool(o.error) for o in outcomes),
    }


def _counts_by(
    outcomes: Sequence[StopOutcome], key: Callable[[StopCase], str]
) -> dict[str, dict[str, int]]:
    """Return the counts of outcomes, grouped by what `key` returns of their cases."""
    groups: dict[str, list[StopOutcome]] = defaultdict(list)
    for outcome in outcomes:
        groups[key(outcome.case)].append(outcome)
    return {name: _count_outcomes(group) for name, group in groups.items()}
