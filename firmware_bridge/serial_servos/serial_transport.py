"""A serial port, opened by pyserial for this process alone; a tty's reads sleep in the kernel."""

import contextlib
import errno
import fcntl
import os
import select
import socket
import sys
import termios
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

import serial
from serial.serialposix import Serial as Tty

from firmware_bridge.clock import Clock, MonotonicClock
from firmware_bridge.errors import PortError, PortGone, RateError
from firmware_bridge.transport import Transport

#: More than the longest reply of 252 servos.
_CHUNK: Final = 16_384
#: A network connection that takes no bytes for so long is lost. Stalls of a busy computer are
#: shorter; pyserial's RFC 2217 has a limit of its own, and accepts no other.
_SEND_S: Final = 0.25
#: How often to look for bytes where the kernel cannot wake this process when they come.
_LOOKS_EACH_S: Final = 0.0005


class PyserialTransport:
    """A `Transport` through pyserial's calls: the handler of a URL, a mock, a fake in memory."""

    def __init__(
        self,
        handle: Any,
        port: str,
        baud_rate: int,
        clock: Clock,
        lock: socket.socket | None = None,
    ) -> None:
        """Use `handle`, an open port of pyserial's or a mock, which no other code may use.

        port: its path or URL, for messages. clock: for deadlines. lock: a socket that is closed
        with the port, such as that of `_open_url`; None: there is none.
        """
        self._handle = handle
        self._lock = lock
        self._port = port
        self.clock = clock
        self._baud_rate = baud_rate

    @property
    def baud_rate(self) -> int:
        """Bits per second on the wire."""
        return self._baud_rate

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None:
        """Set the baud rate. Raises RateError for an impossible one, PortGone for a lost port."""
        try:
            self._handle.baudrate = baud_rate
        except ValueError as error:
            raise RateError(_no_such_rate(self._port, baud_rate)) from error
        except (OSError, termios.error) as error:
            raise self._gone(error) from error
        self._baud_rate = baud_rate

    def write(self, data: bytes) -> None:
        """Write all bytes."""
        try:
            self._handle.write(data)
        except OSError as error:
            raise self._gone(error) from error

    def read(self, deadline_s: float) -> bytes:
        """Return the bytes that come until `deadline_s`; b"": none came."""
        while not (data := self.discard_input()) and self.clock.now() < deadline_s:
            self.clock.sleep_until(min(deadline_s, self.clock.now() + _LOOKS_EACH_S))
        return data

    def discard_input(self) -> bytes:
        """Return and remove the bytes that have arrived, without waiting; b"": none."""
        try:
            data = bytes(self._handle.read(self._handle.in_waiting))
            # pyserial's handlers of URLs may report or return one byte although more have come.
            while data and "://" in self._port and (more := self._handle.read(_CHUNK)):
                data += more
        except OSError as error:
            raise self._gone(error) from error
        return data

    def close(self) -> None:
        """Close the port, so that others can open it again."""
        with contextlib.suppress(OSError):
            self._handle.close()
        if self._lock is not None:
            self._lock.close()

    def _gone(self, error: Exception) -> PortGone:
        return PortGone(f"{self._port}: gone ({error}); plug the adapter in again")


class SerialTransport(PyserialTransport):
    """A `Transport` over a tty, USB adapter or pseudo-terminal, that uses its descriptor."""

    def __init__(self, handle: Tty, clock: Clock) -> None:
        super().__init__(handle, str(handle.port), handle.baudrate, clock)
        self._fd: int = handle.fileno()
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def write(self, data: bytes) -> None:
        """Write all bytes to the kernel; wait only while its buffer is full."""
        try:
            written = os.write(self._fd, data)
            while written < len(data):
                select.select([], [self._fd], [], 0.1)
                written += os.write(self._fd, data[written:])
        except OSError as error:
            raise self._gone(error) from error

    def read(self, deadline_s: float) -> bytes:
        """Wait for bytes until `deadline_s`, asleep in the kernel; return them, b"": none came.

        poll() waits for whole milliseconds; the fraction that remains is slept through, so that a
        silent servo costs no more time than intended. Raises PortGone.
        """
        try:
            left_ms = (deadline_s - self.clock.now()) * 1e3
            if not self._poll.poll(max(0, int(left_ms))):
                self.clock.sleep_until(deadline_s)
                if not self._poll.poll(0):
                    return b""
            data = os.read(self._fd, _CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._gone(error) from error
        if not data:
            raise self._gone(OSError(errno.EIO, "end of file"))
        return data

    def discard_input(self) -> bytes:
        """Return and remove the bytes that have arrived, without waiting; b"": none."""
        try:
            return os.read(self._fd, _CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._gone(error) from error

    def close(self) -> None:
        """Unlock and close the port, so that others can open it again."""
        if self._fd >= 0:
            self._fd = -1
            release(self._handle)
            with contextlib.suppress(OSError):
                self._handle.close()


def open_port(port: str, baud_rate: int, clock: Clock | None = None) -> PyserialTransport:
    """Open a serial port for this process alone, or a URL of pyserial's (`socket://host:5000`).

    clock: for deadlines; None: the computer's monotonic clock. Raises PortError with the remedy:
    no such port, no permission, used by another program, impossible baud rate.
    """
    clock = clock or MonotonicClock()
    try:
        if "://" in port:
            return _open_url(port, baud_rate, clock)
        handle = serial.Serial(port, baud_rate, timeout=0, exclusive=True)
    except ValueError as error:
        unknown = f"{port}: {error}; pyserial knows socket://, rfc2217://, loop:// and spy://"
        raise PortError(unknown if "://" in port else _no_such_rate(port, baud_rate)) from error
    except termios.error as error:
        raise PortError(f"{port}: is not a serial port") from error
    except OSError as error:
        raise PortError(explain(port, error)) from error
    if type(handle) is not Tty:  # a test has replaced serial.Serial by a mock
        return PyserialTransport(handle, port, baud_rate, clock)
    try:
        claim(handle)
        _ask_for_low_latency(handle, port)
        return SerialTransport(handle, clock)
    except OSError as error:
        handle.close()
        raise PortError(explain(port, error)) from error


def _open_url(url: str, baud_rate: int, clock: Clock) -> PyserialTransport:
    """Open a URL of pyserial's; a network address is locked for this process, as a tty would be.

    The lock is a Unix socket with a name in Linux's abstract namespace, which the kernel frees when
    the process dies. Raises OSError (EADDRINUSE if another process has the lock), ValueError for an
    unknown kind of URL.
    """
    scheme, _, address = url.partition("://")
    with contextlib.ExitStack() as undo:
        lock = None
        if scheme in {"socket", "rfc2217"} and sys.platform == "linux":
            lock = undo.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            lock.bind(f"\0lipservo {address.partition('?')[0].rstrip('/')}")
        handle = serial.serial_for_url(url, baud_rate, timeout=0, exclusive=True)
        if scheme == "socket":
            handle.write_timeout = _SEND_S
            # pyserial leaves Nagle's algorithm on, which delays requests.
            with socket.socket(fileno=os.dup(handle.fileno())) as wire:
                wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        undo.pop_all()
    return PyserialTransport(handle, url, baud_rate, clock, lock)


def claim(handle: Any) -> None:
    """Lock the port for this process. Raises OSError when another process holds the lock.

    A file lock keeps out programs that also lock, even root's; the terminal's exclusive flag, set
    as well, keeps out all but root's. A handle that is no tty is left alone.
    """
    if type(handle) is not Tty:
        return
    fd = handle.fileno()
    fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    fcntl.ioctl(fd, termios.TIOCEXCL)


def release(handle: Any) -> None:
    """Clear the exclusive flag that `claim` sets; a port that is gone is ignored."""
    if type(handle) is Tty:
        with contextlib.suppress(OSError):
            fcntl.ioctl(handle.fileno(), termios.TIOCNXCL)


def latency_timer_ms(port: str) -> int | None:
    """Return how many ms the USB adapter holds bytes back; None: its driver has no such timer."""
    name = Path(port).resolve().name
    try:
        return int(Path(f"/sys/bus/usb-serial/devices/{name}/latency_timer").read_text())
    except (OSError, ValueError):
        return None


def adapter_identity(port: str, sysfs: Path = Path("/sys")) -> str | None:
    """Return a text that identifies the USB adapter behind a port; None: the port is not USB.

    The text has the adapter's serial number; without one, as most CH340, the USB path of the socket
    that it is plugged into. sysfs: where sysfs is mounted; another folder in tests.
    """
    # From the tty's device upwards; the folder with `idVendor` is the USB device itself.
    device = (sysfs / "class/tty" / Path(port).resolve().name / "device").resolve()
    for folder in (device, *device.parents):
        with contextlib.suppress(OSError):
            return f"serial number {(folder / 'serial').read_text().strip()}"
        if (folder / "idVendor").exists():
            return f"USB path {folder.name}"
    return None


class SameAdapter:
    """A function that opens one port repeatedly, but never another adapter that has taken its name.

    A face whose adapter was unplugged must not take the servos that appear at its old port.
    """

    def __init__(
        self, port: str, baud_rate: int, opener: Callable[[str, int], Transport] = open_port
    ) -> None:
        """Open `port` at `baud_rate` by `opener`, as that of dynamixel-sdk."""
        self._open = partial(opener, port, baud_rate)
        self._port = port
        self._identity: str | None = None

    def __call__(self) -> Transport:
        """Open and return the port; remember at the first call which adapter was there.

        Raises PortError, also if another adapter than at the first call is at the port, or one
        without a serial number is in another USB socket.
        """
        found = adapter_identity(self._port)
        if self._identity is not None and found != self._identity:
            raise PortError(
                f"{self._port}: another adapter is there ({found or 'not USB'}, not "
                f"{self._identity}); plug the face's own one in where it was, or restart"
            )
        transport = self._open()
        self._identity = found
        return transport


def _ask_for_low_latency(handle: Tty, port: str) -> None:
    """Set FTDI adapters not to collect bytes for 16 ms, which is their default.

    Best effort: other adapters need nothing, and without permission the udev rule does it.
    https://github.com/ROBOTIS-GIT/DynamixelSDK/issues/302
    """
    name = Path(port).resolve().name
    with contextlib.suppress(OSError):
        Path(f"/sys/bus/usb-serial/devices/{name}/latency_timer").write_text("1")
    with contextlib.suppress(OSError, ValueError, AttributeError):  # Linux only
        handle.set_low_latency_mode(True)


def _no_such_rate(port: str, baud_rate: int) -> str:
    return f"{port}: this adapter cannot do {baud_rate:,} baud; choose another bus.baud_rate"


def explain(port: str, error: OSError) -> str:
    """Return the message why `port` could not be opened, from `error`, with the remedy."""
    if "://" in port:
        in_use = error.errno == errno.EADDRINUSE
        why = "used by another program of this computer" if in_use else f"cannot be opened: {error}"
        return f"{port}: {why}"
    if error.errno is None:  # pyserial could not change the settings of a terminal
        return f"{port}: is not a serial port"
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        found = sorted(str(path) for path in Path("/dev/serial/by-id").glob("*"))
        there = f"there are: {', '.join(found)}" if found else "is the adapter plugged in?"
        return f"{port}: no such port; {there}"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"{port}: no permission; run `sudo usermod -aG dialout $USER`, log out and in again"
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return f"{port}: used by another program; `fuser -v {port}` tells which"
    return f"{port}: cannot be opened: {os.strerror(error.errno)}"
