"""A simulated device as a port: in memory on any clock, or a pseudo-terminal for any program."""

import contextlib
import ctypes
import fcntl
import os
import secrets
import select
import struct
import termios
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

from firmware_bridge.bus import Array, ServoBus
from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.errors import PortError, PortGone


class SimulatedDevice(Protocol):
    """The device at the other end of a simulated port; times are seconds on one clock."""

    @property
    def plugged(self) -> bool:
        """Whether the device's port exists now."""

    @property
    def next_delivery_s(self) -> float:
        """The time in s of the next bytes to the computer; infinity: none."""

    def advance(self, now_s: float) -> None:
        """Simulate the device until `now_s`."""

    def receive(self, data: bytes, now_s: float, baud_rate: int) -> None:
        """Process bytes that the computer sends at `now_s` at a baud rate."""

    def deliver(self, now_s: float) -> bytes:
        """Return and remove the bytes that reach the computer by `now_s`; b"": none."""


@dataclass(frozen=True, slots=True)
class WatchedServos:
    """Servos simulated in memory: bus and clock, and their true state, for tests.

    device: the simulated device. shafts_deg: returns the joints' true angles now, (n_servos,)
    degrees. is_reachable: returns whether the bus can reach the device now.
    """

    bus: ServoBus
    clock: ManualClock
    device: Any
    shafts_deg: Callable[[], Array]
    is_reachable: Callable[[], bool]


class MemoryTransport:
    """A `Transport` to a simulated device in memory; `tap` gets every write, as (time_s, bytes)."""

    def __init__(
        self,
        chain: SimulatedDevice,
        clock: Clock,
        baud_rate: int = 1_000_000,
        tap: Callable[[float, bytes], None] | None = None,
    ) -> None:
        """Open the port of the device `chain`. Raises PortGone while the device is unplugged.

        clock: advanced by reads, if it is a manual one. tap: called as tap(time_s, data) for every
        write.
        """
        self._chain = chain
        self.clock = clock
        self.baud_rate = baud_rate
        self._tap = tap
        self._closed = False
        self._check()

    def write(self, data: bytes) -> None:
        """Send bytes to the simulated device. Raises PortGone."""
        self._check()
        if self._tap is not None:
            self._tap(self.clock.now(), data)
        self._chain.receive(data, self.clock.now(), self.baud_rate)

    def read(self, deadline_s: float) -> bytes:
        """Advance the clock to the next delivery; return its bytes; b"": none by `deadline_s`."""
        self._check()
        self.clock.sleep_until(min(self._chain.next_delivery_s, deadline_s))
        data = self._chain.deliver(self.clock.now())
        if not data:
            self.clock.sleep_until(deadline_s)
        return data

    def discard_input(self) -> bytes:
        """Return and remove the bytes that have been delivered."""
        self._check()
        return self._chain.deliver(self.clock.now())

    def close(self) -> None:
        """Close the port, and drop the device's bytes under way."""
        if not self._closed:
            self._closed = True
            self._chain.deliver(float("inf"))

    def _check(self) -> None:
        self._chain.advance(self.clock.now())
        if self._closed or not self._chain.plugged:
            self._closed = True
            raise PortGone("the simulated port is closed or unplugged; open it again")


_TERMINALS: Final = Path("/dev/pts")


class PortLink:
    """A symbolic link to a simulator's port, made by it; links and files of others stay."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._port = ""

    def lead_to(self, port: str) -> None:
        """Make the path a symbolic link to `port`.

        A link that this object made is replaced, and one to a pseudo-terminal that no longer
        exists, as a simulator that was killed leaves behind. Raises PortError for anything else at
        the path, and where no link can be made.
        """
        if not self._path.name:
            raise PortError(f"--link {self._path}: is a folder, not the name of a link")
        if not self._may_take(port):
            raise PortError(
                f"--link {self._path}: a file or another program's link is there; give another path"
            )
        # Made under a new name beside the path, then moved there in one step.
        fresh = self._path.with_name(f"{self._path.name}.{secrets.token_hex(8)}")
        try:
            fresh.symlink_to(port)
            fresh.replace(self._path)
        except OSError as error:
            with contextlib.suppress(OSError):
                fresh.unlink()
            raise PortError(
                f"--link {self._path}: this link cannot be made: {error.strerror}"
            ) from error
        self._port = port

    def remove(self) -> None:
        """Remove the link if it still leads to the port that it was made for."""
        if self._port and self._target() == self._port:
            with contextlib.suppress(OSError):
                self._path.unlink()
        self._port = ""

    def _may_take(self, port: str) -> bool:
        target = self._target()
        if target is None:
            return not os.path.lexists(self._path)
        if target in (port, self._port):
            return True
        return Path(target).parent == _TERMINALS and not os.path.lexists(target)

    def _target(self) -> str | None:
        """Return the target of the link; None: there is no link at the path."""
        try:
            return os.readlink(self._path)
        except (OSError, ValueError):
            return None


#: asm-generic/ioctls.h, sys/inotify.h
_TIOCGEXCL: Final = 0x80045440
_IN_CLOSE: Final = 0x08 | 0x10
_EVENTS: Final = 16_384


class ExclusiveAccess:
    """The host's watch on one pseudo-terminal: clears the exclusive flag that clients leave.

    watch: the descriptor that becomes readable once a client has closed the port; None: there is
    none.
    """

    def __init__(self, slave: int, port: str) -> None:
        """Watch `port`, of which `slave` is the host's own descriptor.

        Without inotify a client's close is not noticed.
        """
        self._slave = slave
        self._port = port
        self.watch = _watch_closes(port)

    def other_end_closed(self) -> None:
        """Clear the exclusive flag after a client's close, unless a client has the port open.

        A real port would lose the flag when closed; this one is kept open by the host.
        """
        if self.watch is not None:
            with contextlib.suppress(BlockingIOError):
                os.read(self.watch, _EVENTS)
        if self._is_exclusive() and not self._is_held():
            fcntl.ioctl(self._slave, termios.TIOCNXCL)

    def close(self) -> None:
        """Stop watching, and close the watch's descriptor."""
        if self.watch is not None:
            os.close(self.watch)
            self.watch = None

    def _is_exclusive(self) -> bool:
        try:
            answer = fcntl.ioctl(self._slave, _TIOCGEXCL, bytes(4))
        except OSError:
            return False
        return struct.unpack("i", answer) != (0,)

    def _is_held(self) -> bool:
        """Return whether any process, this one included, has the port open besides the host itself.

        Processes of other users cannot be inspected. They could not open the port either, except
        for root, whom exclusive access never kept out.
        """
        own = f"/proc/{os.getpid()}/fd/{self._slave}"
        for folder in Path("/proc").glob("[0-9]*/fd"):
            with contextlib.suppress(OSError):
                for name in os.listdir(folder):
                    path = f"{folder}/{name}"
                    with contextlib.suppress(OSError):
                        if os.readlink(path) == self._port and path != own:
                            return True
        return False


def _watch_closes(path: str) -> int | None:
    """Return an inotify descriptor that reports every close of file `path`; None: no inotify."""
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None, use_errno=True)
        watch = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if watch < 0:
            return None
        if libc.inotify_add_watch(watch, os.fsencode(path), _IN_CLOSE) >= 0:
            return int(watch)
        os.close(watch)
    return None


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
#: If a reply is due within this time, motors are not simulated before: it would be late.
_BUSY_S: Final = 0.001


class PtyHost:
    """A host that serves one simulated device at a pseudo-terminal, in real time. Linux only.

    The simulator sees the client's baud rate, so a wrong one is silence, as on the wire. When the
    device is unplugged, by its method `unplug` or its script, the terminal is closed. When plugged
    in again it gets a new name, and `link`, if given, leads to that name, as /dev/serial/by-id
    does.
    """

    def __init__(self, chain: SimulatedDevice, link: Path | None = None) -> None:
        """Open a terminal to the device `chain`. Raises PortError if that or `link` fails."""
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
        """Serve until `stopped()` is True, checked every 50 ms, or `wake_fd` is readable.

        The loop delivers replies when they are due, and between them simulates the device, follows
        its plug, and receives the client's bytes.
        """
        while not stopped():
            now_s = time.monotonic() - self._zero_s
            wait_s = self._chain.next_delivery_s - now_s
            if wait_s > _BUSY_S:  # no reply is due soon
                self._chain.advance(now_s)
                self._mind_the_plug()
            elif wait_s <= 0.0:
                self._deliver(now_s)
                continue
            closed = None if self._access is None else self._access.watch
            watched = [fd for fd in (self._master, wake_fd, closed) if fd is not None and fd >= 0]
            longest_s = _LONGEST_SLEEP_S if self._master >= 0 else _LONGEST_SLEEP_S / 10
            ready = select.select(watched, [], [], min(max(wait_s, 0.0), longest_s))[0]
            if self._master in ready:
                self._receive()
            if wake_fd in ready:
                return
            if self._access is not None and closed in ready:
                self._access.other_end_closed()

    def turn(self, index: int, by_deg: float) -> None:
        """Turn a limp servo's shaft by `by_deg`, as by hand, if the device has such shafts."""
        if (turn := getattr(self._chain, "turn", None)) is not None:
            turn(index, by_deg)

    def close(self) -> None:
        """Close the terminal, at which clients read the end of file, and remove the link."""
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
        """Open a new pseudo-terminal, whose name becomes `port`. Raises PortError."""
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            raise PortError(f"no pseudo-terminal can be opened: {error.strerror}") from error
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._access = ExclusiveAccess(self._slave, self.port)

    def _mind_the_plug(self) -> None:
        """Open or close the terminal if the device was plugged in or unplugged since."""
        if self._chain.plugged and self._master < 0:
            self._plug_in()
            if self._link is not None:
                # A file of another program may be there meanwhile: it stays.
                with contextlib.suppress(PortError):
                    self._link.lead_to(self.port)
        elif not self._chain.plugged and self._master >= 0:
            self.close()

    def _receive(self) -> None:
        """Pass the client's bytes to the device, at the baud rate that the client has set."""
        now_s = time.monotonic() - self._zero_s
        try:
            data = os.read(self._master, _CHUNK)
        except OSError:
            return
        if rate := _baud_rate(self._slave):
            self._chain.receive(data, now_s, rate)

    def _deliver(self, now_s: float) -> None:
        if data := self._chain.deliver(now_s):
            # A client that does not read loses bytes, as from a full receive buffer.
            with contextlib.suppress(BlockingIOError, OSError):
                os.write(self._master, data)


def _baud_rate(terminal: int) -> int | None:
    """Return the rate that a client has set at a terminal, in bits/s; None: unknown."""
    try:
        settings = fcntl.ioctl(terminal, _TCGETS2, bytes(_TERMIOS2_SIZE))
    except OSError:  # other numbers on some machines
        return _RATES.get(termios.tcgetattr(terminal)[5])
    return int(struct.unpack_from("I", settings, _OUTPUT_SPEED_AT)[0])
