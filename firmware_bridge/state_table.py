"""State machines as data: rows of state, event, guard, new state and actions.

The owner of a machine keeps its state, fires events, and does the actions of the row that is found.
Besides the state it keeps data (a request, a time), never a second state.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

State = TypeVar("State", bound=Enum)
Event = TypeVar("Event", bound=Enum)
Guard = TypeVar("Guard", bound=Enum)
Action = TypeVar("Action", bound=Enum)


@dataclass(frozen=True, slots=True)
class Row(Generic[State, Event, Guard, Action]):
    """What an event does in any of some states.

    then: the new state; None: the state stays. do: actions, in this order. when: the row counts
    only where this guard holds; None: always.
    """

    states: tuple[State, ...]
    event: Event
    then: State | None = None
    do: tuple[Action, ...] = ()
    when: Guard | None = None


class StateTable(Generic[State, Event, Guard, Action]):
    """The rows of one machine, by state and event."""

    def __init__(self, rows: Sequence[Row[State, Event, Guard, Action]]) -> None:
        """Sort the rows into cells. Raises ValueError for a row that no event can reach."""
        self._cells: dict[tuple[State, Event], list[Row[State, Event, Guard, Action]]] = {}
        for row in rows:
            for state in row.states:
                cell = self._cells.setdefault((state, row.event), [])
                if cell and cell[-1].when is None:
                    raise ValueError(f"{state}, {row.event}: a row before this one always applies")
                cell.append(row)

    def find(
        self, state: State, event: Event, holds: Callable[[Guard], bool]
    ) -> Row[State, Event, Guard, Action] | None:
        """Return the first row of the cell that counts; None: the event means nothing here.

        holds: whether a guard holds now.
        """
        rows = self._cells.get((state, event), ())
        return next((row for row in rows if row.when is None or holds(row.when)), None)

    def cells(self) -> Iterator[tuple[State, Event, Sequence[Row[State, Event, Guard, Action]]]]:
        """Yield (state, event, rows) of every cell in which an event means something."""
        for (state, event), rows in self._cells.items():
            yield state, event, tuple(rows)
