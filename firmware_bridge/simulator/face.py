"""A simulated chain set up for a face, as `setup-servos` would leave real servos."""

from collections.abc import Sequence
from typing import Any

from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.provisioning import wanted_settings
from firmware_bridge.simulator.chain import SimulatedChain


def chain_for(servos: Sequence[MountedServo], baud_rate: int, **options: Any) -> SimulatedChain:
    """Every servo with its id, rate and limits, standing limp in neutral.

    options: those of `SimulatedChain`.
    """
    chain = SimulatedChain(
        [servo.model for servo in servos],
        [servo.joint.servo_id for servo in servos],
        baud_rate=baud_rate,
        **options,
    )
    for servo, simulated in zip(servos, chain.servos, strict=True):
        for name, value in wanted_settings(servo, baud_rate).items():
            simulated[name] = value
        simulated.power_up(0.0)
        simulated.stand_at(servo.pulse(0.0))
    return chain
