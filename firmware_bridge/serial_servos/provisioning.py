"""Find the servos of one chain, compare them with their settings, and set them up one by one.

`ChainSetup` is the sequence of these steps; its fields are the functions of a protocol.
"""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

from firmware_bridge.bus_kinds import Finding, Severity, Wiring, other_kind_at
from firmware_bridge.errors import RateError, ServoError
from firmware_bridge.joints import Joint
from firmware_bridge.serial_servos.mounting import MountedServo
from firmware_bridge.serial_servos.serial_transport import SameAdapter, open_port

#: How much longer than a control loop the commands that set up or examine servos wait for answers.
UNHURRIED_S: Final = 0.06
#: Registers that change how a servo is reached are written last, in this order.
_LAST: Final = {"id": 1, "baud_rate": 2}
_LOW, _HIGH = "min_position_limit", "max_position_limit"
#: Top speed of a servo that is moved to see which joint it drives.
_CAREFUL_DEG_S: Final = 60.0

#: By id: (baud rate, model number) of each answer; several where servos with one id answered at
#: different rates. The model number is in the form of the protocol.
Found = Mapping[int, Sequence[tuple[int, Any]]]
#: By id: the first baud rate at which a servo answered, and the name of its model.
Located = Mapping[int, tuple[int, str]]


@dataclass(frozen=True, slots=True)
class Difference:
    """A register that must be changed: its name, the value found, and the value wanted."""

    name: str
    found: int
    wanted: int

    def __str__(self) -> str:
        return f"{self.name} is {self.found}, should be {self.wanted}"


#: By id: the registers, set by another program, that must be reset before a servo is moved.
Foreign = Mapping[int, Sequence[Difference]]


@dataclass(frozen=True, slots=True)
class Plan:
    """The registers to change in one servo, found at an id and a baud rate, to fit its joint."""

    servo: MountedServo[Any]
    servo_id: int
    baud_rate: int
    changes: tuple[Difference, ...]


def differences(found: Mapping[str, int], wanted: Mapping[str, int]) -> list[Difference]:
    """Return the registers whose value `found` in a servo differs from `wanted`, in that order."""
    return [
        Difference(name, found[name], value)
        for name, value in wanted.items()
        if found[name] != value
    ]


def chain_is_complete(servos: Sequence[MountedServo[Any]], found: Found) -> bool:
    """Return whether every servo was found at its own id, so that none needs to be unplugged."""
    return all(servo.joint.servo_id in found for servo in servos)


@dataclass(frozen=True, slots=True)
class ChainSetup:
    """The steps to find and set up servos of one protocol, over a serial line of its own class.

    Only here is EEPROM written: with torque off, where it differs, and all is read back. A port is
    opened for servos that belong to no face yet: to find them, to take them over from another
    program, and to move one alone.

    Attributes
    ----------
    kind, models
        Name of the kind of bus; its servo models by name.
    make_line, make_bus
        Make a line at an open port, with `extra_wait_s`; a bus of servos, from what opens its port.
    mounted_servos
        Returns the servos of a face as mounted in its joints.
    rates, factory_rate, slowest_rate
        Baud rates to try, likely ones first; that of a new servo; one tried only while no servo
        answers.
    rate_of
        Returns the baud rates by the code in register `baud_rate`.
    answers
        Returns all servos that answer at the rate of the line, {id: model number}.
    shares_id
        Returns whether several servos seem to answer to an id.
    model_name
        Returns the name of a model number.
    lacking
        Returns the registers to change in the servo at an id, to fit its joint at a baud rate.
    foreign
        Returns the registers to change in the servo of a model at an id before it is moved.
    position_and_limits
        Returns the position and the position limits of a joint's servo of a model, by register.
    unlock, lock
        Called before and after registers are written: torque off, and the protocol's own steps.
    write, read
        Write or return one register of the servo of a model at an id. Both raise ServoError.

    """

    kind: str
    models: Callable[[], Mapping[str, Any]]
    make_line: Callable[..., Any]
    make_bus: Callable[..., Any]
    mounted_servos: Callable[[Wiring], Sequence[MountedServo[Any]]]
    rates: Sequence[int]
    factory_rate: int
    slowest_rate: int | None
    rate_of: Callable[[], Mapping[int, int]]
    answers: Callable[[Any], Mapping[int, Any]]
    shares_id: Callable[[Any, int], bool]
    model_name: Callable[[Any], str]
    lacking: Callable[[Any, MountedServo[Any], int, int], Sequence[Difference]]
    foreign: Callable[[Any, int, Any], Sequence[Difference]]
    position_and_limits: Callable[[Any, Joint, Any], Mapping[str, int]]
    unlock: Callable[[Any, int, Any], None]
    write: Callable[[Any, int, Any, str, int], None]
    read: Callable[[Any, int, Any, str], int]
    lock: Callable[[Any, int, Any], object]

    @contextmanager
    def unhurried_line(self, port: str, baud_rate: int) -> Iterator[Any]:
        """Open a port and yield a line with longer waits than a control loop allows; close it.

        Raises PortError.
        """
        transport = open_port(port, baud_rate)
        try:
            yield self.make_line(transport, extra_wait_s=UNHURRIED_S)
        finally:
            transport.close()

    def servos_by_joint(self, wiring: Wiring) -> dict[str, MountedServo[Any]]:
        """Return all servos of a face as mounted, by the names of their joints."""
        return {servo.joint.name: servo for servo in self.mounted_servos(wiring)}

    def scan(
        self, line: Any, rates: Iterable[int] | None = None
    ) -> Iterator[tuple[int, Mapping[int, Any]]]:
        """Yield each baud rate with the servos that answer at it, {id: model number}.

        rates: the rates to try; None: all. The line stays at the rate yielded last, even if the
        caller stops there.
        """
        for rate in dict.fromkeys(self.rates if rates is None else rates):
            with suppress(RateError):  # others may be possible
                line.baud_rate = rate
                yield rate, self.answers(line)

    def locate(self, line: Any, ids: Sequence[int]) -> tuple[Located, Finding | None]:
        """Return which servos answer at any rate, until all `ids` do; if none does, a finding.

        Without either, bytes came that are no answer: two servos with one id may spoil theirs.
        """
        own_rate, located, heard = line.baud_rate, dict[int, tuple[int, str]](), False
        for rate, found in self.scan(line, [own_rate, *self.rates]):
            located = {each: (rate, self.model_name(found[each])) for each in found} | located
            heard |= bool(found) or line.heard_noise
            if set(ids) <= set(located):
                break
        line.baud_rate = own_rate
        if heard:
            return located, None
        if other := other_kind_at(line.transport, self.kind):
            return located, Finding(Severity.BAD, other)
        tried = ", ".join(f"{rate:,}" for rate in dict.fromkeys([own_rate, *self.rates]))
        remedy = "check power (a Dynamixel's LED blinks once) and data cable"
        return located, Finding(Severity.BAD, f"no servo answers at any of {tried} baud", remedy)

    def find_servos(self, line: Any, ids: Sequence[int], baud_rate: int) -> Found:
        """Return by id the (rate, model number) of every answer at the face's and factory's rates.

        baud_rate: that of the face. Other rates are tried while one of `ids` is missing; the
        slowest only if no servo was found. The line stays at the rate tried last.
        """
        found: dict[int, list[tuple[int, Any]]] = {}
        rates = list(dict.fromkeys([baud_rate, self.factory_rate, *self.rates]))
        while rates and not (found and rates[0] == self.slowest_rate):
            with suppress(RateError):
                line.baud_rate = rate = rates.pop(0)
                for servo_id, number in self.answers(line).items():
                    found.setdefault(servo_id, []).append((rate, number))
            # All have answered, and the factory's rate, that of new servos, has been tried.
            if set(ids) <= set(found) and self.factory_rate not in rates:
                break
        return found

    def plan_chain(
        self, line: Any, servos: Sequence[MountedServo[Any]], found: Found, baud_rate: int
    ) -> list[Plan]:
        """Return a `Plan` of the registers to change for every servo; each must be at its own id.

        found: all servos that answer. baud_rate: the rate that the servos shall have. Raises
        ServoError with a line for each servo of another model, or with an id that several have.
        Only reads.
        """
        lines = []
        for servo in servos:
            servo_id, name = servo.joint.servo_id, servo.joint.name
            answers = found[servo_id]
            line.baud_rate = answers[0][0]
            if len(answers) > 1:
                rates = " and at ".join(f"{rate:,}" for rate, _ in answers)
                lines.append(f"{name}: id {servo_id} answers at {rates} baud: {_alone(name)}")
            elif self.shares_id(line, servo_id):
                lines.append(f"{name}: two servos answer to id {servo_id}: {_alone(name)}")
            else:
                lines += self._other_model(servo, answers[0][1])
        if lines:
            raise ServoError("\n".join(lines))
        ids = [servo.joint.servo_id for servo in servos]
        return [
            self._plan(line, servo, servo_id, found[servo_id][0][0], baud_rate)
            for servo, servo_id in zip(servos, ids, strict=True)
        ]

    def plan_alone(self, line: Any, servo: MountedServo[Any], found: Found, baud_rate: int) -> Plan:
        """Return the plan of registers to change so that the only connected servo becomes `servo`.

        found: all servos that answer, at any id. baud_rate: the rate that `servo` shall have.
        Raises ServoError if none or several answer, and for another model. Only reads.
        """
        # Every answer as (id, baud rate, model number).
        name, own_id = servo.joint.name, servo.joint.servo_id
        answers = [(servo_id, *each) for servo_id, all_of_it in found.items() for each in all_of_it]
        # New servos all have id 1: two of them may spoil each other's answers, so that none counts.
        answers = answers or [(1, self.factory_rate, None)]
        if len(answers) > 1:
            missing = "" if own_id in found else f"{name} (id {own_id}) does not answer; "
            raise ServoError(
                f"{missing}{len(answers)} servos answer (ids {sorted(each[0] for each in answers)})"
                f"; connect one at a time: {_alone(name)}"
            )
        ((servo_id, rate, number),) = answers
        line.baud_rate = rate
        # Two servos with one id may count as one answer above, so both ids are examined.
        for each in dict.fromkeys((own_id, servo_id)):
            if self.shares_id(line, each):
                raise ServoError(f"two servos answer to id {each}: {_alone(name)}")
        if number is None:
            raise ServoError("no servo answers at any baud rate; check its power and cable")
        if other := self._other_model(servo, number):
            raise ServoError(other[0])
        return self._plan(line, servo, servo_id, rate, baud_rate)

    def find_unknown(self, port: str, first_rate: int) -> tuple[int, dict[int, str]]:
        """Return the first baud rate at which servos answer, and their model names by id.

        first_rate: the rate to try first. If no servo answers, all rates are tried once more, since
        a computer that stalled misses answers. Raises ServoError where no servo answers, two have
        one id or a model is unknown, and PortError.
        """
        rates = [first_rate, *self.rates]
        found: Mapping[int, Any] = {}
        doubled: list[int] = []
        with self.unhurried_line(port, first_rate) as line:
            for _, found in chain(self.scan(line, rates), self.scan(line, rates)):
                if found or line.heard_noise:
                    # New servos all have id 1: several may spoil each other's answers.
                    doubled = [each for each in sorted({1, *found}) if self.shares_id(line, each)]
                if found or doubled:
                    break
        if doubled:
            raise ServoError(
                f"two servos answer to id {doubled[0]}: connect one at a time and give each an id "
                "of its own (`lipservo setup-servos`)"
            )
        if not found:
            raise ServoError(
                f"{port}: no {self.kind} servo answers at any baud rate; check power and cable; "
                "for servos of another kind give --bus, such as --bus feetech"
            )
        models = {each: self.model_name(number) for each, number in sorted(found.items())}
        for servo_id, name in models.items():
            if name not in self.models():
                raise ServoError(f"servo id {servo_id} is of {name}, which is not supported")
        return line.baud_rate, models

    def foreign_settings(self, port: str, rate: int, found: Mapping[int, str]) -> Foreign:
        """Return, by id, registers set by another program that must be reset before a servo moves.

        {}: none is set. found: model name by id. Raises PortError, and ServoError for a servo that
        falls silent.
        """
        with self.unhurried_line(port, rate) as line:
            return {
                servo_id: changes
                for servo_id, name in found.items()
                if (changes := self.foreign(line, servo_id, self.models()[name]))
            }

    def clear_foreign_settings(
        self, port: str, rate: int, found: Mapping[int, str], foreign: Foreign
    ) -> None:
        """Reset the registers in `foreign`, returned by `foreign_settings`; torque goes off.

        found: model name by id. Raises PortError, ServoError.
        """
        with self.unhurried_line(port, rate) as line:
            for servo_id, changes in foreign.items():
                for _ in self.set_up(line, servo_id, self.models()[found[servo_id]], changes):
                    pass  # each is read back

    def lone_servo(
        self, port: str, rate: int, servo_id: int, model_name: str, reach_deg: float
    ) -> tuple[Any, Joint, int]:
        """Return an unopened bus of one servo, its joint, and its present position in steps.

        The joint's 0 degrees are the present position. reach_deg: how far the joint may move to
        each side. rate: baud rate. Raises PortError, and ServoError for a servo that is silent, or
        stands so near an end of its range that it cannot be moved to both sides.
        """
        model = self.models()[model_name]
        joint = Joint(f"id_{servo_id}", servo_id, -reach_deg, reach_deg, _CAREFUL_DEG_S)
        with self.unhurried_line(port, rate) as line:
            now = self.position_and_limits(line, joint, model)
        place, reach = now["present_position"], reach_deg * model.pulses_per_deg
        if not now[_LOW] + reach <= place <= now[_HIGH] - reach:
            raise ServoError(
                f"servo id {servo_id} stands at {place}, within {reach_deg:g} degrees of an end of "
                f"its range; turn it by hand towards the middle ({model.center_pulse}), refit its "
                "horn if the joint must stand there, and run this again"
            )
        offset_deg = (place - model.center_pulse) / model.pulses_per_deg
        servo = MountedServo(joint, model, 1, offset_deg)
        return self.make_bus([servo], SameAdapter(port, rate)), joint, place

    def set_up(
        self, line: Any, servo_id: int, model: Any, changes: Sequence[Difference]
    ) -> Generator[Difference, None, None]:
        """Write `changes` to the servo at `servo_id`, and yield each change once it was read back.

        model: the servo's, such as a `ServoModel`. Torque goes off first and stays off. Id and baud
        rate are written last, and `line` follows to the new rate. The caller may stop between two
        changes: no register is half-written. Raises ServoError when the servo refuses or does not
        keep a value.
        """
        if not changes:
            return
        self.unlock(line, servo_id, model)
        try:
            # The sort is stable: position limits stay in the order that servos accept.
            for change in sorted(
                _limits_in_order(changes), key=lambda each: _LAST.get(each.name, 0)
            ):
                self.write(line, servo_id, model, change.name, change.wanted)
                # From here on the servo is reached by its new id, or at its new rate.
                if change.name == "id":
                    servo_id = change.wanted
                elif change.name == "baud_rate":
                    line.baud_rate = self.rate_of()[change.wanted]
                kept = self.read(line, servo_id, model, change.name)
                if kept != change.wanted:
                    raise ServoError(
                        f"servo id {servo_id}: {change.wanted} was written to {change.name}, but "
                        f"it stays {kept}"
                    )
                yield change
        finally:
            self.lock(line, servo_id, model)

    def _plan(
        self, line: Any, servo: MountedServo[Any], servo_id: int, rate: int, baud_rate: int
    ) -> Plan:
        line.baud_rate = rate
        return Plan(servo, servo_id, rate, tuple(self.lacking(line, servo, servo_id, baud_rate)))

    def _other_model(self, servo: MountedServo[Any], number: Any) -> list[str]:
        """Return [a line that another model was found], or [] for the right model."""
        it_is, wanted = self.model_name(number), servo.model.name
        if it_is == wanted:
            return []
        return [
            f"the servo found for {servo.joint.name!r} is {it_is}, the YAML says {wanted}; "
            "connect the right one, or correct the YAML"
        ]


def _limits_in_order(changes: Sequence[Difference]) -> list[Difference]:
    """Return the changes in an order that servos accept, both position limits last.

    Servos refuse a lower limit above the upper one. So the lower limit is written first where the
    new range lies below the old lower limit, otherwise the upper one.
    """
    by_name = {change.name: change for change in changes}
    low, high = by_name.get(_LOW), by_name.get(_HIGH)
    if low is None or high is None:
        return list(changes)
    first, second = (low, high) if high.wanted < low.found else (high, low)
    others = [change for change in changes if change not in (low, high)]
    return [*others, first, second]


def _alone(name: str) -> str:
    return f"connect the servo of {name!r} alone and run `lipservo setup-servos {name}`"
