"""Feetech servos mounted in a face, and whether those that answer are the ones of its YAML."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.errors import ServoError
from firmware_bridge.feetech.control_table import (
    EEPROM_SIZE,
    MULTI_TURN,
    RETURN_DELAY_UNIT_S,
    SPEED_IN_STEPS,
    STATE,
    Dialect,
    ServoModel,
    model_name,
)
from firmware_bridge.feetech.line import Line
from firmware_bridge.joints import named
from firmware_bridge.serial_servos.mounting import SETUP, checked_identities
from firmware_bridge.serial_servos.mounting import MountedServo as Mounted

#: Seconds added to the wait at each attempt. A servo that is there answers one of five requests
#: even on a bad line; the waits grow, since a busy computer may be late with every answer. Nothing
#: moves yet, so there is time.
_EXTRA_WAITS_S: Final = (0.0, 0.0, 0.01, 0.03, 0.1)
#: The coarse unit of goal_speed in steps a second; the fine unit is one step a second.
_COARSE_STEPS_S: Final = 50


#: One Feetech servo and the joint it drives.
MountedServo = Mounted[ServoModel]


def mounted_servos(wiring: Wiring) -> list[MountedServo]:
    """Return every servo of a face with its joint, in the order of its joints.

    Raises ServoError where the servos have two dialects, which cannot share a bus.
    """
    servos = [
        MountedServo(joint, each.facts, each.sign, each.zero_offset_deg)
        for joint, each in zip(wiring.joints, wiring.servos, strict=True)
    ]
    by_dialect = {servo.model.dialect.name: servo for servo in servos}
    if len(by_dialect) > 1:
        one, other = by_dialect.values()
        raise ServoError(
            f"{named(one.joint)} is an {one.model.name}, {named(other.joint)} an "
            f"{other.model.name}: their protocols differ, so each needs a bus of its own"
        )
    return servos


@dataclass(frozen=True, slots=True)
class ServoIdentity:
    """Model, settings and position read from one servo. eeprom: register values by name.

    model: the two bytes of the model number. place: the value of the position register. doubled:
    answers were damaged, as from two servos with one id.
    """

    model: bytes
    eeprom: dict[str, int]
    place: int
    doubled: bool = False

    @property
    def return_delay_s(self) -> float:
        """Seconds that the servo waits before it answers."""
        return self.eeprom["return_delay_time"] * RETURN_DELAY_UNIT_S

    def speed_register(self, deg_s: float, dialect: Dialect) -> int:
        """Return the goal_speed value for the speed `deg_s`, in the servo's own unit; never 0.

        0 is "stop" or "as fast as it can", by another bit of `phase`.
        """
        steps_s = deg_s * dialect.positions_per_deg
        return max(1, min(0x7FFF, round(steps_s * self.speed_unit)))

    @property
    def speed_unit(self) -> float:
        """What register goal_speed counts for one step of the position register a second."""
        # SCS servos count single steps.
        fine = "homing_offset" not in self.eeprom or self.eeprom["phase"] & SPEED_IN_STEPS
        return 1.0 if fine else 1.0 / _COARSE_STEPS_S


def identify(
    line: Line, servo: MountedServo, tries: int = len(_EXTRA_WAITS_S)
) -> ServoIdentity | None:
    """Read one servo's settings and position; None if it does not answer within `tries` attempts.

    If four of the usual five attempts get damaged answers, as from two servos with one id, the
    identity returned has only `doubled`=True. Raises PortError.
    """
    servo_id, dialect = servo.joint.servo_id, servo.model.dialect
    n_spoilt = 0
    for extra_wait_s in _EXTRA_WAITS_S[:tries]:
        eeprom = line.read(servo_id, 0, EEPROM_SIZE, extra_wait_s)
        state = eeprom and line.read(servo_id, STATE, dialect.state_size, extra_wait_s)
        if eeprom and state:
            place = dialect.decode("present_position", state.data, STATE)
            return ServoIdentity(eeprom.data[3:5], dialect.decode_all(eeprom.data), place)
        n_spoilt += line.heard_noise
    if n_spoilt >= len(_EXTRA_WAITS_S) - 1:
        return ServoIdentity(b"", {}, 0, doubled=True)
    return None


def mismatches(servo: MountedServo, found: ServoIdentity) -> list[str]:
    """Return how a servo, as `found` now, differs from what the face's YAML needs, a text each.

    Damaged answers or another model make the only text. []: the servo can be driven.
    """
    model = servo.model
    if found.doubled:
        one_alone = f"connect one of them alone and run `lipservo setup-servos {servo.joint.name}`"
        return [f"has answers that are spoilt: two servos may have this id; {one_alone}"]
    if found.model != model.dialect.encode("model_number", model.model_number):
        it_is = model_name(found.model)
        return [f"is not the {model.name} of the YAML but an {it_is}; correct the YAML"]
    eeprom, lines = found.eeprom, []
    if eeprom.get("operating_mode"):
        lines.append(f"is in operating mode {eeprom['operating_mode']}, not 0; {SETUP}")
    if "homing_offset" in eeprom and eeprom["phase"] & MULTI_TURN:
        lines.append(f"counts many turns (phase {eeprom['phase']}); {SETUP}")
    low, high = servo.pulse_range()
    least, most = eeprom["min_position_limit"], eeprom["max_position_limit"]
    if not least <= low <= high <= most:
        lines.append(f"has limits {least}..{most}, the joint needs {low}..{high}; {SETUP}")
    return lines


def identify_all(
    line: Line, servos: Sequence[MountedServo], *, strict: bool
) -> list[ServoIdentity | None]:
    """Return settings and position of every servo, in the order given; None for a silent servo.

    Raises ServoError for a servo that differs from the face's YAML; for a silent servo if `strict`,
    otherwise if it is critical or all are silent.
    """
    found = [identify(line, servo) for servo in servos]
    return checked_identities("feetech", line.transport, servos, found, mismatches, strict=strict)
