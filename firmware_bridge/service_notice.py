"""What systemd is told of a running face: ready when the servos are driven, and alive since."""

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from firmware_bridge.control_socket import ask

#: systemd waits for 20 s (`WatchdogSec` of the unit).
_ALIVE_S: Final = 1.0
#: A bridge that is still waking its servos does not answer; it is asked again soon.
_PATIENCE_S: Final = 0.05


class ServiceNotice:
    """Call it often: it says READY=1 once, and WATCHDOG=1 every second."""

    def __init__(self, control: Path, now_s: Callable[[], float] = time.monotonic) -> None:
        """control: the bridge's control socket; it answers once the servos are awake."""
        self._control = control
        self._now_s = now_s
        self._ready = False
        self._alive_s = -_ALIVE_S
        self._wanted = bool(os.environ.get("NOTIFY_SOCKET"))

    def __call__(self) -> None:
        """Say what there is to say; nothing when systemd did not start us."""
        if not self._wanted:
            return
        if not self._ready:
            try:
                ask(self._control, "status", _PATIENCE_S)
            except OSError:
                return
            self._ready = True
            notify("READY=1")
        if self._now_s() - self._alive_s >= _ALIVE_S:
            self._alive_s = self._now_s()
            notify("WATCHDOG=1")


def notify(state: str) -> None:
    """Tell systemd, if it started us: `READY=1`, `WATCHDOG=1`; see sd_notify(3)."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notifier:
        notifier.sendto(state.encode(), address)
