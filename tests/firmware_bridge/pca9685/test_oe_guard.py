"""The guard of the OE pin as a real process; the pin is a FIFO, read as a board would see it."""

import os
import signal
import subprocess
import sys
import time

import pytest
from places import short_folder

from firmware_bridge.clock import MonotonicClock
from firmware_bridge.errors import PortError, ServoError
from firmware_bridge.pca9685 import oe_guard
from firmware_bridge.pca9685.oe_guard import OeGuard, open_pin
from firmware_bridge.pca9685.simulator import PinFifo

PATIENCE_S = 30.0


@pytest.fixture
def pin(tmp_path, monkeypatch):
    monkeypatch.setenv("LIPSERVO_RUNTIME", str(short_folder()))
    return PinFifo(tmp_path / "oe")


@pytest.fixture
def guard(pin, tmp_path):  # noqa: ARG001 - makes the FIFO
    guard = OeGuard(str(tmp_path / "oe"), 17, MonotonicClock())
    guard.start()
    yield guard
    if guard._process is not None and guard._process.poll() is None:
        guard.beat(passes=False)
    guard.close()


def wait_for(condition, beat=lambda: None):
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "nothing happened"
        beat()
        time.sleep(0.01)


def test_pulses_pass_while_heartbeats_come_and_no_longer(guard, pin):
    assert pin.is_high()
    wait_for(lambda: not pin.is_high(), lambda: guard.beat(passes=True))
    wait_for(pin.is_high)
    assert guard.has_lapsed
    wait_for(lambda: not pin.is_high(), lambda: guard.beat(passes=True))
    guard.beat(passes=False)
    wait_for(pin.is_high)


def test_a_guard_that_dies_lets_the_pin_go_high_and_is_said_at_once(guard, pin):
    wait_for(lambda: not pin.is_high(), lambda: guard.beat(passes=True))
    guard._process.kill()
    wait_for(pin.is_high)
    with pytest.raises(ServoError, match="guards the pin has died; pulses are switched off"):
        wait_for(lambda: False, lambda: guard.beat(passes=True))
    guard.close()


def test_a_guard_that_hangs_is_killed(guard, pin):
    wait_for(lambda: not pin.is_high(), lambda: guard.beat(passes=True))
    os.kill(guard._process.pid, signal.SIGSTOP)
    with pytest.raises(ServoError, match="hangs, and was killed"):
        wait_for(lambda: False, lambda: guard.beat(passes=True))
    wait_for(pin.is_high)
    guard.close()


BRIDGE = """
import sys, time
from firmware_bridge.clock import MonotonicClock
from firmware_bridge.pca9685.oe_guard import OeGuard
guard = OeGuard(sys.argv[1], 17, MonotonicClock())
guard.start()
print("up", flush=True)
while True:
    guard.beat(passes=True)
    time.sleep(0.02)
"""


@pytest.fixture
def bridge(pin, tmp_path):
    """Another process that beats."""
    command = [sys.executable, "-c", BRIDGE, str(tmp_path / "oe")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"up\n"
        wait_for(lambda: not pin.is_high())
        yield process
        process.kill()
    next_one = OeGuard(str(tmp_path / "oe"), 17, MonotonicClock())
    next_one.start()  # sends the guard away that its bridge left behind
    next_one.close()


def test_a_bridge_that_is_killed_leaves_the_pin_high_until_the_next_takes_it(bridge, pin, tmp_path):
    bridge.kill()
    bridge.wait()
    wait_for(pin.is_high)
    assert not _is_released(pin), "held, not left to a pull-up"
    guard = OeGuard(str(tmp_path / "oe"), 17, MonotonicClock())
    guard.start()
    wait_for(lambda: not pin.is_high(), lambda: guard.beat(passes=True))
    guard.beat(passes=False)
    guard.close()
    wait_for(lambda: _is_released(pin))


def test_a_guard_holds_the_pin_of_a_board_whose_registers_may_be_on_when_its_bridge_ends(
    guard, pin, tmp_path
):
    guard.beat(passes=False)
    guard.beat(passes=False, is_off=False)
    process = guard._process
    guard.close()
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.5)
    assert pin.is_high()
    assert not _is_released(pin)
    next_one = OeGuard(str(tmp_path / "oe"), 17, MonotonicClock())
    next_one.start()  # sends the other guard away
    process.wait(PATIENCE_S)
    next_one.close()
    wait_for(lambda: _is_released(pin))


def test_a_bridge_that_hangs_has_its_pulses_ended(bridge, pin):
    os.kill(bridge.pid, signal.SIGSTOP)
    wait_for(pin.is_high)
    os.kill(bridge.pid, signal.SIGCONT)
    wait_for(lambda: not pin.is_high())


@pytest.mark.usefixtures("bridge")
def test_a_pin_has_one_guard(tmp_path, monkeypatch):
    monkeypatch.setattr(oe_guard, "_TAKE_OVER_S", 0.2)
    with pytest.raises(PortError, match=r"oe_gpio 17 of .* a running face's guard"):
        OeGuard(str(tmp_path / "oe"), 17, MonotonicClock()).start()


def test_what_no_pin_is_is_refused_in_words(tmp_path, monkeypatch):
    pytest.importorskip("gpiod")
    with pytest.raises(PortError, match="no such GPIO chip; `gpiodetect`"):
        open_pin(str(tmp_path / "gpiochip7"), 17)
    (tmp_path / "gpiochip8").touch()
    with pytest.raises(PortError, match="cannot be held"):
        open_pin(str(tmp_path / "gpiochip8"), 17)
    monkeypatch.setitem(sys.modules, "gpiod", None)
    with pytest.raises(PortError, match=r"pip install 'lipservo\[pca9685\]'"):
        open_pin("/dev/gpiochip0", 17)


def test_gpiod_is_asked_for_a_pin_that_is_high_from_the_beginning(monkeypatch):
    gpiod = pytest.importorskip("gpiod")
    asked, values = [], []

    class Request:
        def set_value(self, line, value):
            values.append((line, value))

    def request_lines(path, config, *, consumer):
        asked.append((path, config, consumer))
        return Request()

    monkeypatch.setattr(gpiod, "request_lines", request_lines)
    pin = open_pin("/dev/gpiochip0", 17)
    pin.set(high=False)
    ((path, config, consumer),) = asked

    assert (path, list(config), consumer) == ("/dev/gpiochip0", [17], "lipservo OE guard")
    assert config[17].direction is gpiod.line.Direction.OUTPUT
    assert config[17].output_value is gpiod.line.Value.ACTIVE
    assert values == [(17, gpiod.line.Value.INACTIVE)]


def _is_released(pin):
    """Whether no process has the pin."""
    try:
        return os.read(pin._fd, 64) == b""
    except BlockingIOError:
        return False
