"""Feetech servos in their places in the face, and whether those that answer are the right ones."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.bus_kinds import Wiring, other_kind_at
from firmware_bridge.errors import ServoError
from firmware_bridge.feetech.control_table import (
    EEPROM_SIZE,
    MANY_TURNS,
    RETURN_DELAY_UNIT_S,
    SPEED_IN_STEPS,
    STATE,
    Dialect,
    ServoModel,
    model_name,
)
from firmware_bridge.feetech.line import Line
from firmware_bridge.joints import Joint, named

#: A servo that is there answers one of five questions even on a bad line; waited for longer each
#: time, for a busy computer may be late with all of them. Nothing moves yet, so there is time.
_EXTRA_WAITS_S: Final = (0.0, 0.0, 0.01, 0.03, 0.1)
#: Of both units of speed; the other is one step a second.
_COARSE_STEPS_S: Final = 50
_SETUP: Final = "run `lipservo setup-servos`"


@dataclass(frozen=True, slots=True)
class MountedServo:
    """One servo and the joint it drives. servo angle = sign x (joint angle + zero_offset_deg)."""

    joint: Joint
    model: ServoModel
    sign: int = 1
    zero_offset_deg: float = 0.0

    def pulse(self, joint_deg: float) -> int:
        """The position register's value for a joint angle."""
        dialect = self.model.dialect
        servo_deg = self.sign * (joint_deg + self.zero_offset_deg)
        return round(dialect.center + servo_deg * dialect.positions_per_deg)

    def pulse_range(self) -> tuple[int, int]:
        """The joint's soft limits in pulses, the smaller first."""
        ends = self.pulse(self.joint.min_deg), self.pulse(self.joint.max_deg)
        return min(ends), max(ends)


def mounted_servos(wiring: Wiring) -> list[MountedServo]:
    """Every servo of a face in its place. Raises ServoError where they speak two dialects."""
    servos = [
        MountedServo(joint, each.facts, each.sign, each.zero_offset_deg)
        for joint, each in zip(wiring.joints, wiring.servos, strict=True)
    ]
    by_dialect = {servo.model.dialect.name: servo for servo in servos}
    if len(by_dialect) > 1:
        one, other = by_dialect.values()
        raise ServoError(
            f"{named(one.joint)} is an {one.model.name}, {named(other.joint)} an "
            f"{other.model.name}: they speak two dialects and cannot share one bus"
        )
    return servos


class Mounting:
    """All servos of a face at once. Arrays are (n_servos,)."""

    def __init__(self, servos: Sequence[MountedServo]) -> None:
        dialects = [servo.model.dialect for servo in servos]
        self._scale = np.array(
            [s.sign * d.positions_per_deg for s, d in zip(servos, dialects, strict=True)]
        )
        offset = np.array([servo.zero_offset_deg for servo in servos])
        self._zero = np.array([float(d.center) for d in dialects]) + offset * self._scale

    def pulses(self, joint_deg: Array) -> Array:
        """Whole pulses, as floats: what is not finite stays so."""
        pulses: Array = np.rint(self._zero + joint_deg * self._scale)
        return pulses

    def joint_deg(self, pulses: Array) -> Array:
        """Joint degrees; NaN stays NaN."""
        joint_deg: Array = (pulses - self._zero) / self._scale
        return joint_deg

    def one_deg(self, index: int, pulse: float) -> float:
        """Joint degrees of one servo's position register."""
        return float((pulse - self._zero[index]) / self._scale[index])


@dataclass(frozen=True, slots=True)
class ServoIdentity:
    """What one servo reported of itself. model: two bytes; eeprom: register values by name.

    place: its position register. doubled: answers came spoilt, as of two servos with one id.
    """

    model: bytes
    eeprom: dict[str, int]
    place: int
    doubled: bool = False

    @property
    def return_delay_s(self) -> float:
        """How long it waits before it answers."""
        return self.eeprom["return_delay_time"] * RETURN_DELAY_UNIT_S

    def speed_register(self, deg_s: float, dialect: Dialect) -> int:
        """goal_speed for a speed, in the unit that this servo is set to; never 0.

        0 is "stop" or "as fast as it can", by another bit of `phase`.
        """
        steps_s = deg_s * dialect.positions_per_deg
        # SCS servos count single steps.
        fine = "homing_offset" not in self.eeprom or self.eeprom["phase"] & SPEED_IN_STEPS
        return max(1, min(0x7FFF, round(steps_s if fine else steps_s / _COARSE_STEPS_S)))


def identify(
    line: Line, servo: MountedServo, tries: int = len(_EXTRA_WAITS_S)
) -> ServoIdentity | None:
    """Read one servo's settings and place; None when it does not answer so many times."""
    servo_id, dialect = servo.joint.servo_id, servo.model.dialect
    n_spoilt = 0
    for extra_wait_s in _EXTRA_WAITS_S[:tries]:
        eeprom = line.read(servo_id, 0, EEPROM_SIZE, extra_wait_s)
        state = eeprom and line.read(servo_id, STATE, dialect.state_size, extra_wait_s)
        if eeprom and state:
            place = dialect.decode("present_position", state.data, STATE)
            return ServoIdentity(eeprom.data[3:5], dialect.decode_all(eeprom.data), place)
        n_spoilt += line.spoilt
    if n_spoilt >= len(_EXTRA_WAITS_S) - 1:
        return ServoIdentity(b"", {}, 0, doubled=True)
    return None


def mismatches(servo: MountedServo, found: ServoIdentity) -> list[str]:
    """Where this servo is not as the face's YAML says; one line each, empty = it can be driven."""
    model = servo.model
    if found.doubled:
        one_alone = f"connect one of them alone and run `lipservo setup-servos {servo.joint.name}`"
        return [f"has answers that are spoilt: two servos may have this id; {one_alone}"]
    if found.model != model.dialect.encode("model_number", model.model_number):
        it_is = model_name(found.model)
        return [f"is not the {model.name} of the YAML but an {it_is}; correct the YAML"]
    eeprom, lines = found.eeprom, []
    if eeprom.get("operating_mode"):
        lines.append(f"is in operating mode {eeprom['operating_mode']}, not 0; {_SETUP}")
    if "homing_offset" in eeprom and eeprom["phase"] & MANY_TURNS:
        lines.append(f"counts many turns (phase {eeprom['phase']}); {_SETUP}")
    low, high = servo.pulse_range()
    least, most = eeprom["min_position_limit"], eeprom["max_position_limit"]
    if not least <= low <= high <= most:
        lines.append(f"has limits {least}..{most}, the joint needs {low}..{high}; {_SETUP}")
    return lines


def identify_all(
    line: Line, servos: Sequence[MountedServo], *, strict: bool
) -> list[ServoIdentity | None]:
    """Ask everybody. Raises ServoError with every mismatch in one text.

    Not strict: servos that do not answer are left for later, unless all or a critical one.
    """
    found = [identify(line, servo) for servo in servos]
    silent = [servo for servo, each in zip(servos, found, strict=True) if each is None]
    if len(silent) == len(servos):
        other = other_kind_at(line.transport, "feetech")
        if other:
            raise ServoError(other)
    bearable = not strict and len(silent) < len(servos)
    bearable = bearable and not any(servo.joint.critical for servo in silent)
    lines = []
    for servo, each in zip(servos, found, strict=True):
        if each is None:
            wrong = [] if bearable else ["does not answer; check its power, cable and baud rate"]
        else:
            wrong = mismatches(servo, each)
        lines += [f"{named(servo.joint)} {why}" for why in wrong]
    if lines:
        raise ServoError("\n".join(lines))
    return found
