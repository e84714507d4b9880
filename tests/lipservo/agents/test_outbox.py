"""What waits for a client that does not read, and how fast one may send."""

import asyncio
import json

import pytest

from lipservo.agents.agent_server import MessageRate
from lipservo.agents.messages import Outbox


def taken(outbox, n_events):
    async def take():
        return [json.loads(await outbox.take()) for _ in range(n_events)]

    return asyncio.run(take())


def test_positions_make_room_for_what_may_not_be_lost():
    outbox = Outbox()
    for number in range(256):
        outbox.put({"type": "position" if number % 2 else "mark", "number": number})
    for number in range(128):
        outbox.put({"type": "finished", "number": number})

    assert not outbox.overflowed.is_set()
    kinds = [event["type"] for event in taken(outbox, 256)]
    assert kinds == ["mark"] * 128 + ["finished"] * 128


def test_a_position_too_many_is_lost_without_harm_and_anything_else_is_an_overflow():
    outbox = Outbox()
    for _ in range(256):
        outbox.put({"type": "mark"})

    outbox.put({"type": "position"})
    assert not outbox.overflowed.is_set()
    outbox.put({"type": "mark"})
    assert outbox.overflowed.is_set()
    assert {event["type"] for event in taken(outbox, 256)} == {"mark"}


def test_nothing_is_kept_for_a_client_that_has_gone():
    outbox = Outbox()
    outbox.close()
    for _ in range(1_000):
        outbox.put({"type": "mark"})

    assert not outbox.overflowed.is_set()


@pytest.mark.parametrize("per_s", [10.0, 2_000.0])
def test_a_second_of_messages_may_come_at_once_and_then_they_come_at_the_rate(per_s):
    rate = MessageRate(per_s)
    now_s, waits_s = 100.0, []
    for _ in range(round(3 * per_s)):
        waits_s.append(rate.wait_s(now_s))
        now_s += waits_s[-1]

    assert max(waits_s[: round(per_s)]) == 0.0
    assert now_s - 100.0 == pytest.approx(2.0, abs=0.01)
    assert rate.wait_s(now_s + 60.0) == 0.0
