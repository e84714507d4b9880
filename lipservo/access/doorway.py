"""The room for connections that have not sent their request yet, kept so that a stop gets in.

Both servers that clients reach over TCP use it: that of voice agents, and the dashboard's. A client
that sends nothing, or a byte a second, costs nobody else a place: the oldest makes room.
"""

import asyncio
import contextlib
import math
from collections import Counter
from typing import Final

#: The head of a request, and the body of a stop, must be there by then.
HEAD_S: Final = 5.0
#: Connections whose request is awaited. It is as large as files allow: who is dropped comes again,
#: which costs more than to let them wait. All bounds are of a process that may open so many files.
MOST_HEADS: Final = 448
_FILES: Final = 1024
#: Between two that are dropped for being late: a crowd that comes again at once would delay a stop.
_BETWEEN_S: Final = 0.01
#: Of a room, for one peer.
_SHARE: Final = 0.75
#: Connections that the kernel holds until they are accepted. To one that finds no room there the
#: kernel does not answer, and a client tries again after a second: too late for a stop.
BACKLOG: Final = 512
#: Connections accepted at a time. The loop reads from them soon after, before so many others have
#: come that a stop, sent at once, could be the oldest that has sent nothing.
ACCEPTED: Final = 16


class Doorway:
    """Connections that wait, of which the oldest is aborted where there is no room for another.

    No peer (an IP address) gets more than three quarters of the room. Where all of it is taken, the
    peer that has the most loses its oldest. To be used by one event loop.
    """

    def __init__(self, most: int, patience_s: float = math.inf) -> None:
        """Make a room for `scaled(most)` connections, each of which may wait `patience_s`."""
        self._most = scaled(most)
        self._patience_s = patience_s
        # The loop's time at which each came, the oldest first; and how many each peer has.
        self._came_s: dict[asyncio.WriteTransport, float] = {}
        self._of_peer: Counter[str] = Counter()
        self._late: asyncio.TimerHandle | None = None

    def enter(self, connection: asyncio.WriteTransport) -> None:
        """Let a connection wait here from now on, unless it does already."""
        if connection in self._came_s:
            return
        peer = _peer_of(connection)
        self._came_s[connection] = asyncio.get_running_loop().time()
        self._of_peer[peer] += 1
        if len(self._came_s) > self._most:
            ((peer, _),) = self._of_peer.most_common(1)
        if len(self._came_s) > self._most or self._of_peer[peer] > _SHARE * self._most:
            self._abort(next(each for each in self._came_s if _peer_of(each) == peer))
        self._await_late()

    def leave(self, connection: asyncio.WriteTransport) -> bool:
        """Let a connection wait here no longer; return whether it did."""
        if self._came_s.pop(connection, None) is None:
            return False
        self._of_peer -= Counter((_peer_of(connection),))  # none of 0 is kept
        return True

    def _await_late(self) -> None:
        """Drop those that are late, the oldest first, with time for others between them."""
        if self._late is None and self._came_s:
            loop = asyncio.get_running_loop()
            late_s = next(iter(self._came_s.values())) + self._patience_s
            self._late = loop.call_at(max(late_s, loop.time() + _BETWEEN_S), self._drop_late)

    def _drop_late(self) -> None:
        self._late = None
        oldest, came_s = next(iter(self._came_s.items()), (None, 0.0))
        if oldest and came_s + self._patience_s <= asyncio.get_running_loop().time():
            self._abort(oldest)
        self._await_late()

    def _abort(self, connection: asyncio.WriteTransport) -> None:
        self.leave(connection)
        connection.abort()


def scaled(most: int) -> int:
    """Return `most`, or fewer (4 at least) where this process may open fewer than 1,024 files."""
    with contextlib.suppress(ImportError):  # no POSIX
        import resource

        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        if soft != resource.RLIM_INFINITY:
            return max(4, most * min(soft, _FILES) // _FILES)
    return most


def _peer_of(connection: asyncio.BaseTransport) -> str:
    return str((connection.get_extra_info("peername") or ("",))[0])
