"""The guard of a PCA9685's OE pin: a process that holds it low only as long as a bridge lives.

The bridge is the process that drives the servos. OE is active low: while it is high the board makes
no pulse, whatever its registers say. The guard lowers it for half a second at each heartbeat, and
lets it go high when none comes: when the bridge has died, hangs, or has stopped all servos. The
guard ends with the bridge only where the registers are off as well; else it holds the pin high
until the next guard of the pin ends it. With a pull-up at the pin, the pin goes high as well when
the guard or the computer dies.

Run as `python -m firmware_bridge.pca9685.oe_guard CHIP LINE DESCRIPTOR` by `OeGuard`.
"""

import contextlib
import errno
import fcntl
import os
import select
import signal
import socket
import stat
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Final, NoReturn, Protocol

from firmware_bridge.clock import Clock
from firmware_bridge.errors import PortError, ServoError
from firmware_bridge.process.operating_system import run_on_time
from firmware_bridge.process.runtime_folder import ControlError, runtime_folder

#: The name under which the guard holds the pin in the kernel.
CONSUMER: Final = "lipservo OE guard"
#: How long the pin stays low after a heartbeat; a busy bridge is never that late.
HOLD_S: Final = 0.5
#: A bridge that is later than this must assume that its pulses have been blocked.
_LAPSED_S: Final = HOLD_S / 2
#: An unchanged heartbeat is sent at most this often.
_BEAT_S: Final = 0.05
#: A guard that has not answered for this long counts as hanging.
_SILENT_S: Final = 1.0
_START_S: Final = 10.0
#: How long to wait for an earlier guard of the pin to end.
_TAKE_OVER_S: Final = 2.0
#: struct flock of fcntl.h: type, whence, start, length, process id
_POSIX_LOCK: Final = struct.Struct("hhqqi4x")
#: Heartbeats, which the guard sends back: let pulses through, block them, or block them although
#: the registers may be on.
_PASS, _BLOCK, _HOLD = b"1", b"0", b"2"
_IGNORED: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def is_stand_in(chip: str) -> bool:
    """Return whether `chip` is a FIFO, which leads to a simulator in place of a GPIO chip."""
    try:
        return stat.S_ISFIFO(os.stat(chip).st_mode)
    except OSError:
        return False


class OeGuard:
    """The handle of an OE pin's guard, a process that blocks pulses when heartbeats stop.

    OE: output enable, of a PCA9685 board; high blocks its pulses. `beat` never waits.
    """

    def __init__(self, chip: str, line: int, clock: Clock) -> None:
        """Prepare a handle; `start` starts the guard process.

        chip, line: the GPIO chip and line of the OE pin, such as /dev/gpiochip0 and 17.
        """
        self._chip, self._line, self._clock = chip, line, clock
        self._process: subprocess.Popen[bytes] | None = None
        self._link: socket.socket | None = None
        self._sent, self._sent_s, self._heard_s = _BLOCK, 0.0, 0.0

    @property
    def passes(self) -> bool:
        """Whether the last heartbeat lets pulses through."""
        return self._sent == _PASS

    @property
    def has_lapsed(self) -> bool:
        """Whether pulses may have been blocked while the registers are on.

        So after a heartbeat that let them through, but is old, and after one with `is_off` False.
        """
        return self._sent == _HOLD or (self.passes and self._clock.now() - self._sent_s > _LAPSED_S)

    def start(self) -> None:
        """Start the guard process, which drives the pin high (no pulses), unless one runs already.

        Raises PortError with the reason when the guard cannot hold the pin.
        """
        if self._process is not None and self._process.poll() is None:
            return
        self.close()
        self._link, end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with end:
            command = [sys.executable, "-P", "-m", "firmware_bridge.pca9685.oe_guard"]
            self._process = subprocess.Popen(
                [*command, self._chip, str(self._line), str(end.fileno())],
                pass_fds=[end.fileno()],
                stdin=subprocess.DEVNULL,
                # The guard may outlive this process, and would keep inherited pipes open.
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        self._link.settimeout(_START_S)
        # The guard's first message: `_BLOCK` once the pin is high, or the text of an error.
        try:
            answer = self._link.recv(512)
        except OSError:
            answer = b"its guard does not start"
        if answer != _BLOCK:
            self.close()
            message = answer.decode("utf-8", "replace") or "its guard died while it started"
            raise PortError(f"oe_gpio {self._line} of {self._chip}: {message}")
        self._link.setblocking(False)
        self._sent, self._sent_s = _BLOCK, self._clock.now()
        self._heard_s = self._sent_s

    def beat(self, *, passes: bool, is_off: bool = True) -> None:
        """Send a heartbeat: let pulses through for half a second (`passes`), or end them now.

        Call it in every tick; an unchanged heartbeat is sent every 50 ms at most. Raises ServoError
        once the guard is dead or hangs: nothing would end the pulses then. is_off: of a heartbeat
        that ends pulses, whether the registers go off as well, so that the guard may end.
        """
        now_s = self._clock.now()
        wanted = _PASS if passes else _BLOCK if is_off else _HOLD
        if wanted == self._sent and now_s - self._sent_s < _BEAT_S:
            return
        if self._sent_s - self._heard_s > _SILENT_S:
            self._fail("hangs, and was killed")
        if now_s - self._sent_s > _SILENT_S:
            self._heard_s = now_s  # without heartbeats the guard had nothing to answer
        self._sent, self._sent_s = wanted, now_s
        if (link := self._link) is None:
            self._fail("has died")
        try:
            link.send(wanted, socket.MSG_NOSIGNAL)
            # Read all echoes; no more: BlockingIOError; b"": the guard has closed its end.
            while link.recv(64):
                self._heard_s = now_s
            self._fail("has died")
        except BlockingIOError:
            pass
        except OSError:
            self._fail("has died")

    def close(self) -> None:
        """Close the connection to the guard process, which ends the pulses.

        The guard process itself ends only if the last heartbeat had ended the pulses already, with
        the registers off; else it continues, to hold the pin high.
        """
        if self._link is not None:
            self._link.close()
            self._link = None
        process, self._process = self._process, None
        if process is not None and self._sent == _BLOCK:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_TAKE_OVER_S)

    def _fail(self, what: str) -> NoReturn:
        """Kill the guard process, so that the pin's pull-up ends the pulses; raise ServoError.

        Always raises. what: what the process did, such as `has died`, for the message.
        """
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        raise ServoError(
            f"oe_gpio {self._line} of {self._chip}: the process that guards the pin {what}; pulses "
            "are switched off, since nothing would end them with this program: start the face again"
        )


class Pin(Protocol):
    """One digital output of the computer."""

    def set(self, *, high: bool) -> None:
        """Drive the pin high or low."""


class _GpioPin:
    """A GPIO line, driven by libgpiod; the kernel frees it however this process ends."""

    def __init__(self, chip: str, line: int) -> None:
        """Request the line as an output, driven high.

        Raises OSError, and ImportError without gpiod.
        """
        import gpiod
        from gpiod.line import Direction, Value

        high = gpiod.LineSettings(direction=Direction.OUTPUT, output_value=Value.ACTIVE)
        self._request = gpiod.request_lines(chip, {line: high}, consumer=CONSUMER)
        self._line, self._values = line, (Value.INACTIVE, Value.ACTIVE)

    def set(self, *, high: bool) -> None:
        self._request.set_value(self._line, self._values[high])


class _StandIn:
    """A FIFO in place of a pin, read by a simulated board; once closed, the pin counts as high."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
        self.set(high=True)

    def set(self, *, high: bool) -> None:
        os.write(self._fd, b"1" if high else b"0")


def open_pin(chip: str, line: int) -> Pin:
    """Open `line` of the GPIO `chip`, or the FIFO `chip` in its place, driven high.

    Raises PortError with the remedy.
    """
    with _in_words():
        return _StandIn(chip) if is_stand_in(chip) else _GpioPin(chip, line)


def user_of(chip: str, line: int) -> str:
    """Return the name of the program that holds the GPIO line; empty: it is free. Raises PortError.

    Changes nothing; a FIFO in place of a GPIO chip counts as free.
    """
    if is_stand_in(chip):
        return ""
    with _in_words():
        import gpiod

        with gpiod.Chip(chip) as opened:
            info = opened.get_line_info(line)
        return (info.consumer or "the kernel") if info.used else ""


@contextlib.contextmanager
def _in_words() -> Iterator[None]:
    """Turn errors inside the `with` block into a PortError that gives the remedy."""
    try:
        yield
    except ImportError as error:
        raise PortError("the OE pin needs gpiod: `pip install 'lipservo[pca9685]'`") from error
    except (OSError, ValueError) as error:
        why = {
            errno.EACCES: "not permitted; `sudo usermod -aG gpio $USER`, then log in again",
            errno.EBUSY: "another program holds it; `gpioinfo` says which",
            errno.ENOENT: "no such GPIO chip; `gpiodetect` lists those there are (bus.gpio_chip)",
            errno.EINVAL: "there is no such line; `gpioinfo` lists them",
        }.get(getattr(error, "errno", 0) or 0, f"cannot be held: {error}")
        raise PortError(why) from error


def guard(link: socket.socket, pin: Pin) -> bool:
    """Drive the OE pin by the heartbeats received over `link`, until the bridge closes its end.

    The main loop of the guard process. The pin is low (pulses) for `HOLD_S` after a heartbeat that
    lets pulses through, else high. Every heartbeat is sent back. Return True if the last heartbeat
    had blocked pulses, or none came.
    """
    # wanted: the last heartbeat; until_s: when the pin goes high unless another one comes
    waits, wanted, is_high, until_s = select.poll(), _BLOCK, True, 0.0
    waits.register(link, select.POLLIN)
    while True:
        left_s = max(0.0, until_s - time.monotonic())
        is_late = not waits.poll(None if is_high else left_s * 1e3)
        heard = b""  # no heartbeat in time, or the bridge has closed its end
        if not is_late:
            with contextlib.suppress(OSError):
                heard = link.recv(64)
        # The pin is set when it has to change, not at each heartbeat.
        if is_high is not (is_high := heard != _PASS):
            pin.set(high=is_high)
        if is_late:
            continue
        if not heard:
            return wanted == _BLOCK
        wanted, until_s = heard, time.monotonic() + HOLD_S
        with contextlib.suppress(OSError):
            link.send(wanted, socket.MSG_NOSIGNAL | socket.MSG_DONTWAIT)


def _lock(chip: str, line: int) -> int:
    """Lock `line` of GPIO `chip` for this process; return the descriptor of the lock's file.

    The process that holds the lock gets SIGTERM, which ends a guard whose bridge is gone, and which
    the guard of a running face ignores. Raises PortError when the file cannot be made, or the lock
    is still held after 2 s.
    """
    name = f"oe-{os.path.realpath(chip).replace('/', '_')}-{line}.lock"
    try:
        fd = os.open(runtime_folder() / name, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except (OSError, ControlError) as error:
        raise PortError(f"the lock file of this pin cannot be made: {error}") from error
    give_up_s = time.monotonic() + _TAKE_OVER_S
    while True:
        with contextlib.suppress(OSError):
            fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return fd
        # The process that holds the lock; 0 or less if it has just let go.
        found = fcntl.fcntl(fd, fcntl.F_GETLK, _POSIX_LOCK.pack(fcntl.F_WRLCK, 0, 0, 0, 0))
        holder = _POSIX_LOCK.unpack(found)[4]
        if time.monotonic() > give_up_s:
            raise PortError(f"process {holder}, a running face's guard, holds it; stop that face")
        with contextlib.suppress(OSError):
            if holder > 0:
                os.kill(holder, signal.SIGTERM)
        time.sleep(0.02)


def main() -> None:
    """Run the guard process: argv has GPIO chip, line, and an inherited socket to the bridge.

    Send the bridge one heartbeat once the pin is held high, or the text of an error.
    """
    chip, line, link = sys.argv[1], int(sys.argv[2]), socket.socket(fileno=int(sys.argv[3]))
    for number in _IGNORED:
        signal.signal(number, signal.SIG_IGN)
    try:
        _lock(chip, line)
        pin = open_pin(chip, line)
    except PortError as error:
        link.send(str(error).encode()[:500])
        return
    run_on_time()
    link.send(_BLOCK)
    if not guard(link, pin):
        # The chip may still make pulses: hold the pin high until another guard ends this process.
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        link.close()
        signal.pause()


if __name__ == "__main__":
    main()
