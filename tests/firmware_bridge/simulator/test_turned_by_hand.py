"""A hand at a simulated chain: fingers turn what is limp, and nothing else."""

import pytest

from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.simulator.chain import SimulatedChain
from firmware_bridge.simulator.motors import PULSES_PER_DEG


def test_a_hand_turns_a_limp_servo_and_not_one_that_is_held():
    chain = SimulatedChain([servo_models()["XL330-M288"]] * 2, [1, 2])
    chain.motors.torque_on[1] = True
    before = chain.motors.position.copy()

    for index in (0, 1, 7):
        chain.turn(index, 10.0)

    assert chain.motors.position[0] - before[0] == pytest.approx(10.0 * PULSES_PER_DEG)
    assert chain.motors.position[1] == before[1]
