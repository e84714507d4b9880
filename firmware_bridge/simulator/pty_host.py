"""A simulated chain behind a pseudo-terminal: a serial port that any program can open."""

import contextlib
import os
import select
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Final

from firmware_bridge.simulator.chain import SimulatedChain

_RATES: Final = {
    value: int(name[1:])
    for name, value in vars(termios).items()
    if name[:1] == "B" and name[1:].isdigit()
}
#: How long the loop sleeps at most, so that scripted faults and a stop are noticed.
_LONGEST_SLEEP_S: Final = 0.05
_CHUNK: Final = 65_536


class PtyHost:
    """Serves one chain on the computer's clock until stopped. Linux only.

    The simulator sees the client's baud rate through termios, so a wrong one is silence, as on the
    wire. A scripted `unplug` closes the terminal; plugged in again it has a new name, and `link`,
    if given, points to it, as /dev/serial/by-id does.
    """

    def __init__(self, chain: SimulatedChain, link: Path | None = None) -> None:
        self._chain = chain
        self._link = link
        self._zero_s = time.monotonic()
        self._master = self._slave = -1
        self.port = ""
        self._plug_in()

    def serve(self, stopped: Callable[[], bool], wake_fd: int | None = None) -> None:
        """Serve until `stopped` says so; readable bytes on `wake_fd` make it ask at once."""
        while not stopped():
            now_s = time.monotonic() - self._zero_s
            self._chain.advance(now_s)
            self._mind_the_plug()
            if self._master < 0:
                time.sleep(_LONGEST_SLEEP_S / 10)
                continue
            self._deliver(now_s)
            wait_s = self._chain.next_delivery_s - (time.monotonic() - self._zero_s)
            watched = [self._master] if wake_fd is None else [self._master, wake_fd]
            ready = select.select(watched, [], [], min(max(wait_s, 0.0), _LONGEST_SLEEP_S))[0]
            if self._master in ready:
                self._receive()
            if wake_fd in ready:
                return

    def close(self) -> None:
        """Hang up: clients see the end of file."""
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def _plug_in(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        if self._link is not None:
            fresh = self._link.with_name(self._link.name + ".new")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self.port)
            fresh.replace(self._link)

    def _mind_the_plug(self) -> None:
        if self._chain.plugged and self._master < 0:
            self._plug_in()
        elif not self._chain.plugged and self._master >= 0:
            self.close()

    def _receive(self) -> None:
        now_s = time.monotonic() - self._zero_s
        try:
            data = os.read(self._master, _CHUNK)
        except OSError:
            return
        rate = _RATES.get(termios.tcgetattr(self._slave)[5])
        if rate:
            self._chain.receive(data, now_s, rate)

    def _deliver(self, now_s: float) -> None:
        data = self._chain.deliver(now_s)
        if data:
            # A client that does not read loses bytes, as from a full receive buffer.
            with contextlib.suppress(BlockingIOError, OSError):
                os.write(self._master, data)
