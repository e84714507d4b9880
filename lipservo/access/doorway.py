"""The room for connections that have not sent their request yet, kept so that a stop gets in.

Both servers that clients reach over TCP use it: that of voice agents, and the dashboard's. A client
that sends nothing, or a byte a second, costs no other a place: the oldest makes room.
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
#: A crowd is not dropped in one moment: it may come again at once, and would delay a stop.
_APART_S: Final = 0.01
#: Of a room, for one peer.
_SHARE: Final = 0.75
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
        """Make a room for `scaled(most)` connections, each of which may wait `patience_s`."""
        self._most = scaled(most)
        self._patience_s = patience_s
        # In the order in which they came, with what ends their patience; and how many a peer has.
        self._waiting: dict[asyncio.WriteTransport, asyncio.TimerHandle] = {}
        self._of_peer: Counter[str] = Counter()

    def enter(self, connection: asyncio.WriteTransport) -> None:
        """Let a connection wait here from now on, unless it does already."""
        if connection in self._waiting:
            return
        patience_s = self._patience_s + len(self._waiting) * _APART_S
        late = asyncio.get_running_loop().call_later(patience_s, self._abort, connection)
        self._waiting[connection] = late
        peer = _peer_of(connection)
        self._of_peer[peer] += 1
        is_full = len(self._waiting) > self._most
        if is_full:
            peer = max(self._of_peer, key=self._of_peer.__getitem__)
        if is_full or self._of_peer[peer] > _SHARE * self._most:
            self._abort(next(each for each in self._waiting if _peer_of(each) == peer))

    def leave(self, connection: asyncio.WriteTransport) -> bool:
        """Let a connection wait here no longer; return whether it did."""
        late = self._waiting.pop(connection, None)
        if late is not None:
            late.cancel()
            self._of_peer -= Counter((_peer_of(connection),))  # keeps no peer that has none
        return late is not None

    def _abort(self, connection: asyncio.WriteTransport) -> None:
        self.leave(connection)
        connection.abort()


def scaled(most: int) -> int:
    """Return `most`, or fewer (4 at least) where this process may open fewer than 1,024 files."""
    with contextlib.suppress(ImportError):  # no POSIX
        import resource

        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        most_files = _FILES if soft == resource.RLIM_INFINITY else min(soft, _FILES)
        return max(4, most * most_files // _FILES)
    return most


def _peer_of(connection: asyncio.BaseTransport) -> str:
    return str((connection.get_extra_info("peername") or ("",))[0])
