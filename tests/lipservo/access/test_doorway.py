"""The room for connections that wait: who makes room for whom."""

import asyncio
import math
import resource

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipservo.access.doorway import Doorway, scaled


class Connection:
    """The part of a transport that a doorway uses."""

    def __init__(self, peer):
        self.peer = peer
        self.is_aborted = False

    def get_extra_info(self, name):
        return {"peername": (self.peer, 50_000)}[name]

    def abort(self):
        self.is_aborted = True


def entered(peers, most, patience_s=math.inf):
    """Connections of these peers after all have entered, one after the other, a room for `most`."""

    async def enter():
        doorway = Doorway(most, patience_s)
        connections = [Connection(each) for each in peers]
        for each in connections:
            doorway.enter(each)
        return connections

    return asyncio.run(enter())


def kept(peers, most):
    return [n for n, each in enumerate(entered(peers, most)) if not each.is_aborted]


def test_the_oldest_of_a_peer_that_has_three_quarters_of_the_room_makes_room():
    assert kept("aaaaaaa", 8) == [1, 2, 3, 4, 5, 6]


def test_where_the_room_is_full_the_peer_with_the_most_loses_its_oldest():
    assert kept("abbbbcccd", 8) == [0, 2, 3, 4, 5, 6, 7, 8]


@given(st.lists(st.sampled_from("abcdef")), st.sampled_from([4, 8, 12]))
def test_the_newest_is_always_let_in_and_no_bound_is_passed(peers, most):
    left = kept(peers, most)
    assert len(left) <= most
    assert not peers or left[-1] == len(peers) - 1
    for peer in set(peers):
        assert sum(peers[n] == peer for n in left) <= 0.75 * most
        if peers.count(peer) == 1 and len(set(peers)) < most // 2:
            assert peers.index(peer) in left  # nobody who came once is sent away by a crowd


async def test_who_waits_too_long_is_aborted_the_oldest_first_and_who_left_is_not():
    doorway = Doorway(8, 0.0)
    aborted = []
    gone, late, later = (Connection("a") for _ in range(3))
    for each in (gone, late, later):
        each.abort = lambda each=each: aborted.append(each)
        doorway.enter(each)
    assert doorway.leave(gone)
    assert not doorway.leave(gone)
    while len(aborted) < 2:
        await asyncio.sleep(0)
    assert not doorway.leave(late)
    assert aborted == [late, later]


async def test_to_enter_again_gives_no_new_time_and_no_newer_place():
    doorway = Doorway(4)
    first, *others = (Connection("a") for _ in range(4))
    for each in (first, others[0], first, *others[1:]):
        doorway.enter(each)
    assert [each.is_aborted for each in (first, *others)] == [True, False, False, False]


@pytest.mark.parametrize(
    ("files", "rooms"),
    [(1024, (448, 16)), (20_000, (448, 16)), (resource.RLIM_INFINITY, (448, 16)),
     (256, (112, 4)), (24, (10, 4))],
)  # fmt: skip
def test_where_fewer_files_may_be_opened_rooms_are_smaller(files, rooms, monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _kind: (files, files))
    assert (scaled(448), scaled(16)) == rooms
