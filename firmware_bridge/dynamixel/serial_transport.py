"""A serial port as raw descriptor: blocking reads, no polling, one owner."""

import array
import contextlib
import errno
import fcntl
import os
import select
import termios
from pathlib import Path
from typing import Final

from firmware_bridge.bus import PortError, PortGone
from firmware_bridge.clock import Clock, MonotonicClock

#: Baud rates that termios names here; 4.5 Mbaud is not among them.
_SPEEDS: Final = {
    int(name[1:]): value
    for name, value in vars(termios).items()
    if name[:1] == "B" and name[1:].isdigit() and name != "B0"
}
#: linux/serial.h: ask the driver not to hold bytes back. Only some drivers know it.
_TIOCGSERIAL, _TIOCSSERIAL, _ASYNC_LOW_LATENCY = 0x541E, 0x541F, 0x2000
#: More than the longest reply of 252 servos.
_CHUNK: Final = 16_384


class SerialTransport:
    """A `Transport` over a tty: USB adapter or pseudo-terminal. Use `open_port` to make one."""

    def __init__(self, fd: int, port: str, baud_rate: int, clock: Clock) -> None:
        self._fd = fd
        self._port = port
        self._clock = clock
        self._baud_rate = baud_rate
        self._poll = select.poll()
        self._poll.register(fd, select.POLLIN)

    @property
    def clock(self) -> Clock:
        """The computer's."""
        return self._clock

    @property
    def baud_rate(self) -> int:
        """Bits a second on the wire."""
        return self._baud_rate

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None:
        try:
            _configure(self._fd, self._port, baud_rate)
        except termios.error as error:
            raise self._gone(error) from error
        self._baud_rate = baud_rate

    def write(self, data: bytes) -> None:
        """Hand all of it to the kernel; waits only while its buffer is full."""
        try:
            written = os.write(self._fd, data)
            while written < len(data):
                select.select([], [self._fd], [], 0.1)
                written += os.write(self._fd, data[written:])
        except BlockingIOError as error:
            raise self._gone(error) from error
        except OSError as error:
            raise self._gone(error) from error

    def read(self, deadline_s: float) -> bytes:
        """Sleep in the kernel until bytes come or time is up."""
        try:
            left_ms = (deadline_s - self._clock.now()) * 1e3
            if not self._poll.poll(max(0.0, left_ms)):
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
        """Take what is there."""
        try:
            return os.read(self._fd, _CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._gone(error) from error

    def close(self) -> None:
        """Close the descriptor, which also gives the lock back."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                os.close(self._fd)
            self._fd = -1

    def _gone(self, error: Exception) -> PortGone:
        return PortGone(f"{self._port}: gone ({error}); plug the adapter in again")


def open_port(port: str, baud_rate: int, clock: Clock | None = None) -> SerialTransport:
    """Open a port for us alone. Raises PortError that says what to do."""
    try:
        fd = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise PortError(_explain(port, error)) from error
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _configure(fd, port, baud_rate)
        _ask_for_low_latency(fd, port)
        termios.tcflush(fd, termios.TCIOFLUSH)
        return SerialTransport(fd, port, baud_rate, clock or MonotonicClock())
    except OSError as error:
        os.close(fd)
        raise PortError(_explain(port, error)) from error
    except termios.error as error:
        os.close(fd)
        raise PortError(f"{port}: is not a serial port ({error})") from error
    except PortError:
        os.close(fd)
        raise


def latency_timer_ms(port: str) -> int | None:
    """How long the adapter holds bytes back; None where the driver does not tell (not FTDI)."""
    name = Path(port).resolve().name
    try:
        return int(Path(f"/sys/bus/usb-serial/devices/{name}/latency_timer").read_text())
    except (OSError, ValueError):
        return None


def _configure(fd: int, port: str, baud_rate: int) -> None:
    """Raw bytes, eight bits, no parity, one stop bit, no flow control."""
    speed = _SPEEDS.get(baud_rate)
    if speed is None:
        raise PortError(f"{port}: {baud_rate} baud is not known to this computer")
    control = termios.CS8 | termios.CREAD | termios.CLOCAL
    characters = termios.tcgetattr(fd)[6]
    characters[termios.VMIN], characters[termios.VTIME] = 0, 0
    termios.tcsetattr(fd, termios.TCSANOW, [0, 0, control, 0, speed, speed, characters])


def _ask_for_low_latency(fd: int, port: str) -> None:
    """Ask FTDI chips not to collect bytes for 16 ms, as they do by default.

    Best effort: other adapters need nothing, and without permission the udev rule does it.
    https://github.com/ROBOTIS-GIT/DynamixelSDK/issues/302
    """
    name = Path(port).resolve().name
    with contextlib.suppress(OSError):
        Path(f"/sys/bus/usb-serial/devices/{name}/latency_timer").write_text("1")
    with contextlib.suppress(OSError, ValueError):
        settings = array.array("i", [0] * 32)
        fcntl.ioctl(fd, _TIOCGSERIAL, settings)
        settings[4] |= _ASYNC_LOW_LATENCY
        fcntl.ioctl(fd, _TIOCSSERIAL, settings)


def _explain(port: str, error: OSError) -> str:
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        found = sorted(str(path) for path in Path("/dev/serial/by-id").glob("*"))
        there = f"there are: {', '.join(found)}" if found else "is the adapter plugged in?"
        return f"{port}: no such port; {there}"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"{port}: no permission; run `sudo usermod -aG dialout $USER`, log out and in again"
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return f"{port}: used by another program; `fuser -v {port}` tells which"
    return f"{port}: cannot be opened: {error.strerror}"
