"""Servos that another program has set up: what keeps them from being moved here, and clearing it.

LeRobot homes a servo by its homing offset and drives it in mode 4; a face of ours uses neither.
"""

from collections.abc import Mapping

from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.provisioning import (
    UNHURRIED_S,
    Difference,
    differences,
    read_settings,
    set_up,
)
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.serial_transport import open_port
from lipsync.errors import UserError

#: What a servo must hold before it is moved for the first time.
_PLAIN = {"drive_mode": 0, "operating_mode": 3, "homing_offset": 0, "startup_configuration": 0}


def foreign_settings(port: str, rate: int, found: Mapping[int, str]) -> dict[int, list[Difference]]:
    """What differs, by id, of servos found with their models; those that are plain are left out.

    Raises PortError, and ServoError for a servo that falls silent.
    """
    transport = open_port(port, rate)
    try:
        line = Line(transport, extra_wait_s=UNHURRIED_S)
        held = {
            servo_id: read_settings(line, servo_id, servo_models()[name], _PLAIN)
            for servo_id, name in found.items()
        }
    finally:
        transport.close()
    differing = {servo_id: differences(each, _PLAIN) for servo_id, each in held.items()}
    return {servo_id: each for servo_id, each in differing.items() if each}


def clear_foreign_settings(
    port: str, rate: int, found: Mapping[int, str], foreign: Mapping[int, list[Difference]]
) -> None:
    """Write what `foreign_settings` found, torque off. Raises PortError, ServoError.

    Refuses a servo that turns the other way (UserError): what was recorded of it would be mirrored.
    """
    for servo_id, changes in foreign.items():
        if any(each.name == "drive_mode" and each.found & 1 for each in changes):
            raise UserError(
                f"id {servo_id} runs in reverse drive mode; set drive mode 0 with Dynamixel Wizard "
                "and record its range again"
            )
    transport = open_port(port, rate)
    try:
        line = Line(transport, extra_wait_s=UNHURRIED_S)
        for servo_id, changes in foreign.items():
            for _ in set_up(line, servo_id, servo_models()[found[servo_id]], changes):
                pass  # each is read back
    finally:
        transport.close()
