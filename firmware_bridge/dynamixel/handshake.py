"""What is asked of every servo before the first goal: who it is, and whether it is set up."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from firmware_bridge.bus import ServoError
from firmware_bridge.dynamixel.control_table import model_by_number, register
from firmware_bridge.dynamixel.line import Line
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.transport import Transport

#: The EEPROM from id to shutdown in one read.
_FIRST, _LAST = register("id").address, register("shutdown").end
#: A servo that is there answers one of five questions even on a bad line and a busy computer.
_TRIES = 5
_SETUP = "run `lipservo setup-servos`"
_DOCTOR = "`lipservo doctor` shows every difference between the servos and the YAML"


@dataclass(frozen=True, slots=True)
class Introduction:
    """What one servo said of itself. eeprom: register values by name."""

    model_number: int
    firmware: int
    eeprom: dict[str, int]

    @property
    def return_delay_s(self) -> float:
        """How long it waits before it answers."""
        return self.eeprom["return_delay_time"] * 2e-6


def introduce(line: Line, servo: MountedServo) -> Introduction | None:
    """Ping and read one servo's settings; None when it does not answer."""
    servo_id = servo.joint.servo_id
    for _ in range(_TRIES):
        pong = line.ping(servo_id)
        if pong is None or len(pong.data) != 3:
            continue
        answer = line.read(servo_id, _FIRST, _LAST - _FIRST)
        if answer is None or len(answer.data) != _LAST - _FIRST:
            continue
        eeprom = {
            name: entry.decode(answer.data[entry.address - _FIRST : entry.end - _FIRST])
            for name, entry in servo.model.registers.items()
            if entry.address >= _FIRST and entry.end <= _LAST
        }
        return Introduction(int.from_bytes(pong.data[:2], "little"), pong.data[2], eeprom)
    return None


def complaints(servo: MountedServo, said: Introduction | None) -> list[str]:
    """Why this servo cannot be driven as the face's YAML says; one line each, empty = it can."""
    name = f"servo {servo.joint.name!r} (id {servo.joint.servo_id})"
    if said is None:
        return [f"{name} does not answer; check its power and cable, then run `lipservo doctor`"]
    if said.model_number != servo.model.model_number:
        known = model_by_number(said.model_number)
        it_is = f"an {known.name}" if known else f"unknown model {said.model_number}"
        return [f"{name} is not the {servo.model.name} of the YAML but {it_is}; correct the YAML"]
    low, high = servo.pulse_range()
    found = said.eeprom
    lines = []
    if found["operating_mode"] not in (3, 5):
        lines.append(f"{name} is in operating mode {found['operating_mode']}, not 3; {_SETUP}")
    if found["drive_mode"] & ~0x04:
        lines.append(f"{name} has drive mode {found['drive_mode']}, needs 0; {_SETUP}")
    if found["homing_offset"]:
        lines.append(f"{name} has homing offset {found['homing_offset']} pulses, needs 0; {_SETUP}")
    if found["startup_configuration"] & 0x01:
        lines.append(f"{name} switches torque on by itself at power-up; {_SETUP}")
    if not found["min_position_limit"] <= low <= high <= found["max_position_limit"]:
        lines.append(
            f"{name} has limits {found['min_position_limit']}..{found['max_position_limit']} "
            f"pulses, the joint needs {low}..{high}; {_SETUP}"
        )
    return lines


def introduce_all(
    line: Line, servos: Sequence[MountedServo], *, strict: bool
) -> list[Introduction | None]:
    """Ask everybody. Raises ServoError with every complaint in one text.

    Not strict: servos that do not answer are left for later, unless all or a critical one.
    """
    said = [introduce(line, servo) for servo in servos]
    silent = [servo for servo, answer in zip(servos, said, strict=True) if answer is None]
    bearable = not strict and len(silent) < len(servos)
    bearable = bearable and not any(servo.joint.critical for servo in silent)
    lines = [
        complaint
        for servo, answer in zip(servos, said, strict=True)
        if answer is not None or not bearable
        for complaint in complaints(servo, answer)
    ]
    if lines:
        raise ServoError("\n".join([*lines, _DOCTOR]))
    return said


def read_introductions(
    open_transport: Callable[[], Transport], servos: Sequence[MountedServo]
) -> list[Introduction | None]:
    """Model and EEPROM of every servo, in the order given, before anybody drives them.

    Opens the port for this alone; None: a servo that does not answer, unless it is critical or
    nobody answers. Raises PortError, and ServoError when a servo differs from the face's YAML.
    """
    transport = open_transport()
    try:
        return introduce_all(Line(transport), servos, strict=False)
    finally:
        transport.close()
