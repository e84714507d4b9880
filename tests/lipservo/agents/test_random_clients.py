"""Anything at all may come in: the face goes on, and keeps nothing of it."""

import random

import pytest
from voice_agents.random_clients import survive

#: Of 500 and of 5,000 messages alike: what pools and tables keep.
_MOST_GROWTH_BYTES = 1 << 20


def test_two_thousand_random_messages_harm_nobody():
    assert survive(random.Random(1), 2_000) < _MOST_GROWTH_BYTES


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(5))
def test_a_hundred_thousand_random_messages_leave_memory_as_it_was(seed, capsys):
    grown_bytes = survive(random.Random(seed), 20_000)
    with capsys.disabled():
        print(f"20,000 random messages: memory grew by {grown_bytes} bytes a storm of 5,000")  # noqa: T201
    assert grown_bytes < _MOST_GROWTH_BYTES
