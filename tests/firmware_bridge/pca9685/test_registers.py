"""Counts, prescaler and bytes of a PCA9685, by the examples of its data sheet."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.pca9685.registers import (
    CYCLE,
    PulseMessages,
    Timing,
    channel_register,
    counts_of,
)


def test_the_prescaler_of_the_data_sheet():
    """7.3.5: 200 Hz with the clock of 25 MHz are 1Eh."""
    assert Timing.at(25e6, 200.0).prescale == 0x1E
    assert Timing.at(25e6, 50.0).prescale == 121


@pytest.mark.parametrize(
    ("frequency_hz", "count_us", "step_deg"), [(50.0, 4.88, 0.44), (330.0, 0.72, 0.065)]
)
def test_the_step_in_which_a_servo_moves(frequency_hz, count_us, step_deg):
    timing = Timing.at(25e6, frequency_hz)

    assert timing.count_us == pytest.approx(count_us, abs=0.01)
    assert timing.resolution_deg(-11.1) == pytest.approx(step_deg, abs=0.005)
    assert timing.frequency_hz == pytest.approx(frequency_hz, rel=0.03)


def test_a_measured_clock_makes_the_pulse_right():
    slow = Timing.at(23.5e6, 50.0)

    assert slow.counts(np.array([1500.0]))[0] * slow.count_us == pytest.approx(1500.0, abs=3.0)
    assert slow.counts(np.array([1500.0]))[0] != Timing(25e6, slow.prescale).counts(
        np.array([1500.0])
    )


@pytest.mark.parametrize("frequency_hz", [20.0, 2000.0])
def test_what_the_prescaler_has_not_is_refused_with_what_it_has(frequency_hz):
    with pytest.raises(ValueError, match="makes 24 to 1526 Hz"):
        Timing.at(25e6, frequency_hz)


def test_neighbours_are_one_message_and_each_begins_a_sixteenth_later():
    messages = PulseMessages([4, 0, 1]).of(np.array([307, 205, 0]))

    assert [message.hex(" ") for message in messages] == [
        "06 00 00 cd 00 00 01 00 10",  # channels 0 and 1, which is full off
        "16 00 04 33 05",  # channel 4: on at 1024, off at 1331
    ]


def test_a_pulse_may_go_on_into_the_next_cycle():
    (message,) = PulseMessages([15]).of(np.array([400]))

    assert message.hex(" ") == "42 00 0f 90 00"
    assert counts_of(message[1:]) == 400


def test_there_are_sixteen_channels():
    assert (channel_register(0), channel_register(15)) == (0x06, 0x42)
    with pytest.raises(ValueError, match=r"channel 16 is outside 0\.\.15"):
        channel_register(16)


@given(st.permutations(range(16)), st.lists(st.integers(0, CYCLE - 1), min_size=16, max_size=16))
def test_what_is_written_is_what_is_read(channels, counts):
    registers = bytearray(256)
    for message in PulseMessages(channels).of(np.array(counts)):
        registers[message[0] : message[0] + len(message) - 1] = message[1:]

    found = [counts_of(registers[channel_register(c) : channel_register(c) + 4]) for c in channels]
    assert found == counts
