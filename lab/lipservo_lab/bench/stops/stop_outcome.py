"""What came of the stops of the campaign: a record each, and the figures of all."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lipservo_lab.bench.stops.stop_cases import StopCase


@dataclass(slots=True)
class StopOutcome:
    """What came of one stop.

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
        """What must be 0, by name."""
        names = ("late", "torque_left_on", "undone", "moved_frozen", "fault_unseen")
        return {name: getattr(self, name) for name in names}

    @property
    def kept(self) -> bool:
        """Whether the promise was kept."""
        failed = bool(self.error or self.broken) or self.came_back is False
        return not (failed or any(self.counts.values()))

    def __str__(self) -> str:
        found = [f"{name} {count}" for name, count in self.counts.items() if count]
        if self.limp_after_s is not None and self.late:
            found.append(f"torque until {self.limp_after_s:.1f} s after it")
        found += ["a start did not bring it back"] if self.came_back is False else []
        found += [*self.broken, *([self.error] if self.error else [])]
        answers = f" (answered: {'; '.join(self.answers)})" if found and self.answers else ""
        return f"{self.case}: {'; '.join(found) or 'kept'}{answers}"


def stop_figures(outcomes: Sequence[StopOutcome]) -> dict[str, Any]:
    """The figures of the campaign.

    late counts cases; torque_left_on, undone and moved_frozen count servos. starts: faces that were
    started again; starts_unavailable: that could not, since the program has no start. by_client,
    by_trouble: the counts of each.
    """
    limp_s = [o.limp_after_s for o in outcomes if o.limp_after_s is not None]
    return {
        **_counts(outcomes),
        "starts": sum(o.came_back is not None for o in outcomes),
        "came_back": sum(o.came_back is True for o in outcomes),
        "starts_unavailable": sum(o.no_start for o in outcomes),
        "limp_after_p95_s": float(np.percentile(limp_s, 95)) if limp_s else 0.0,
        "limp_after_worst_s": max(limp_s, default=0.0),
        "by_client": _table(outcomes, lambda case: case.client.value),
        "by_trouble": _table(outcomes, lambda case: case.trouble.value),
    }


def _counts(outcomes: Sequence[StopOutcome]) -> dict[str, int]:
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


def _table(
    outcomes: Sequence[StopOutcome], key: Callable[[StopCase], str]
) -> dict[str, dict[str, int]]:
    parts: dict[str, list[StopOutcome]] = defaultdict(list)
    for outcome in outcomes:
        parts[key(outcome.case)].append(outcome)
    return {name: _counts(part) for name, part in parts.items()}
