"""Stands in for the board's own module, for CPython and MicroPython: pulses go to a file as JSON.

PULSES names it. A row is [GP number, frequency, pulse in ns]; others are ["chip", what, number].
"""

import json
import os

_log = open(os.getenv("PULSES"), "w")  # noqa: SIM115 - open until the process is killed


def _write(row):
    _log.write(json.dumps(row) + "\n")
    _log.flush()


class Pin:
    """What is wired to ground is listed in GROUNDED."""

    IN, PULL_UP = 0, 1

    def __init__(self, number, *_how):
        self.number = number

    def value(self):
        return int(str(self.number) not in (os.getenv("GROUNDED") or "").split())


class PWM:
    """Duties as the RP2040 takes them: all ones are always on."""

    def __init__(self, pin, freq, duty_u16):
        assert freq > 7
        self._pin, self._freq = pin.number, freq
        self.duty_u16(duty_u16)

    def duty_u16(self, duty):
        self.duty_ns(duty * 1_000_000_000 // (65535 * self._freq))

    def duty_ns(self, pulse_ns):
        assert 0 <= pulse_ns < 1_000_000_000 // self._freq
        _write([self._pin, self._freq, pulse_ns])


class Interrupts:
    """In place of the module micropython: which byte is Ctrl-C, -1: none."""

    def kbd_intr(self, byte):
        _write(["chip", "Ctrl-C", byte])


class WDT:
    """Once on, the board is reset where nobody feeds it; a file PULSES.raise raises in here."""

    def __init__(self, timeout):
        assert 0 < timeout <= 8388
        _write(["chip", "watchdog", timeout])

    def feed(self):
        try:
            os.stat(os.getenv("PULSES") + ".raise")
        except OSError:
            return
        raise ValueError("a test wants it")
