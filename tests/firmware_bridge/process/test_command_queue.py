"""What is asked of a face waits in its queue: stops are never lost, the newest value counts."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.process.commands import CommandError, CommandQueue, Setting
from firmware_bridge.stopping import StopLevel

SETTINGS = {"strength": Setting(1.0, 0.0, 1.5), "smoothness": Setting(0.0, 0.0, 1.0)}
FURTHEST = [StopLevel.LIMP, StopLevel.SOFT, StopLevel.FREEZE]
stops = st.sampled_from(FURTHEST)
changes = st.tuples(st.sampled_from(sorted(SETTINGS)), st.floats(0.0, 1.0))


@given(st.lists(stops | changes, max_size=50))
def test_of_all_that_was_asked_the_furthest_stop_and_the_newest_values_come_out(asked):
    queue = CommandQueue(SETTINGS)
    for each in asked:
        if isinstance(each, StopLevel):
            queue.stop(each, "somebody")
        else:
            queue.change(dict([each]))

    levels = [each for each in FURTHEST if each in asked]
    newest = dict(each for each in asked if isinstance(each, tuple))
    stop = queue.take_stop()
    assert (stop.level if stop else None) == (levels[0] if levels else None)
    assert queue.take_changes() == newest
    assert (queue.take_stop(), queue.take_changes()) == (None, {})
    assert queue.values == {"strength": 1.0, "smoothness": 0.0} | newest


def test_a_stop_after_a_weaker_one_that_was_taken_comes_as_well():
    queue = CommandQueue()
    queue.stop(StopLevel.FREEZE)
    assert queue.take_stop().level is StopLevel.FREEZE
    queue.stop(StopLevel.LIMP, "process 3")
    queue.stop(StopLevel.SOFT)
    stop = queue.take_stop()

    assert (stop.level, stop.requested_by) == (StopLevel.LIMP, "process 3")
    assert queue.take_stop() is None


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("volume", 1.0, "'volume': no such setting; there are: strength (0 to 1.5), smoothness"),
        ("strength", 1.6, "strength is 1.6; allowed: 0 to 1.5"),
        ("strength", -0.1, "strength is -0.1; allowed: 0 to 1.5"),
        ("strength", float("nan"), "strength is nan; allowed"),
        ("strength", float("inf"), "strength is inf; allowed"),
    ],
)
def test_what_cannot_be_set_is_refused_in_one_line_and_changes_nothing(name, value, said):
    queue = CommandQueue(SETTINGS)
    with pytest.raises(CommandError) as refused:
        queue.change({name: value})

    assert str(refused.value).startswith(said)
    assert queue.take_changes() == {}
    assert queue.values == {"strength": 1.0, "smoothness": 0.0}


def test_a_face_without_settings_says_why():
    with pytest.raises(CommandError, match="no such setting; this face has no settings"):
        CommandQueue().change({"strength": 1.0})
