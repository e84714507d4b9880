"""A simulated chain behind a pseudo-terminal: a serial port that any program can open."""

import contextlib
import fcntl
import os
import select
import struct
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Final

from firmware_bridge.bus import PortError
from firmware_bridge.simulator.chain import SimulatedChain
from firmware_bridge.simulator.exclusive_access import ExclusiveAccess
from firmware_bridge.simulator.port_link import PortLink

_RATES: Final = {
    value: int(name[1:])
    for name, value in vars(termios).items()
    if name[:1] == "B" and name[1:].isdigit()
}
#: asm-generic/ioctls.h and termbits.h: settings with the rate as a number, which also tells rates
#: that have no name. Rust's serialport sets them so, and with it rustypot.
_TCGETS2: Final = 0x802C542A
_TERMIOS2_SIZE, _OUTPUT_SPEED_AT = 44, 40
#: How long the loop sleeps at most, so that scripted faults and a stop are noticed.
_LONGEST_SLEEP_S: Final = 0.05
_CHUNK: Final = 65_536
#: Motors are not moved on when a reply is due within this: it would be late.
_BUSY_S: Final = 0.001


class PtyHost:
    """Serves one chain on the computer's clock until stopped. Linux only.

    The simulator sees the client's baud rate, so a wrong one is silence, as on the wire. `unplug`
    closes the terminal, by the chain's method or by its script; plugged in again it has a new name,
    and `link`, if given, leads to it, as /dev/serial/by-id does.
    """

    def __init__(self, chain: SimulatedChain, link: Path | None = None) -> None:
        """Raises PortError when there is no pseudo-terminal, or no link can be made at `link`."""
        self._chain = chain
        self._link = None if link is None else PortLink(link)
        self._zero_s = time.monotonic()
        self._master = self._slave = -1
        self._access: ExclusiveAccess | None = None
        self.port = ""
        self._plug_in()
        if self._link is not None:
            try:
                self._link.lead_to(self.port)
            except PortError:
                self.close()
                raise

    def serve(self, stopped: Callable[[], bool], wake_fd: int | None = None) -> None:
        """Serve until `stopped` says so; readable bytes on `wake_fd` make it ask at once."""
        while not stopped():
            now_s = time.monotonic() - self._zero_s
            wait_s = self._chain.next_delivery_s - now_s
            if wait_s > _BUSY_S:  # nothing to say soon: time for everything else
                self._chain.advance(now_s)
                self._mind_the_plug()
            elif wait_s <= 0.0:
                self._deliver(now_s)
                continue
            closed = [] if self._access is None else self._access.descriptors
            watched = [fd for fd in (self._master, wake_fd, *closed) if fd is not None and fd >= 0]
            longest_s = _LONGEST_SLEEP_S if self._master >= 0 else _LONGEST_SLEEP_S / 10
            ready = select.select(watched, [], [], min(max(wait_s, 0.0), longest_s))[0]
            if self._master in ready:
                self._receive()
            if wake_fd in ready:
                return
            if self._access is not None and closed and closed[0] in ready:
                self._access.somebody_closed()

    def close(self) -> None:
        """Hang up: clients see the end of file."""
        if self._access is not None:
            self._access.close()
            self._access = None
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1
        if self._link is not None:
            self._link.remove()

    def _plug_in(self) -> None:
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            raise PortError(f"no pseudo-terminal can be opened: {error.strerror}") from error
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._access = ExclusiveAccess(self._slave, self.port)

    def _mind_the_plug(self) -> None:
        if self._chain.plugged and self._master < 0:
            self._plug_in()
            if self._link is not None:
                # Somebody may have put something else there meanwhile: then that stays.
                with contextlib.suppress(PortError):
                    self._link.lead_to(self.port)
        elif not self._chain.plugged and self._master >= 0:
            self.close()

    def _receive(self) -> None:
        now_s = time.monotonic() - self._zero_s
        try:
            data = os.read(self._master, _CHUNK)
        except OSError:
            return
        rate = _baud_rate(self._slave)
        if rate:
            self._chain.receive(data, now_s, rate)

    def _deliver(self, now_s: float) -> None:
        data = self._chain.deliver(now_s)
        if data:
            # A client that does not read loses bytes, as from a full receive buffer.
            with contextlib.suppress(BlockingIOError, OSError):
                os.write(self._master, data)


def _baud_rate(terminal: int) -> int | None:
    """The rate that a client has set, in bits a second; None for one that nobody can tell."""
    try:
        settings = fcntl.ioctl(terminal, _TCGETS2, bytes(_TERMIOS2_SIZE))
    except OSError:  # other numbers on some machines
        return _RATES.get(termios.tcgetattr(terminal)[5])
    rate: int = struct.unpack_from("I", settings, _OUTPUT_SPEED_AT)[0]
    return rate
