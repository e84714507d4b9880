"""Which stops the campaign plays: clients x levels x troubles, in batches that share a face."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, product
from typing import Final

from firmware_bridge.stopping import StopLevel
from lipservo_lab.bench.stops.stop_clients import NEEDS_AGENTS, NEEDS_PAGE, StopClient
from lipservo_lab.bench.stops.troubles import (
    FIRST_TROUBLES,
    FOR_EVERY_CLIENT,
    Trouble,
    needs_agents,
    needs_page,
)

#: After what has gone wrong, the stop comes so much later, seconds.
MOMENTS_S: Final = (0.0, 0.15, 0.6)
#: A daemon that has been launched so long ago is opening its port, or arms its servos.
_STARTING_S: Final = (0.8, 1.6, 2.4, 3.2)
#: A start and a stop that meet: the second comes so much after the first.
_MEETINGS_S: Final = {
    Trouble.START_AGAIN: (0.0, 0.02, 0.15),
    Trouble.START_AFTER_STOP: (0.02, 0.15),
    Trouble.START_AT_ONCE: (0.0,),
}
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
    """One stop: how hard, what went wrong before it, how much later it came, and by whom."""

    level: StopLevel
    trouble: Trouble
    moment_s: float = 0.0
    client: StopClient = StopClient.SOCKET

    def __str__(self) -> str:
        return f"{self.client} {self.level}, {self.trouble}, {self.moment_s:g} s later"

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
        return self.level is not StopLevel.FREEZE and self.client is not StopClient.SIGNAL


def stop_cases() -> Iterator[StopCase]:
    """Every stop of the campaign; no signal freezes a face."""
    for level, trouble, moment_s, client in product(
        StopLevel, FIRST_TROUBLES, MOMENTS_S, (StopClient.SOCKET, StopClient.SIGNAL)
    ):
        if _exists(level, client):
            yield StopCase(level, trouble, moment_s, client)
    for level, trouble, client in product(
        (StopLevel.SOFT, StopLevel.LIMP),
        _FOR_MORE_CLIENTS,
        (StopClient.COMMAND, StopClient.PAGE_SCRIPT),
    ):
        yield StopCase(level, trouble, 0.0, client)
    for level, trouble, client in product(StopLevel, FOR_EVERY_CLIENT, StopClient):
        if _exists(level, client):
            yield StopCase(level, trouble, 0.0, client)
    for level in StopLevel:
        yield StopCase(level, Trouble.FOREIGN_ENDLESS, 0.0, StopClient.COMMAND)
    for level, client in product(
        StopLevel,
        (StopClient.SOCKET, StopClient.SIGNAL, StopClient.PAGE_SCRIPT, StopClient.CONTROL),
    ):
        if _exists(level, client):
            yield StopCase(level, Trouble.CLOCK_JUMPS, 0.0, client)
    yield from _meetings()


def _meetings() -> Iterator[StopCase]:
    """Stops that meet another stop, or a start."""
    for client in (StopClient.SOCKET, StopClient.PAGE_SCRIPT, StopClient.COMMAND):
        yield StopCase(StopLevel.LIMP, Trouble.EASING, 0.0, client)
    for level, moment_s in zip((StopLevel.LIMP, StopLevel.SOFT) * 2, _STARTING_S, strict=True):
        yield StopCase(level, Trouble.STARTING, moment_s)
    for level, (trouble, moments_s) in product(
        (StopLevel.SOFT, StopLevel.LIMP), _MEETINGS_S.items()
    ):
        for moment_s in moments_s:
            yield StopCase(level, trouble, moment_s)


def _exists(level: StopLevel, client: StopClient) -> bool:
    return not (level is StopLevel.FREEZE and client is StopClient.SIGNAL)


def batches(cases: Sequence[StopCase]) -> list[list[StopCase]]:
    """The same cases in batches that one face can serve, what ends a face last in each.

    A face that serves a batch has the same doors throughout, and the same trouble.
    """

    def shared(case: StopCase) -> tuple[str, bool, bool]:
        return case.trouble, case.page, case.agents

    def order(case: StopCase) -> tuple[tuple[str, bool, bool], bool, bool]:
        return shared(case), case.client is StopClient.SIGNAL, case.level is StopLevel.FREEZE

    found = []
    for _, group in groupby(sorted(cases, key=order), shared):
        alike = list(group)
        starts = range(0, len(alike), _MOST_OF_A_FACE)
        found += [alike[n : n + _MOST_OF_A_FACE] for n in starts]
    return found
