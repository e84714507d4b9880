"""The simulated PCA9685 does what the data sheet says, whoever speaks to it."""

import errno

import pytest

from firmware_bridge.pca9685.i2c import READ
from firmware_bridge.pca9685.simulator import (
    HobbyServo,
    Pulse,
    SimulatedPca9685,
    read_faults,
)

ADDRESS = 0x40


def write(chip, time_s, *values, address=ADDRESS):
    return chip.transfer([(address, 0, bytes(values))], time_s)


def read(chip, time_s, register, n_bytes=1):
    number, found = chip.transfer(
        [(ADDRESS, 0, bytes([register])), (ADDRESS, READ, n_bytes)], time_s
    )
    assert number == 0
    return found


#: What adafruit-circuitpython-pca9685 3.4 writes for `frequency = 50`, `duty_cycle` of channel 3
#: at 1500 us and then 0, and `deinit`, with the reads that it does in between: its time, register
#: and bytes. Written down from its documented sequence.
ADAFRUIT = [
    (0.000, [0x00, 0x00]),
    (0.001, [0x00, 0x10]),
    (0.002, [0xFE, 121]),
    (0.003, [0x00, 0x00]),
    (0.008, [0x00, 0xA0]),
    (0.010, [0x12, 0x00, 0x00, 0x33, 0x01]),
    (1.010, [0x12, 0x00, 0x00, 0x00, 0x10]),
    (2.000, [0x00, 0x00]),
]


def test_a_foreign_library_makes_its_pulses():
    servo = HobbyServo(us_per_deg=10.0, neutral_us=1400.0)
    chip = SimulatedPca9685(servos={3: servo})
    for time_s, values in ADAFRUIT:
        assert write(chip, time_s, *values) == (0, b"")
    chip.advance(3.0)

    assert {pulse.channel for pulse in chip.log()} == {3}
    assert len(chip.log()) == pytest.approx(50, abs=1)
    assert {round(pulse.width_us, 1) for pulse in chip.log()} == {1498.2}
    gaps = {
        round(b.start_s - a.start_s, 5) for a, b in zip(chip.log(), chip.log()[1:], strict=False)
    }
    assert gaps == {0.01999}
    assert chip.places_deg(3.0)[3] == pytest.approx(9.8, abs=0.1)


def test_power_up_values():
    chip = SimulatedPca9685()

    assert read(chip, 0.0, 0x00, 1) == b"\x11"
    assert [read(chip, 0.0, register)[0] for register in range(1, 6)] == [
        0x04, 0xE2, 0xE4, 0xE8, 0xE0,
    ]  # fmt: skip
    assert read(chip, 0.0, 0x09) == b"\x10"
    assert read(chip, 0.0, 0xFE) == b"\x1e"
    assert read(chip, 0.0, 0x02, 3) == b"\xe2\xe2\xe2", "no auto-increment"


def test_the_prescaler_takes_a_value_asleep_only():
    chip = SimulatedPca9685()
    write(chip, 0.0, 0x00, 0x20)
    write(chip, 0.1, 0xFE, 121)
    assert read(chip, 0.1, 0xFE) == b"\x1e"
    write(chip, 0.2, 0x00, 0x30)
    write(chip, 0.2, 0xFE, 121)
    assert read(chip, 0.2, 0xFE) == bytes([121])


def test_sleep_cuts_a_pulse_and_restart_brings_it_back():
    chip = SimulatedPca9685()
    write(chip, 0.0, 0x00, 0x20)
    write(chip, 0.0, 0x06, 0x00, 0x00, 0x00, 0x08)
    chip.advance(0.1)
    start_s = chip.log()[-1].start_s + 4096 * chip.count_us * 1e-6
    write(chip, start_s + 1e-3, 0x00, 0x30)

    assert chip.log()[-1] == Pulse(0, pytest.approx(start_s), pytest.approx(1000.0), is_cut=True)
    assert read(chip, 0.2, 0x00) == b"\xb0", "restart can be asked for"
    write(chip, 0.3, 0x00, 0x20)
    n_before = len(chip.log())
    chip.advance(0.4)
    assert len(chip.log()) == n_before
    write(chip, 0.4, 0x00, 0xA0)
    chip.advance(0.5)
    assert len(chip.log()) > n_before + 10
    assert read(chip, 0.5, 0x00) == b"\x20"


def test_auto_increment_rolls_over_behind_the_last_channel_and_the_prescaler():
    chip = SimulatedPca9685()
    write(chip, 0.0, 0x00, 0x20)
    assert read(chip, 0.0, 0x45, 2) == b"\x10\x20"
    assert read(chip, 0.0, 0xFE, 2) == b"\x1e\x20"


def test_the_all_call_address_is_answered_until_it_is_switched_off():
    chip = SimulatedPca9685()
    assert write(chip, 0.0, 0x01, 0x04, address=0x70)[0] == 0
    write(chip, 0.0, 0x00, 0x20)
    assert write(chip, 0.0, 0x01, 0x00, address=0x70)[0] == errno.EREMOTEIO
    assert list(chip.to_others) == [(0x70, b"\x01\x00")]


def test_a_broken_supply_leaves_it_as_at_power_up():
    chip = SimulatedPca9685()
    write(chip, 0.0, 0x00, 0x20)
    write(chip, 0.0, 0x06, 0x00, 0x00, 0x00, 0x01)
    chip.advance(0.1)
    chip.brown_out()
    n_before = len(chip.log())
    chip.advance(1.0)

    assert read(chip, 1.0, 0x00) == b"\x11"
    assert len(chip.log()) == n_before


def test_faults_of_the_bus():
    chip = SimulatedPca9685()
    chip.nacks = 1
    assert write(chip, 0.0, 0x00, 0x20)[0] == errno.EREMOTEIO
    assert write(chip, 0.0, 0x00, 0x20)[0] == 0
    chip.cut_after = 3
    assert write(chip, 0.0, 0x06, 0x11, 0x02, 0x33, 0x04)[0] == errno.EREMOTEIO
    assert read(chip, 0.0, 0x06, 4) == b"\x11\x02\x00\x10", "the first bytes have arrived"


def test_faults_of_a_script():
    script = """faults:
    - {kind: stuck, at_s: 1.0, lasts_s: 0.2}
    - {kind: nack, at_s: 2.0, every_s: 1.0, lasts_s: 0.1}
    - {kind: brown-out, at_s: 5.5}
    - {kind: unplug, at_s: 7.0}
    """
    chip = SimulatedPca9685(faults=read_faults(script))
    write(chip, 0.0, 0x00, 0x20)

    assert write(chip, 1.1, 0x01, 0x04)[0] == errno.ETIMEDOUT
    assert [write(chip, time_s, 0x01, 0x04)[0] for time_s in (1.3, 2.05, 2.5, 5.05)] == [
        0, errno.EREMOTEIO, 0, errno.EREMOTEIO,
    ]  # fmt: skip
    assert read(chip, 5.4, 0x00) == b"\x20"
    assert read(chip, 5.6, 0x00) == b"\x11"
    chip.advance(7.2)
    assert not chip.plugged
    with pytest.raises(ValueError, match=r"faults\.0\.kind"):
        read_faults("faults: [{kind: fire, at_s: 1}]")


def test_a_servo_takes_no_order_from_a_pulse_that_was_cut():
    servo = HobbyServo(us_per_deg=10.0, neutral_us=1400.0)
    servo.pulse(Pulse(0, 0.0, 1500.0))
    servo.pulse(Pulse(0, 0.02, 150.0, is_cut=True))

    assert servo.advance(1.0) == pytest.approx(10.0)
