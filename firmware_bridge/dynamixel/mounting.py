"""Dynamixels mounted in a face, and whether those that answer are the ones of its YAML."""

from collections.abc import Sequence
from dataclasses import dataclass

from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.dynamixel.control_table import (
    RETURN_DELAY_UNIT_S,
    ServoModel,
    model_by_number,
    register,
)
from firmware_bridge.dynamixel.wire.codec import Status
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.serial_servos.mounting import SETUP, checked_identities
from firmware_bridge.serial_servos.mounting import MountedServo as Mounted
from firmware_bridge.transport import Transport

#: One Dynamixel and its joint; with max_current_ma in operating mode 5, else in 3.
MountedServo = Mounted[ServoModel]


def mounted_servos(wiring: Wiring) -> list[MountedServo]:
    """Return every servo of a face with its joint, sign and offset, in the order of the joints."""
    return [
        MountedServo(joint, each.facts, each.sign, each.zero_offset_deg, each.max_current_ma)
        for joint, each in zip(wiring.joints, wiring.servos, strict=True)
    ]


#: The EEPROM from id to shutdown in one read.
_FIRST, _LAST = register("id").address, register("shutdown").end
#: Seconds added to the wait at each attempt. A servo that is there answers two of twelve requests
#: even where a fifth of all packets is lost either way (one in ten thousand does not). The last
#: waits are longer, since a busy computer may be late with every answer. Nothing moves yet, so
#: there is time.
_EXTRA_WAITS_S = (*[0.0] * 9, 0.01, 0.03, 0.1)
_TRIES = len(_EXTRA_WAITS_S)


@dataclass(frozen=True, slots=True)
class ServoIdentity:
    """Model, firmware and settings read from one servo. eeprom: register values by name."""

    model_number: int
    firmware: int
    eeprom: dict[str, int]

    @property
    def return_delay_s(self) -> float:
        """Seconds that the servo waits before it answers."""
        return self.eeprom["return_delay_time"] * RETURN_DELAY_UNIT_S


def identify(line: Line, servo: MountedServo, tries: int = _TRIES) -> ServoIdentity | None:
    """Ping one servo and read its EEPROM; None if it does not answer both in `tries` attempts.

    An answered ping is not repeated. Raises PortError.
    """
    servo_id = servo.joint.servo_id
    pong: Status | None = None
    for extra_wait_s in _EXTRA_WAITS_S[:tries]:
        pong = pong or line.ping(servo_id, extra_wait_s)
        if pong is None or len(pong.data) != 3:
            pong = None
            continue
        answer = line.read(servo_id, _FIRST, _LAST - _FIRST, extra_wait_s)
        if answer is None or len(answer.data) != _LAST - _FIRST:
            continue
        eeprom = {
            name: entry.decode(answer.data[entry.address - _FIRST : entry.end - _FIRST])
            for name, entry in servo.model.registers.items()
            if entry.address >= _FIRST and entry.end <= _LAST
        }
        return ServoIdentity(int.from_bytes(pong.data[:2], "little"), pong.data[2], eeprom)
    return None


def mismatches(servo: MountedServo, identity: ServoIdentity) -> list[str]:
    """Return how a servo, by its `identity` read now, differs from what the face's YAML needs.

    One text for each difference, with the remedy; another model makes the only one. []: the servo
    can be driven.
    """
    if identity.model_number != servo.model.model_number:
        known = model_by_number(identity.model_number)
        it_is = f"an {known.name}" if known else f"unknown model {identity.model_number}"
        return [f"is not the {servo.model.name} of the YAML but {it_is}; correct the YAML"]
    low, high = servo.pulse_range()
    found = identity.eeprom
    lines = []
    cap, mode = servo.current_cap, found["operating_mode"]
    # Mode 5 without a limit would count turns, and pull as hard as goal_current happens to say.
    wanted = 3 if cap is None else 5
    if mode != wanted:
        lines.append(f"is in operating mode {mode}, not {wanted}; {SETUP}")
    if cap is not None and found["current_limit"] != cap:
        lines.append(
            f"has current limit {found['current_limit']}, the YAML's max_current_ma "
            f"makes {cap}; {SETUP}"
        )
    if found["drive_mode"]:
        lines.append(f"has drive mode {found['drive_mode']}, needs 0; {SETUP}")
    if found["homing_offset"]:
        lines.append(f"has homing offset {found['homing_offset']} pulses, needs 0; {SETUP}")
    if found["startup_configuration"] & 0x01:
        lines.append(f"switches torque on by itself at power-up; {SETUP}")
    if not found["min_position_limit"] <= low <= high <= found["max_position_limit"]:
        lines.append(
            f"has limits {found['min_position_limit']}..{found['max_position_limit']} "
            f"pulses, the joint needs {low}..{high}; {SETUP}"
        )
    return lines


def identify_all(
    line: Line, servos: Sequence[MountedServo], *, strict: bool
) -> list[ServoIdentity | None]:
    """Return model and EEPROM of every servo, in the order given; None for a servo that is silent.

    Raises ServoError for a servo that differs from the face's YAML; for a silent servo if `strict`,
    otherwise if it is critical or all are silent.
    """
    found = [identify(line, servo) for servo in servos]
    own = line.transport if isinstance(line.transport, Transport) else None
    return checked_identities("dynamixel", own, servos, found, mismatches, strict=strict)
