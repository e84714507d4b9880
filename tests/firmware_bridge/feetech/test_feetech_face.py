"""A whole face on Feetech servos through what may go wrong: it goes on, and nothing jumps."""

from dataclasses import replace

import numpy as np
import pytest
from feetech_chain import four_servos, wired

from firmware_bridge.clock import ticks
from firmware_bridge.errors import PortError
from firmware_bridge.feetech.simulator import ChainFault
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.simulator.motors import PULSES_PER_DEG

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


#: The bound of a soft start, degrees a second, and how far the shaft sinks or is pushed meanwhile.
SOFT_DEG_S, PUSHED_DEG = 60.0, 12.0


def fastest_after_restart(model, lasts_s, at_s, rate_hz, amplitude_deg):
    """The top speed of a shaft that was displaced in a restart, degrees a second.

    Until its second start is over, or for as long where nothing noticed the restart.
    """
    fault = ChainFault(kind="restart", at_s=at_s, lasts_s=lasts_s, servo=1)
    on = wired(four_servos(model), strict=False, faults=[fault], period_s=1.0 / rate_hz)
    motors, servo = on.chain.motors, on.chain.servos[1]
    power_up = servo.power_up

    def pushed():
        power_up()
        motors.position[1] += PUSHED_DEG * PULSES_PER_DEG

    servo.power_up = pushed
    seen = []
    motors.motion = lambda time_s, _: seen.append((time_s, abs(motors.velocity[1])))
    joints = [each.joint for each in on.servos]
    channel, started_s = MemoryTargetChannel(), []
    with on.bus:
        enable = on.bus.enable_torque
        on.bus.enable_torque = lambda n: started_s.append(on.clock.now()) or enable(n)
        bridge = Bridge(on.bus, joints, channel, BridgeSettings(rate_hz))
        bridge.start()
        for time_s, late in ticks(on.clock, rate_hz):
            if time_s > at_s + lasts_s + 1.4:
                break
            wanted = amplitude_deg * np.sin(2.0 * np.pi * 0.7 * time_s + np.arange(len(joints)))
            channel.publish(ServoTargets(time_s + 0.01, wanted))
            bridge.tick(time_s, late)
            on.chain.advance(on.clock.now())
    until_s = max([at_s, *started_s]) + 0.95
    return max(speed for time_s, speed in seen if at_s <= time_s < until_s) / PULSES_PER_DEG


@pytest.mark.parametrize("rate_hz", [30.0, 100.0])
@pytest.mark.parametrize("model", ["STS3215", "SCS0009"])
def test_a_servo_that_restarts_for_however_short_a_time_is_as_slow_as_in_a_start(model, rate_hz):
    for lasts_s in (0.01, 0.04, 0.09, 0.5):
        for phase in (0.1, 0.4, 0.7):
            at_s = 1.6 + phase / rate_hz
            fastest = fastest_after_restart(model, lasts_s, at_s, rate_hz, 1.5)
            assert fastest <= 1.1 * SOFT_DEG_S, (lasts_s, phase)


def test_a_restart_between_two_ticks_that_costs_no_answer_is_noticed_and_begins_a_soft_start():
    fault = ChainFault(kind="restart", at_s=4.0 + 0.4 / RATE_HZ, lasts_s=0.005, servo=1)
    _, rows, _ = played([fault], 5.0)
    told = {trouble for _, troubles in rows for trouble in troubles}

    assert any("has lost its torque" in trouble for trouble in told), told
    assert rows[-1][1] == ()


def test_a_slow_joint_that_missed_an_answer_follows_its_goals_again():
    fault = ChainFault(kind="silence", at_s=3.0, lasts_s=0.03, servo=1)
    slow = [
        replace(each, joint=replace(each.joint, max_speed_deg_s=25.0))
        for each in four_servos("SCS0009")
    ]
    on = wired(slow, strict=False, faults=[fault], period_s=0.01)
    joints, channel, troubles = [each.joint for each in slow], MemoryTargetChannel(), set()
    with on.bus:
        bridge = Bridge(on.bus, joints, channel, BridgeSettings(100.0))
        bridge.start()
        for time_s, late in ticks(on.clock, 100.0):
            if time_s > 4.0:
                break
            ramp_deg = np.clip(17.0 * (time_s - 2.9), 0.0, 5.0)
            channel.publish(ServoTargets(time_s + 0.01, np.full(len(joints), ramp_deg)))
            bridge.tick(time_s, late)
            troubles.update(bridge.troubles)
            on.chain.advance(on.clock.now())
        places_deg = on.bus.feedback().positions_deg

    assert not troubles
    assert places_deg[1] == pytest.approx(places_deg[2], abs=0.5)
