"""Two servos with one id: what can be told of them by listening only.

Both drive the same wire. Where they answer at different times, two answers come. Where they answer
in step, equal bytes come through as if one had spoken, so that pings look healthy; bytes that
differ spoil each other. Two motors never agree for long in clock, place, voltage and warmth.
Cannot be told: two servos of which one always drowns out the other.
"""

from typing import Final

from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.wire.line import Line

#: realtime_tick .. present_temperature: what differs between two motors.
_PRESENT: Final = register("realtime_tick").address
_PRESENT_SIZE: Final = register("present_temperature").end - _PRESENT
#: So many questions of each kind; so many of one kind whole and of the other spoilt.
_ASKED, _WHOLE, _SPOILT = 6, 5, 4


def shares_id(line: Line, servo_id: int) -> bool:
    """Whether several servos seem to answer to `servo_id`; False for one that is silent."""
    pongs = line.ping_each(servo_id)
    if len(pongs) > 1:
        return True
    n_whole = n_spoilt = 0
    for _ in range(_ASKED):
        n_whole += line.ping(servo_id) is not None
        n_bad = line.n_bad
        answer = line.read(servo_id, _PRESENT, _PRESENT_SIZE)
        n_spoilt += answer is None and (line.n_bad > n_bad or line.heard_noise)
    return n_whole >= _WHOLE and n_spoilt >= _SPOILT
