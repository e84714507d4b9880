"""Hobby servos on a Raspberry Pi Pico that its USB port shows as a Pololu Maestro; README.md."""

import select
import sys
import time

import micropython
from machine import PWM, WDT, Pin
from protocol import Maestro

# GP numbers of channel 0, 1, ...; GP0 to GP15 each have a pulse of their own.
PINS = (2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13)
# Without a complete command for so long all pulses stop.
TIMEOUT_MS = 500
SHORTEST_US, LONGEST_US = 500, 2500
DEVICE = 12
# Wired to ground at power-up: no firmware, but MicroPython's prompt, to change files.
PROMPT_PIN = 22
PULSES_HZ = 50
# A program that hangs is started anew by the chip itself, without pulses.
HANG_MS = 2000
# Bytes taken at once: time must pass for whoever sends without end, too.
MOST_BYTES = 64


class Outputs:
    """The pulses of all pins."""

    def __init__(self, maestro):
        self._maestro = maestro
        self._pins = [PWM(Pin(pin), freq=PULSES_HZ, duty_u16=0) for pin in PINS]
        self._sent = [0] * len(PINS)

    def follow(self):
        """Send what the protocol says."""
        for channel, pin in enumerate(self._pins):
            pulse = self._maestro.pulse(channel)
            if pulse != self._sent[channel]:
                pin.duty_ns(250 * pulse)
                self._sent[channel] = pulse

    def stop(self):
        """No pulses, whatever the protocol says."""
        for pin in self._pins:
            pin.duty_u16(0)


def run():
    """Serve for ever."""
    # 3 is a data byte here, not Ctrl-C.
    micropython.kbd_intr(-1)
    maestro = Maestro(len(PINS), SHORTEST_US, LONGEST_US, TIMEOUT_MS, DEVICE)
    outputs = Outputs(maestro)
    source, sink, one = sys.stdin.buffer, sys.stdout.buffer, bytearray(1)
    poller = select.poll()
    poller.register(sys.stdin, select.POLLIN)
    hang, before = WDT(timeout=HANG_MS), time.ticks_ms()
    try:
        while True:
            hang.feed()
            now = time.ticks_ms()
            maestro.advance(time.ticks_diff(now, before))
            before = now
            outputs.follow()
            n_bytes, wait_ms = 0, 1
            while n_bytes < MOST_BYTES and poller.poll(wait_ms) and source.readinto(one):
                n_bytes, wait_ms = n_bytes + 1, 0
                answer = maestro.receive(one[0])
                if answer:
                    # Pulses first: an answer waits for a computer that does not read.
                    outputs.follow()
                    sink.write(answer)
            outputs.follow()
    finally:
        outputs.stop()


if Pin(PROMPT_PIN, Pin.IN, Pin.PULL_UP).value():
    run()
