"""A face for agents whose loudspeaker keeps account of what was heard, on a clock of its own.

Server, playout and WebSockets are the real ones. Sound passes some twenty
times as fast as it is heard.
"""

import tempfile
import threading
import time
from collections import Counter, deque
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from lipservo.agents.agent_server import AgentServer
from lipservo.agents.listener import AgentSettings, bind_listener
from lipsync.audio.playout import Playout

RATE_HZ: Final = 24_000
#: As a face with the shipped recogniser declares it.
_LEAD_S: Final = 0.23
_STEP_S: Final = 0.02
#: The least that a tick takes, so that the threads of clients and server come to their turn.
_TICK_S: Final = 0.0004
_JOIN_S: Final = 10.0


class CountingLoudspeaker:
    """Counts what leaves it, by value: a test signal tells by its value which word it is."""

    name, is_lost, rate_hz = "virtual", False, RATE_HZ
    latency_s = 0.0
    n_underruns = 0

    def __init__(self) -> None:
        self.position_s = 0.0
        self.heard: Counter[int] = Counter()
        self._n_played = 0
        self._waiting: deque[NDArray[np.float32]] = deque()

    def write(self, samples: NDArray[np.float32]) -> None:
        """Append samples to play.

        Parameters
        ----------
        samples : NDArray[np.float32]
            (n,).
        """
        self._waiting.append(samples)

    def position(self) -> tuple[float, float] | None:
        """Return None: the caller's clock counts, not the loudspeaker's."""
        return None

    def silence_rest(self) -> float:
        """Replace by silence what has not been played by now; return the position, s."""
        self.pass_until(self.position_s)
        self._waiting = deque(np.zeros_like(each) for each in self._waiting)
        return self.position_s

    def pass_until(self, position_s: float) -> None:
        """Play the waiting samples up to `position_s` of sound, and count them by value."""
        self.position_s = position_s
        while self._waiting:
            n_due = round(position_s * RATE_HZ) - self._n_played
            samples = self._waiting[0]
            if n_due <= 0:
                return
            values, counts = np.unique(np.rint(samples[:n_due] * 32_768), return_counts=True)
            self.heard.update(dict(zip(values.astype(int).tolist(), counts.tolist(), strict=True)))
            self._n_played += min(n_due, len(samples))
            self._waiting.popleft()
            if n_due < len(samples):
                self._waiting.appendleft(samples[n_due:])


class VirtualFace:
    """Serves agents while it is entered."""

    def __init__(self) -> None:
        self.loudspeaker = CountingLoudspeaker()
        self.playout = Playout(self.loudspeaker)
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._play_until_over, name="virtual face")
        self._folder = tempfile.TemporaryDirectory()
        self.server = self._make_server("127.0.0.1:0")

    def _make_server(self, address: str) -> AgentServer:
        """Return a server of agents at HOST:PORT, not yet entered; port 0 is any free one."""
        return AgentServer(
            bind_listener(address, None),
            self.playout,
            control_path=Path(self._folder.name) / "none.sock",
            delay_ms=lambda: 1e3 * _LEAD_S,
            settings=AgentSettings(messages_per_s=1e6),
        )

    def leave(self) -> None:
        """Serve no agent any more: the face is absent."""
        self._address = self.url.removeprefix("ws://")
        self.server.__exit__(None, None, None)

    def come_back(self) -> None:
        """Serve agents again, at the same address."""
        self.server = self._make_server(self._address)
        self.server.__enter__()

    @property
    def url(self) -> str:
        """The URL for agents."""
        return str(self.server.status()["url"])

    def __enter__(self) -> Self:
        self._thread.start()
        self.server.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        self.server.__exit__(*exc)
        self._is_over.set()
        self._thread.join(_JOIN_S)
        self._folder.cleanup()

    def _play_until_over(self) -> None:
        """Advance loudspeaker and playout in steps of `_STEP_S` of sound until the face is left."""
        position_s = 0.0
        while not self._is_over.is_set():
            self.loudspeaker.pass_until(position_s)
            self.playout.advance(position_s)
            self.playout.blocks(position_s + _LEAD_S)
            position_s += _STEP_S
            time.sleep(_TICK_S)
