"""What waits to be sent to one client: bounded, so that a slow reader costs nobody but itself."""

import asyncio
import json
from collections import deque
from collections.abc import Mapping
from typing import Final

_MOST_WAITING: Final = 256
#: Of which the next makes up for a lost one: these make room.
_REPLACEABLE: Final = frozenset({"position", "phoneme"})

Event = Mapping[str, object]


class Outbox:
    """Events for one client, first in, first out. Of one event loop."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque()
        self._filled = asyncio.Event()
        #: Set when an event had to be lost that may not be: the client does not read.
        self.overflowed = asyncio.Event()
        self._is_closed = False

    def put(self, event: Event) -> None:
        """Send it when the client reads."""
        if self._is_closed:
            return
        if len(self._events) >= _MOST_WAITING and not self._make_room():
            if event["type"] not in _REPLACEABLE:
                self.overflowed.set()
            return
        self._events.append(event)
        self._filled.set()

    def error(self, code: str, message: str, **about: object) -> None:
        """Tell the client what went wrong."""
        self.put({"type": "error", "code": code, "message": message, **about})

    def close(self) -> None:
        """The client has gone: nothing is kept for it any more."""
        self._is_closed = True
        self._events.clear()

    async def take(self) -> str:
        """The next event, as JSON; waits for one."""
        while not self._events:
            self._filled.clear()
            await self._filled.wait()
        return json.dumps(self._events.popleft(), default=str)

    def _make_room(self) -> bool:
        for n, event in enumerate(self._events):
            if event["type"] in _REPLACEABLE:
                del self._events[n]
                return True
        return False
