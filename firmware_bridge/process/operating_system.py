"""Use of Linux and systemd by a face's processes: parent's death, real-time priority, notices."""

import contextlib
import ctypes
import gc
import logging
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from typing import Final

_LOG: Final = logging.getLogger(__name__)
#: linux/prctl.h: the signal that a process gets when its parent dies.
_PR_SET_PDEATHSIG: Final = 1
#: Above everything ordinary, below the kernel's own threads. Ours.
_FIFO_PRIORITY: Final = 50


def die_with_parent(number: int = signal.SIGTERM) -> None:
    """Have the kernel send this process the signal `number` when its parent dies, if it can."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


def write_from_background() -> None:
    """Ignore SIGTTOU: with `stty tostop` a write to the terminal would stop a background process.

    A child in a group of its own is in the background; once stopped, a bridge would count as hung.
    """
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)


@contextlib.contextmanager
def on_time() -> Iterator[bool]:
    """Run the block with real-time scheduling, then restore it; yield whether permitted."""
    granted = run_on_time()
    try:
        yield granted
    finally:
        if granted:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def run_on_time() -> bool:
    """Switch this process to first-in-first-out scheduling; return whether that was permitted.

    Garbage is collected once, and all present objects are exempt from later collections.
    """
    gc.collect()
    gc.freeze()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    except (OSError, AttributeError):
        return False
    return True


#: systemd waits for 20 s (`WatchdogSec` of the unit).
_ALIVE_S: Final = 1.0


class ServiceNotice:
    """Notices to systemd: READY=1 once, WATCHDOG=1 every second; none unless systemd started us.

    A failure to send is logged once and otherwise ignored.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        self._ready = False
        self._has_warned = False
        self._alive_s = float("-inf")

    def ready(self) -> None:
        """Notify systemd, once, that the face is up: driven, or stopped and waiting for a start."""
        if not self._ready:
            self._ready = True
            self._notify("READY=1")

    def alive(self) -> None:
        """Notify systemd, once a second after `ready`, that the face's loop runs; call it often."""
        now_s = self._now_s()
        if self._ready and now_s - self._alive_s >= _ALIVE_S:
            self._alive_s = now_s
            self._notify("WATCHDOG=1")

    def _notify(self, state: str) -> None:
        """Send systemd the notification `state`, such as READY=1; never wait; sd_notify(3)."""
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
                _LOG.warning("systemd is not notified: NOTIFY_SOCKET=%s: %s", self._address, error)
