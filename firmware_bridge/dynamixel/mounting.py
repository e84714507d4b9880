"""Servos in their places in the face: degrees to pulses, and whether the right one answers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.bus_kinds import Wiring, other_kind_at
from firmware_bridge.dynamixel.control_table import (
    CENTER_PULSE,
    PULSES_PER_DEG,
    RETURN_DELAY_UNIT_S,
    ServoModel,
    model_by_number,
    register,
)
from firmware_bridge.dynamixel.wire.codec import Status
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.errors import ServoError
from firmware_bridge.joints import Joint, named
from firmware_bridge.transport import Transport


@dataclass(frozen=True, slots=True)
class MountedServo:
    """One servo and the joint it drives. servo angle = sign x (joint angle + zero_offset_deg).

    max_current_ma: it never pulls harder (operating mode 5); None: as hard as it can (mode 3).
    Raises ValueError for a current limit on a model that does not measure current.
    """

    joint: Joint
    model: ServoModel
    sign: int = 1
    zero_offset_deg: float = 0.0
    max_current_ma: float | None = None

    def __post_init__(self) -> None:
        if self.max_current_ma is not None and not self.model.measures_current:
            raise ValueError(
                f"joint {self.joint.name!r}: an {self.model.name} does not measure current, "
                "so max_current_ma cannot be kept"
            )

    @property
    def current_cap(self) -> int | None:
        """The most that goal_current may be, in the register's unit; None: no cap."""
        unit_ma = self.model.current_unit_ma
        if self.max_current_ma is None or unit_ma is None:
            return None
        return max(1, int(self.max_current_ma / unit_ma))

    def pulse(self, joint_deg: float) -> int:
        """The position register's value for a joint angle."""
        return round(CENTER_PULSE + self.sign * (joint_deg + self.zero_offset_deg) * PULSES_PER_DEG)

    def pulse_range(self) -> tuple[int, int]:
        """The joint's soft limits in pulses, the smaller first."""
        ends = self.pulse(self.joint.min_deg), self.pulse(self.joint.max_deg)
        return min(ends), max(ends)


def mounted_servos(wiring: Wiring) -> list[MountedServo]:
    """Every servo of a face in its place, in the order of its joints."""
    return [
        MountedServo(joint, each.facts, each.sign, each.zero_offset_deg, each.max_current_ma)
        for joint, each in zip(wiring.joints, wiring.servos, strict=True)
    ]


class Mounting:
    """All servos of a face at once. Arrays are (n_servos,)."""

    def __init__(self, servos: Sequence[MountedServo]) -> None:
        self._scale = np.array([servo.sign * PULSES_PER_DEG for servo in servos])
        offset = np.array([servo.zero_offset_deg for servo in servos])
        self._zero = CENTER_PULSE + offset * self._scale

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


#: The EEPROM from id to shutdown in one read.
_FIRST, _LAST = register("id").address, register("shutdown").end
#: A servo that is there answers two of twelve questions even where a fifth of all packets is lost
#: either way (one in ten thousand does not); at last waited for longer, for a busy computer may be
#: late with every answer. Nothing moves yet, so there is time.
_EXTRA_WAITS_S = (*[0.0] * 9, 0.01, 0.03, 0.1)
_TRIES = len(_EXTRA_WAITS_S)
_SETUP = "run `lipservo setup-servos`"
_DOCTOR = "`lipservo doctor` shows every difference between the servos and the YAML"


@dataclass(frozen=True, slots=True)
class ServoIdentity:
    """What one servo said of itself. eeprom: register values by name."""

    model_number: int
    firmware: int
    eeprom: dict[str, int]

    @property
    def return_delay_s(self) -> float:
        """How long it waits before it answers."""
        return self.eeprom["return_delay_time"] * RETURN_DELAY_UNIT_S


def identify(line: Line, servo: MountedServo, tries: int = _TRIES) -> ServoIdentity | None:
    """Ping and read one servo's settings; None when it does not answer so many times."""
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


def mismatches(servo: MountedServo, said: ServoIdentity) -> list[str]:
    """Where this servo is not as the face's YAML says; one line each, empty = it can be driven."""
    if said.model_number != servo.model.model_number:
        known = model_by_number(said.model_number)
        it_is = f"an {known.name}" if known else f"unknown model {said.model_number}"
        return [f"is not the {servo.model.name} of the YAML but {it_is}; correct the YAML"]
    low, high = servo.pulse_range()
    found = said.eeprom
    lines = []
    cap, mode = servo.current_cap, found["operating_mode"]
    # Mode 5 without a limit would count turns, and pull as hard as goal_current happens to say.
    wanted = 3 if cap is None else 5
    if mode != wanted:
        lines.append(f"is in operating mode {mode}, not {wanted}; {_SETUP}")
    if cap is not None and found["current_limit"] != cap:
        lines.append(
            f"has current limit {found['current_limit']}, the YAML's max_current_ma "
            f"makes {cap}; {_SETUP}"
        )
    if found["drive_mode"]:
        lines.append(f"has drive mode {found['drive_mode']}, needs 0; {_SETUP}")
    if found["homing_offset"]:
        lines.append(f"has homing offset {found['homing_offset']} pulses, needs 0; {_SETUP}")
    if found["startup_configuration"] & 0x01:
        lines.append(f"switches torque on by itself at power-up; {_SETUP}")
    if not found["min_position_limit"] <= low <= high <= found["max_position_limit"]:
        lines.append(
            f"has limits {found['min_position_limit']}..{found['max_position_limit']} "
            f"pulses, the joint needs {low}..{high}; {_SETUP}"
        )
    return lines


def identify_all(
    line: Line, servos: Sequence[MountedServo], *, strict: bool
) -> list[ServoIdentity | None]:
    """Ask everybody. Raises ServoError with every mismatch in one text.

    Not strict: servos that do not answer are left for later, unless all or a critical one.
    """
    said = [identify(line, servo) for servo in servos]
    silent = [servo for servo, answer in zip(servos, said, strict=True) if answer is None]
    if len(silent) == len(servos) and isinstance(line.transport, Transport):
        other = other_kind_at(line.transport, "dynamixel")
        if other:
            raise ServoError(other)
    bearable = not strict and len(silent) < len(servos)
    bearable = bearable and not any(servo.joint.critical for servo in silent)
    lines = []
    for servo, answer in zip(servos, said, strict=True):
        if answer is None:
            wrong = [] if bearable else ["does not answer; check its power and cable"]
        else:
            wrong = mismatches(servo, answer)
        lines += [f"{named(servo.joint)} {each}" for each in wrong]
    if lines:
        raise ServoError("\n".join([*lines, _DOCTOR]))
    return said


def read_identities(
    open_transport: Callable[[], Transport], servos: Sequence[MountedServo]
) -> list[ServoIdentity | None]:
    """Model and EEPROM of every servo, in the order given, before anybody drives them.

    Opens the port for this alone; None: a servo that does not answer, unless it is critical or
    nobody answers. Raises PortError, and ServoError when a servo differs from the face's YAML.
    """
    transport = open_transport()
    try:
        return identify_all(Line(transport), servos, strict=False)
    finally:
        transport.close()
