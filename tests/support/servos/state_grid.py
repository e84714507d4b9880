"""Machines of states as grids of text, written by hand: what tests hold a state table against."""

from operator import attrgetter

#: In a cell: the event means nothing there, and that is tried.
NOTHING = "."
#: In a cell: nothing can cause the event there.
CANNOT_COME = "x"


def grid(text):
    """A grid, | between its columns, the states in the first line and an event before each other:
    the cells, by (state, event)."""
    head, *lines = [line.split("|") for line in text.strip("\n").splitlines()]
    states = [each.strip() for each in head[1:]]
    cells = {}
    for event, *row in lines:
        for state, cell in zip(states, row, strict=True):
            cells[state, event.strip()] = cell.strip()
    return cells


def differences(table, cells, states, events, word=attrgetter("value")):
    """In what a grid and a table differ, in words: cells that only one has, or says to be empty.

    word: what the grid calls a state.
    """
    wanted = {(word(state), event.value) for state in states for event in events}
    full = {(word(state), event.value) for state, event, _rows in table.cells()}
    empty = {each for each, cell in cells.items() if cell in (NOTHING, CANNOT_COME)}
    found = {
        "not in the grid": wanted - set(cells),
        "not in the machine": set(cells) - wanted,
        "empty in the grid alone": full & empty,
        "empty in the table alone": wanted - full - empty,
    }
    return [f"{state}, {event}: {words}" for words, keys in found.items() for state, event in keys]
