"""Access to one chip on an I2C bus that other programs share: only the chip's address is locked.

`smbus2` is imported only where a bus of the computer is opened. A pseudo-terminal in its place
carries the same messages to a simulated chip, field for field as Linux has them (`struct i2c_msg`).
"""

import contextlib
import errno
import fcntl
import os
import select
import struct
import termios
import time
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Protocol

from firmware_bridge.errors import PortError, PortGone

#: `linux/i2c.h`, `linux/i2c-dev.h`
READ: Final = 0x0001
_PLAIN_I2C: Final = 0x0001
_I2C_TIMEOUT: Final = 0x0702
#: In units of 10 ms: how long a bus that is stuck may delay a tick; by default it is a second.
_TIMEOUT: Final = 5
#: Address, flags and length of a message; how many of them; errno and length of an answer.
MESSAGE: Final = struct.Struct("<HHH")
COUNT: Final = struct.Struct("<B")
ANSWER: Final = struct.Struct("<HH")
_TERMINALS: Final = Path("/dev/pts")
#: How long to wait for a simulator's answer.
_ANSWER_S: Final = 1.0
_OFD_LOCK: Final = struct.Struct("hhqqi4x")
#: Address, flags, and the bytes to write or how many to read.
Message = tuple[int, int, bytes | bytearray | int]
_GONE: Final = {
    errno.EREMOTEIO: "no chip acknowledges",
    errno.ENXIO: "no chip acknowledges",
    errno.ETIMEDOUT: "the bus is stuck; a chip holds SDA or SCL low",
}


class Transfers(Protocol):
    """A connection to an I2C bus that runs transfers. Its methods raise OSError."""

    def transfer(self, messages: Sequence[Message]) -> bytes:
        """Run messages as one transfer with one STOP at its end; return all bytes read, joined."""

    def close(self) -> None:
        """Close the bus."""


class I2cChip:
    """One chip at an address of an I2C bus; `name`: for messages. Methods raise PortGone."""

    def __init__(self, transfers: Transfers, address: int, name: str) -> None:
        self._transfers, self._address, self.name = transfers, address, name

    def write(self, messages: Sequence[bytes | bytearray]) -> None:
        """Write messages in one transfer, so that they take effect together.

        Each message begins with the number of its first register.
        """
        self._transfer([(self._address, 0, message) for message in messages])

    def exchange(self, messages: Sequence[bytes | bytearray], register: int) -> bytes:
        """Write messages, then read one register, in one transfer; return the register's byte.

        Each message begins with the number of its first register.
        """
        address = self._address
        written: list[Message] = [(address, 0, message) for message in messages]
        return self._transfer([*written, (address, 0, bytes((register,))), (address, READ, 1)])

    def read(self, register: int, n_bytes: int = 1) -> bytes:
        """Return `n_bytes` bytes, read from `register` on."""
        address = self._address
        return self._transfer([(address, 0, bytes([register])), (address, READ, n_bytes)])

    def close(self) -> None:
        """Close the bus; errors are ignored."""
        with contextlib.suppress(OSError):
            self._transfers.close()

    def _transfer(self, messages: Sequence[Message]) -> bytes:
        """Run messages as one transfer, once more after an error; return all bytes read.

        Raises PortGone with the cause and the remedy.
        """
        with contextlib.suppress(OSError):
            return self._transfers.transfer(messages)
        try:  # the lines of the bus may have been disturbed
            return self._transfers.transfer(messages)
        except OSError as error:
            why = _GONE.get(error.errno or 0, error.strerror or str(error))
            raise PortGone(f"{self.name}: {why}; check power, SDA and SCL of the board") from error


class DeviceTransfers:
    """Transfers on an I2C bus of the computer, by smbus2."""

    def __init__(self, bus: Any, message: Any) -> None:
        """Use `bus`, an open `smbus2.SMBus`, for transfers; message: the class `smbus2.i2c_msg`."""
        self._bus, self._message = bus, message

    def fileno(self) -> int:
        """Return the file descriptor of the bus; -1: it is closed."""
        return -1 if self._bus.fd is None else self._bus.fd

    def transfer(self, messages: Sequence[Message]) -> bytes:
        """Run messages as one transfer; return all bytes read, joined. Raises OSError."""
        make = self._message
        made = [
            make.read(address, data) if isinstance(data, int) else make.write(address, data)
            for address, _, data in messages
        ]
        self._bus.i2c_rdwr(*made)
        return b"".join(bytes(each) for each in made if each.flags & READ)

    def close(self) -> None:
        """Close the bus."""
        self._bus.close()


def _open_device(path: str) -> DeviceTransfers:
    """Open the I2C bus at `path` by smbus2.

    Raises OSError, and PortError without smbus2 or with an adapter that cannot do plain I2C.
    """
    try:
        from smbus2 import SMBus, i2c_msg
    except ImportError as error:
        raise PortError(
            f"{path}: a PCA9685 needs smbus2, which is not installed: "
            "`pip install 'lipservo[pca9685]'`"
        ) from error
    bus = SMBus(path)
    if not bus.funcs & _PLAIN_I2C:
        bus.close()
        raise PortError(f"{path}: this adapter only speaks SMBus; a PCA9685 needs full I2C")
    opened = DeviceTransfers(bus, i2c_msg)
    fcntl.ioctl(opened.fileno(), _I2C_TIMEOUT, _TIMEOUT)
    return opened


class _TerminalTransfers:
    """Transfers to a simulated chip, as frames of bytes over a pseudo-terminal."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        with contextlib.suppress(termios.error):
            tty.setraw(self._fd)
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def fileno(self) -> int:
        return self._fd

    def transfer(self, messages: Sequence[Message]) -> bytes:
        """Send messages as one frame; return all bytes read, joined.

        Raises OSError: the simulated chip's error, or ETIMEDOUT after a second without answer.
        """
        with contextlib.suppress(termios.error):
            termios.tcflush(self._fd, termios.TCIFLUSH)
        frame = [COUNT.pack(len(messages))]
        for address, flags, data in messages:
            n_bytes, sent = (data, b"") if isinstance(data, int) else (len(data), bytes(data))
            frame += [MESSAGE.pack(address, flags, n_bytes), sent]
        os.write(self._fd, b"".join(frame))
        give_up_s = time.monotonic() + _ANSWER_S
        number, n_bytes = ANSWER.unpack(self._read(ANSWER.size, give_up_s))
        if number:
            raise OSError(number, os.strerror(number))
        return self._read(n_bytes, give_up_s)

    def _read(self, n_bytes: int, give_up_s: float) -> bytes:
        """Return exactly `n_bytes`; OSError if they do not come until monotonic `give_up_s`."""
        found = b""
        while len(found) < n_bytes:
            if not self._poll.poll(max(0.0, give_up_s - time.monotonic()) * 1e3):
                raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
            part = os.read(self._fd, n_bytes - len(found))
            if not part:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            found += part
        return found

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def is_terminal(path: str) -> bool:
    """Return whether `path` leads to a pseudo-terminal, behind which the I2C chip is simulated."""
    return Path(path).resolve().parent == _TERMINALS


def open_chip(path: str, address: int) -> I2cChip:
    """Open the chip at `address` of the I2C bus at `path`, locked for this process.

    path: a device of the computer, such as /dev/i2c-1, or the pseudo-terminal of a simulator.
    Nothing is sent. On a device only the address is locked: programs that use its other addresses
    are not affected. Raises PortError, with the remedy, when the bus cannot be opened or the
    address is in use.
    """
    name = f"{path}, address {address:#04x}"
    is_alone = is_terminal(path)
    try:
        transfers = _TerminalTransfers(path) if is_alone else _open_device(path)
    except OSError as error:
        raise PortError(_explain(path, error)) from error
    try:
        _claim(transfers.fileno(), address, alone=is_alone)
    except OSError as error:
        transfers.close()
        raise PortError(
            f"{name}: used by another program; `lipservo status` lists running faces"
        ) from error
    return I2cChip(transfers, address, name)


def _claim(fd: int, address: int, *, alone: bool) -> None:
    """Lock an I2C address for this process, as one byte of the bus's file `fd`, without waiting.

    alone: lock the whole file as well, since a terminal carries one conversation; else share the
    file with other addresses. Raises OSError where another process has the lock.
    """
    # Two independent locks: flock on the file, and a lock of the byte whose offset is the address.
    fcntl.flock(fd, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    lock = _OFD_LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, address, 1, 0)
    fcntl.fcntl(fd, fcntl.F_OFD_SETLK, lock)


def _explain(path: str, error: OSError) -> str:
    """Return why the I2C bus at `path` could not be opened, with the remedy."""
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return (
            f"{path}: no such I2C bus; switch it on (Raspberry Pi: `sudo raspi-config nonint "
            "do_i2c 0`, then start anew), `ls /dev/i2c-*` lists those there are"
        )
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"{path}: not permitted; `sudo usermod -aG i2c $USER`, then log in again"
    if error.errno in (errno.ENOTTY, errno.EINVAL, errno.EISDIR):
        return f"{path}: is no I2C bus"
    return f"{path}: cannot be opened: {error.strerror}"
