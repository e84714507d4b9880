"""Which servos of a face are to be changed how: all in their chain, or one alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_bridge.bus import ServoError
from firmware_bridge.dynamixel.control_table import model_by_number
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.provisioning import (
    SCANNED_RATES,
    Difference,
    differences,
    duplicates,
    read_settings,
    scan,
    wanted_settings,
)
from firmware_bridge.dynamixel.shared_id import shares_id
from firmware_bridge.dynamixel.wire.line import Line

#: A new servo answers here, whatever rate the chain has.
_FACTORY_RATE: Final = 57_600
#: Servos by id: the rate at which each answered, and its model number; more than one when two do.
Found = Mapping[int, Sequence[tuple[int, int]]]


@dataclass(frozen=True, slots=True)
class Plan:
    """What one servo, found at an id and a rate, lacks to be the joint's."""

    servo: MountedServo
    servo_id: int
    baud_rate: int
    changes: tuple[Difference, ...]


def find_servos(line: Line, ids: Sequence[int], baud_rate: int) -> Found:
    """Who answers at the face's rate and the factory's; at the others while one of `ids` lacks.

    The slowest, which takes four seconds, only while nobody answers.
    """
    found: dict[int, list[tuple[int, int]]] = {}
    rates = list(dict.fromkeys([baud_rate, _FACTORY_RATE, *SCANNED_RATES]))
    for rate, numbers in scan(line, rates):
        for servo_id, number in numbers.items():
            found.setdefault(servo_id, []).append((rate, number))
        complete = set(ids) <= set(found) and rates.index(rate) >= rates.index(_FACTORY_RATE)
        if complete or (found and rate == rates[-2]):
            break
    return found


def chain_is_complete(servos: Sequence[MountedServo], found: Found) -> bool:
    """Whether every servo answers at its own id, so that nobody needs to be unplugged."""
    return all(servo.joint.servo_id in found for servo in servos)


def plan_chain(
    line: Line, servos: Sequence[MountedServo], found: Found, baud_rate: int
) -> list[Plan]:
    """A plan for every servo in its place. Raises ServoError with a line for each that is not."""
    lines = []
    for servo in servos:
        servo_id, name = servo.joint.servo_id, servo.joint.name
        answers = found[servo_id]
        line.baud_rate = answers[0][0]
        if len(answers) > 1:
            rates = " and at ".join(f"{rate:,}" for rate, _ in answers)
            lines.append(f"{name}: id {servo_id} answers at {rates} baud: {_alone(name)}")
        elif shares_id(line, servo_id):
            lines.append(f"{name}: two servos answer to id {servo_id}: {_alone(name)}")
        else:
            lines.extend(_other_model(servo, answers[0][1]))
    if lines:
        raise ServoError("\n".join(lines))
    return [
        _plan(line, servo, servo.joint.servo_id, found[servo.joint.servo_id][0][0], baud_rate)
        for servo in servos
    ]


def plan_alone(line: Line, servo: MountedServo, found: Found, baud_rate: int) -> Plan:
    """A plan for the one servo there is, whatever its id. Raises ServoError unless it is one."""
    name = servo.joint.name
    if not found:
        raise ServoError("no servo answers at any rate; check its power and cable")
    answers = [(servo_id, *each) for servo_id, all_of_it in found.items() for each in all_of_it]
    if len(answers) > 1:
        missing = f"{name} (id {servo.joint.servo_id}) does not answer; "
        raise ServoError(
            f"{'' if servo.joint.servo_id in found else missing}{len(answers)} servos answer "
            f"(ids {sorted(each[0] for each in answers)}); connect one at a time: {_alone(name)}"
        )
    ((servo_id, rate, number),) = answers
    line.baud_rate = rate
    spoilt = duplicates(line, [servo.joint.servo_id]) if servo_id != servo.joint.servo_id else []
    if spoilt or shares_id(line, servo_id):
        each = spoilt[0] if spoilt else servo_id
        raise ServoError(f"two servos answer to id {each}: {_alone(name)}")
    other = _other_model(servo, number)
    if other:
        raise ServoError(other[0])
    return _plan(line, servo, servo_id, rate, baud_rate)


def _plan(line: Line, servo: MountedServo, servo_id: int, rate: int, baud_rate: int) -> Plan:
    line.baud_rate = rate
    wanted = wanted_settings(servo, baud_rate)
    lacking = differences(read_settings(line, servo_id, servo.model, wanted), wanted)
    return Plan(servo, servo_id, rate, tuple(lacking))


def _other_model(servo: MountedServo, number: int) -> list[str]:
    if number == servo.model.model_number:
        return []
    known = model_by_number(number)
    it_is = known.name if known else f"of unknown model {number}"
    return [
        f"the servo found for {servo.joint.name!r} is {it_is}, the YAML says {servo.model.name}; "
        "connect the right one, or correct the YAML"
    ]


def _alone(name: str) -> str:
    return f"connect the servo of {name!r} alone and run `lipservo setup-servos {name}`"
