"""A limit on connections that have not sent their request yet, so that a stop always gets in.

Both servers that clients reach over TCP use it: that of voice agents, and the dashboard's. Clients
that send nothing, or a byte a second, keep nobody out: the oldest of them is disconnected.
"""

import asyncio
import contextlib
import math
from collections import Counter
from typing import Final

#: The head of a request, and the body of a stop, must have come within so long.
HEAD_S: Final = 5.0
#: Connections whose request is awaited: as many as files allow, since a client that is dropped
#: connects again, which costs more than to let it wait. Limits here are for a process that may open
#: `_FILES`.
MOST_HEADS: Final = 448
_FILES: Final = 1024
#: Connections that came together are dropped so far apart: they may all come again at once, and
#: would delay a stop.
_SPREAD_S: Final = 0.01
#: The largest share of the connections that one peer may have.
_PEER_SHARE: Final = 0.75
#: Connections that the kernel holds until they are accepted. To one that finds no room there the
#: kernel does not answer, and a client tries again after a second: too late for a stop.
BACKLOG: Final = 512
#: Connections accepted at a time. The loop reads from them soon after, before so many others have
#: come that a stop, sent at once, could be the oldest that has sent nothing.
ACCEPTED: Final = 16


class Doorway:
    """A limit of waiting connections, so that idle clients cannot block a stop.

    Where there is no room for another, the oldest connection of the peer (an IP address) that has
    the most is aborted. No peer gets more than three quarters of the room. To be used by one event
    loop.
    """

    def __init__(self, most: int, patience_s: float = math.inf) -> None:
        """Allow `scaled(most)` connections to wait, each of them `patience_s` seconds."""
        self._most_connections = scaled(most)
        self._patience_s = patience_s
        # In order of arrival, with the timer that aborts each; and how many of them a peer has.
        self._waiting: dict[asyncio.WriteTransport, asyncio.TimerHandle] = {}
        self._n_of_peer: Counter[str] = Counter()

    def enter(self, connection: asyncio.WriteTransport) -> None:
        """Count a connection as waiting for its request, and abort it when its patience is over.

        If too many connections wait, the oldest of the peer with most of them is aborted at once;
        if this peer has more than its share, its own oldest.
        """
        if connection in self._waiting:
            return
        patience_s = self._patience_s + len(self._waiting) * _SPREAD_S
        timer = asyncio.get_running_loop().call_later(patience_s, self._abort, connection)
        self._waiting[connection] = timer
        peer = _peer_of(connection)
        self._n_of_peer[peer] += 1
        is_full = len(self._waiting) > self._most_connections
        if is_full:
            peer = max(self._n_of_peer, key=self._n_of_peer.__getitem__)
        if is_full or self._n_of_peer[peer] > _PEER_SHARE * self._most_connections:
            self._abort(next(each for each in self._waiting if _peer_of(each) == peer))

    def leave(self, connection: asyncio.WriteTransport) -> bool:
        """Count a connection as waiting no longer; return whether it was waiting."""
        timer = self._waiting.pop(connection, None)
        if timer is not None:
            timer.cancel()
            self._n_of_peer -= Counter((_peer_of(connection),))  # keeps no peer that has none
        return timer is not None

    def _abort(self, connection: asyncio.WriteTransport) -> None:
        self.leave(connection)
        connection.abort()


def scaled(most: int) -> int:
    """Return `most`, or fewer (4 at least) where this process may open fewer than 1,024 files."""
    with contextlib.suppress(ImportError):  # no POSIX
        import resource

        soft_limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        most_files = _FILES if soft_limit == resource.RLIM_INFINITY else min(soft_limit, _FILES)
        return max(4, most * most_files // _FILES)
    return most


def _peer_of(connection: asyncio.BaseTransport) -> str:
    return str((connection.get_extra_info("peername") or ("",))[0])
