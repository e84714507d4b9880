"""Commands of the Maestro as bytes: https://www.pololu.com/docs/0J40/5.e .

A command byte has its top bit set, data bytes have not. Targets, speeds and positions are counted
in quarters of a microsecond. Any error that the Maestro detects turns its servos off, unless
Pololu's Control Center is set otherwise ("on startup or error").
"""

from collections.abc import Sequence
from typing import Final

SET_TARGET: Final = 0x84
SET_SPEED: Final = 0x87
SET_ACCELERATION: Final = 0x89
GET_POSITION: Final = 0x90
SET_TARGETS: Final = 0x9F
GET_ERRORS: Final = 0xA1
GO_HOME: Final = 0xA2
#: First byte of a command for one Maestro of several; its number and the command without its top
#: bit follow.
POLOLU: Final = 0xAA
#: Data bytes of each command; those of SET_TARGETS are 2 + 2 n, n the first of them.
N_DATA: Final = {
    SET_TARGET: 3,
    SET_SPEED: 3,
    SET_ACCELERATION: 3,
    GET_POSITION: 1,
    GET_ERRORS: 0,
    GO_HOME: 0,
}
#: Channels by model; the smallest has no SET_TARGETS. pico: firmware/pico_maestro.
N_CHANNELS: Final = {"micro6": 6, "mini12": 12, "mini18": 18, "mini24": 24, "pico": 12}
WITHOUT_SET_TARGETS: Final = "micro6"
#: Steps of a target in a microsecond.
QUARTERS: Final = 4
#: The largest position of a channel that is set as an input: its voltage, and no pulse.
LARGEST_INPUT: Final = 1023
#: A speed of 1 is a quarter of a microsecond in this time, at 50 pulses a second.
SPEED_UNIT_S: Final = 0.01
#: The largest value of two data bytes.
LARGEST: Final = 0x3FFF
ERRORS: Final = (
    "serial signal error",
    "serial overrun",
    "serial buffer full",
    "serial CRC error",
    "serial protocol error",
    "serial timeout",
    "script stack error",
    "script call stack error",
    "script program counter error",
)
CRC_ERROR: Final = 1 << 3
PROTOCOL_ERROR: Final = 1 << 4
TIMEOUT_ERROR: Final = 1 << 5


def _crc_of(byte: int) -> int:
    for _ in range(8):
        byte = (byte ^ 0x91) >> 1 if byte & 1 else byte >> 1
    return byte


_CRC: Final = tuple(_crc_of(byte) for byte in range(256))


def crc7(message: bytes | bytearray) -> int:
    """Return the CRC-7 of a message, x^7 + x^3 + 1, lowest bit first.

    https://www.pololu.com/docs/0J40/5.d
    """
    crc = 0
    for byte in message:
        crc = _CRC[crc ^ byte]
    return crc


def command(code: int, data: Sequence[int] = (), *, device: int | None = None, crc: bool) -> bytes:
    """Return the bytes of one command. device: the number of a Maestro; None: all on the line.

    crc: whether a CRC follows.
    """
    head = (code,) if device is None else (POLOLU, device, code & 0x7F)
    message = bytes((*head, *data))
    return message + bytes((crc7(message),)) if crc else message


def split(value: int) -> tuple[int, int]:
    """Return the low 14 bits of `value` as two data bytes, the lower seven bits first."""
    return value & 0x7F, value >> 7 & 0x7F


def describe_errors(bits: int) -> list[str]:
    """Return the errors set in the bits of GET_ERRORS, in words."""
    return [words for n, words in enumerate(ERRORS) if bits >> n & 1]
