"""Bytes of the Maestro's commands: the examples of Pololu's guide, and a property of its CRC."""

import numpy as np
import pytest

from firmware_bridge.maestro.controller import Maestro, PulseCommands
from firmware_bridge.maestro.protocol import command, crc7, describe_errors, split
from firmware_bridge.maestro.settings import MaestroSettings


def commands(channels, *, together, **bus):
    maestro = Maestro(None, MaestroSettings(model="mini24", **bus))
    return PulseCommands(maestro, channels, together=together)


def test_the_examples_of_the_guide():
    """https://www.pololu.com/docs/0J40/5.e : channel 2 to 1500 us; channel 5 to a speed of 140."""
    assert command(0x84, (2, *split(6000)), crc=False) == bytes.fromhex("84 02 70 2e")
    assert command(0x84, (2, *split(6000)), device=12, crc=False) == bytes.fromhex("aa0c0402702e")
    assert command(0x87, (5, *split(140)), crc=False) == bytes.fromhex("87 05 0c 01")


def test_the_crc_of_the_guide_and_of_long_division():
    """https://www.pololu.com/docs/0J40/5.d : 0x83 0x01 has 0x17."""
    assert crc7(b"\x83\x01") == 0x17
    rng = np.random.default_rng(1)
    for message in (rng.bytes(n) for n in range(1, 30)):
        bits = [byte >> n & 1 for byte in message for n in range(8)] + [0] * 7
        for at in range(len(bits) - 7):  # x^7 + x^3 + 1, the first bit sent is the highest power
            if bits[at]:
                for step in (0, 4, 7):
                    bits[at + step] ^= 1
        assert crc7(message) == sum(bit << n for n, bit in enumerate(bits[-7:]))


def test_servos_on_channels_in_a_row_are_told_by_one_command():
    block = commands([4, 3, 9], together=True).of(np.array([1500.0, 1000.0, 0.0]))

    assert block == bytes.fromhex("9f 02 03 20 1f 70 2e84 09 00 00")


def test_the_smallest_is_told_one_by_one():
    block = commands([1, 0], together=False).of(np.array([1500.0, 1000.25]))

    assert block == bytes.fromhex("84 00 21 1f84 01 70 2e")


@pytest.mark.parametrize("device", [None, 12])
def test_every_command_ends_with_its_crc(device):
    block = commands([0, 1, 5], together=True, crc=True, device=device).of(np.full(3, 1500.0))
    head = b"\x9f" if device is None else b"\xaa\x0c\x1f"
    first = head + bytes.fromhex("02 00 70 2e 70 2e")

    assert block[: len(first) + 1] == first + bytes((crc7(first),))
    rest = block[len(first) + 1 :]
    assert rest[-1] == crc7(rest[:-1])


def test_errors_are_told_in_words():
    assert describe_errors(0b101000) == ["serial CRC error", "serial timeout"]
