"""What `bench bus` times of hobby servos is work: a loop by hand sends what our bus sends."""

from contextlib import ExitStack

import pytest

pytest.importorskip("smbus2")

from lipservo_lab.bench.bus import pulse_tick_figures as bench

from firmware_bridge.pca9685.registers import Register


def test_by_hand_the_same_registers_are_written():
    adapters = []

    class Kept(bench.CannedI2c):
        def __init__(self):
            super().__init__()
            adapters.append(self)

    with ExitStack() as stack:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(bench, "CannedI2c", Kept)
            tick = stack.enter_context(bench._bus_tick(*bench._pca9685()))
            loop = bench._loop_by_hand(bench._pca9685_by_hand())
        tick(7)
        loop(7)
        ours, by_hand = (
            bytes(each.registers[Register.LED0_ON_L : Register.LED15_OFF_H + 1])
            for each in adapters
        )

    # A count apart at most: half a count is rounded the other way.
    for channel in range(bench.N_SERVOS):
        one, other = (
            int.from_bytes(each[4 * channel + 2 : 4 * channel + 4], "little")
            for each in (ours, by_hand)
        )
        assert abs(one - other) <= 1
        assert ours[4 * channel : 4 * channel + 2] == by_hand[4 * channel : 4 * channel + 2]
