"""What systemd is told of a running face: ready when the servos are driven, and alive since."""

import os
import socket
import time
from collections.abc import Callable
from typing import Final

#: systemd waits for 20 s (`WatchdogSec` of the unit).
_ALIVE_S: Final = 1.0


class ServiceNotice:
    """Says READY=1 once and WATCHDOG=1 every second; nothing when systemd did not start us.

    A socket that is no longer there is said once and otherwise ignored.
    """

    def __init__(
        self, say: Callable[[str], None], now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._say = say
        self._now_s = now_s
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        self._ready = False
        self._has_warned = False
        self._alive_s = float("-inf")

    def ready(self) -> None:
        """The servos are driven."""
        if not self._ready:
            self._ready = True
            self._notify("READY=1")

    def alive(self) -> None:
        """The loop that moves the face is alive; call it often."""
        now_s = self._now_s()
        if self._ready and now_s - self._alive_s >= _ALIVE_S:
            self._alive_s = now_s
            self._notify("WATCHDOG=1")

    def _notify(self, state: str) -> None:
        """See sd_notify(3)."""
        if not self._address:
            return
        address = self._address
        if address.startswith("@"):
            address = "\0" + address[1:]
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notifier:
                notifier.setblocking(False)
                notifier.sendto(state.encode(), address)
        except (OSError, ValueError) as error:
            if not self._has_warned:
                self._has_warned = True
                self._say(f"systemd is not told: NOTIFY_SOCKET={self._address}: {error}")
