"""Tables of states: which row of a cell counts, and rows that nothing could reach."""

from enum import Enum

import pytest

from firmware_bridge.state_table import Row, StateTable


class Light(Enum):
    RED = "red"
    GREEN = "green"


class Event(Enum):
    BUTTON = "button"
    TIME = "time"


class When(Enum):
    NIGHT = "night"


class Act(Enum):
    RING = "ring"


BUTTON = Row((Light.RED,), Event.BUTTON, Light.GREEN, (Act.RING,), when=When.NIGHT)
ALWAYS = Row((Light.RED, Light.GREEN), Event.BUTTON)
TABLE = StateTable((BUTTON, ALWAYS))


def test_the_first_row_of_a_cell_whose_guard_holds_counts():
    assert TABLE.find(Light.RED, Event.BUTTON, lambda guard: guard is When.NIGHT) is BUTTON
    assert TABLE.find(Light.RED, Event.BUTTON, lambda _guard: False) is ALWAYS
    assert TABLE.find(Light.GREEN, Event.BUTTON, lambda _guard: True) is ALWAYS


def test_an_event_that_has_no_row_means_nothing():
    assert TABLE.find(Light.RED, Event.TIME, lambda _guard: True) is None
    only_at_night = StateTable((BUTTON,))
    assert only_at_night.find(Light.RED, Event.BUTTON, lambda _guard: False) is None


def test_the_cells_are_those_in_which_an_event_means_something():
    assert list(TABLE.cells()) == [
        (Light.RED, Event.BUTTON, (BUTTON, ALWAYS)),
        (Light.GREEN, Event.BUTTON, (ALWAYS,)),
    ]


def test_a_row_behind_one_that_always_counts_is_refused():
    with pytest.raises(ValueError, match=r"Light\.RED, Event\.BUTTON: a row before this one"):
        StateTable((ALWAYS, BUTTON))
