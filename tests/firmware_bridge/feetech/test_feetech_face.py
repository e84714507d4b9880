"""A whole face on Feetech servos through what may go wrong: it goes on, and nothing jumps."""

import numpy as np
import pytest
from feetech_chain import wired

from firmware_bridge.clock import ticks
from firmware_bridge.errors import PortError
from firmware_bridge.feetech.simulator import ChainFault
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets

RATE_HZ = 50.0
#: A tick's step of the fastest joint of this face, and a step of its encoder.
STEP_DEG = 260.0 * 1.05 / RATE_HZ + 0.1


def played(faults, seconds, **options):
    """The face moves to and fro; what its bridge says at each tick, and where its servos stood."""
    on = wired(strict=False, faults=faults, **options)
    joints = [servo.joint for servo in on.servos]
    channel = MemoryTargetChannel()
    rows, places = [], []
    with on.bus:
        bridge = Bridge(on.bus, joints, channel, BridgeSettings(RATE_HZ))
        bridge.start()
        for time_s, late in ticks(on.clock, RATE_HZ):
            if time_s > seconds:
                break
            wanted = 1.5 * np.sin(2.0 * np.pi * 0.7 * time_s + np.arange(len(joints)))
            channel.publish(ServoTargets(time_s + 0.01, wanted))
            try:
                bridge.tick(time_s, late)
            except PortError:
                break
            rows.append((time_s, bridge.troubles))
            on.chain.advance(on.clock.now())
            places.append([servo.place * 360.0 / 4096 for servo in on.chain.servos])
    return on, rows, np.array(places)


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ({"kind": "brown-out"}, "has lost its torque"),
        ({"kind": "silence", "lasts_s": 1.0}, "does not answer"),
        ({"kind": "jam", "lasts_s": 3.5}, "overload"),
        ({"kind": "lost", "lasts_s": 0.2}, None),
        ({"kind": "spoilt", "lasts_s": 0.3}, None),
    ],
)
@pytest.mark.parametrize("stiff", [False, True])
def test_one_servo_in_trouble_is_named_and_comes_back_without_a_jump(fault, says, stiff):
    fault = ChainFault(at_s=4.0, servo=1, **fault)
    on, rows, places = played([fault], 12.0, wakes_up_stiff=stiff)
    told = {trouble for _, troubles in rows for trouble in troubles}

    assert (says is None) == (not told), told
    assert says is None or any(says in trouble for trouble in told), told
    assert rows[-1][1] == ()
    assert np.abs(np.diff(places, axis=0)).max() < STEP_DEG
    assert np.ptp(places[-100:], axis=0).min() > 1.0  # all of them move again
    assert not any(servo["torque_enable"] for servo in on.chain.servos)
    assert on.chain.n_spoken_over == 0
