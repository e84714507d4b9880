"""The room for connections that have not sent their request yet, kept so that a stop gets in.

Both servers that clients reach over TCP use it: that of voice agents, and the dashboard's. A client
that sends nothing, or a byte a second, costs nobody else a place for long: the oldest makes room.
"""

import asyncio
import contextlib
import math
from typing import Final

#: The head of a request, and the body of a stop, must be there by then.
HEAD_S: Final = 5.0
#: Connections whose request is awaited. All bounds are of a process that may open so many files.
MOST_HEADS: Final = 128
_FILES: Final = 1024
#: Connections that the kernel holds until they are accepted. To one that finds no room there the
#: kernel does not answer, and a client tries again after a second: too late for a stop.
BACKLOG: Final = 512
#: Connections accepted at a time. The loop reads from them soon after, before so many others have
#: come that a stop, sent at once, could be the oldest that has sent nothing.
ACCEPTED: Final = 16


class Doorway:
    """Connections that wait, of which the oldest is aborted where there is no room for another.

    No peer (an IP address) gets more than half of the room. Where the room is full, the peer that
    has the most of it loses its oldest. To be used by one event loop.
    """

    def __init__(self, most: int, patience_s: float = math.inf) -> None:
        """Make a room for `scaled(most)` connections, each of which may wait `patience_s`."""
        self._most = scaled(most)
        self._patience_s = patience_s
        # Of each peer, in the order in which they came.
        self._waiting: dict[str, dict[asyncio.WriteTransport, asyncio.TimerHandle]] = {}

    def enter(self, connection: asyncio.WriteTransport) -> None:
        """Let a connection wait here from now on, unless it does already."""
        own = self._waiting.setdefault(_peer_of(connection), {})
        if connection in own:
            return
        late = asyncio.get_running_loop().call_later(self._patience_s, self._abort, connection)
        own[connection] = late
        if 2 * len(own) > self._most:
            self._abort(next(iter(own)))
        elif sum(map(len, self._waiting.values())) > self._most:
            most, _ = max(self._waiting.items(), key=lambda each: len(each[1]))
            self._abort(next(iter(self._waiting[most])))

    def leave(self, connection: asyncio.WriteTransport) -> bool:
        """Let a connection wait here no longer; return whether it did."""
        peer = _peer_of(connection)
        own = self._waiting.get(peer, {})
        if connection not in own:
            return False
        own.pop(connection).cancel()
        if not own:
            del self._waiting[peer]
        return True

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
