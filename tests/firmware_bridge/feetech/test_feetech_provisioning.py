"""Setting Feetech servos up: only differences, unlocked and locked again; doctor and limp."""

import contextlib

import pytest
from feetech_chain import RATE, four_servos, wired

from firmware_bridge.bus_kinds import Severity, bus_kind
from firmware_bridge.clock import ManualClock
from firmware_bridge.errors import RateError, ServoError
from firmware_bridge.feetech.control_table import servo_models
from firmware_bridge.feetech.doctor import examine
from firmware_bridge.feetech.line import Line
from firmware_bridge.feetech.provisioning import (
    clear_foreign_settings,
    find_servos,
    find_unknown,
    foreign_settings,
    lone_servo,
    plan_alone,
    plan_chain,
    set_up,
)
from firmware_bridge.feetech.simulator import ChainFault, SimulatedChain
from firmware_bridge.feetech.torque import LineRelease
from firmware_bridge.serial_servos import serial_transport
from firmware_bridge.simulator.ports import MemoryTransport

SERVO = four_servos()[1]


def fresh(ids=(1,), model="STS3215", **options):
    """A chain as it comes, and a line to it."""
    chain = SimulatedChain([servo_models()[model]] * len(ids), ids, **options)
    for n, servo in enumerate(chain.servos):
        servo.stand_at(servo.place + 30 * n)
    return chain, Line(MemoryTransport(chain, ManualClock(), RATE))


def after_a_restart(servo):
    servo.power_up()
    return servo


@pytest.mark.parametrize("model", ["STS3215", "SCS0009"])
def test_a_servo_alone_gets_its_id_limits_and_rate_and_keeps_them_without_power(model):
    mounted = four_servos(model)[1]
    chain, line = fresh(model=model)
    (servo,) = chain.servos
    servo["return_delay_time"] = 250
    servo["phase"] = 0x1C
    plan = plan_alone(line, mounted, find_servos(line, [2], 250_000), 250_000)
    done = [str(change) for change in set_up(line, plan.servo_id, mounted.model, plan.changes)]

    assert done[-2:] == ["id is 1, should be 2", "baud_rate is 0, should be 2"]
    assert "return_delay_time is 250, should be 0" in done
    after_a_restart(servo)
    assert (servo["id"], servo["baud_rate"], servo["return_delay_time"]) == (2, 2, 0)
    assert servo["phase"] == (0x0C if model == "STS3215" else 0x1C)
    assert servo["min_position_limit"] < mounted.pulse_range()[0]
    assert servo["lock"] == 1
    assert line.read(2, 5, 1).data == b"\2"
    assert plan_alone(line, mounted, {2: [(250_000, plan_model(mounted))]}, 250_000).changes == ()


def plan_model(mounted):
    return mounted.model.dialect.encode("model_number", mounted.model.model_number)


def test_a_servo_that_stays_locked_is_refused_before_anything_is_written():
    chain, line = fresh(faults=[ChainFault(kind="locked", at_s=0.0)])
    chain.advance(0.01)
    plan = plan_alone(line, SERVO, find_servos(line, [2], RATE), RATE)

    with pytest.raises(ServoError, match="keeps its EEPROM locked, so no setting would last"):
        list(set_up(line, 1, SERVO.model, plan.changes))
    assert chain.servos[0]["id"] == 1


def test_whoever_stops_in_the_middle_leaves_the_eeprom_locked():
    chain, line = fresh()
    plan = plan_alone(line, SERVO, find_servos(line, [2], RATE), RATE)
    steps = set_up(line, 1, SERVO.model, plan.changes)
    next(steps)
    assert chain.servos[0]["lock"] == 0
    steps.close()

    assert chain.servos[0]["lock"] == 1
    assert not chain.servos[0]["torque_enable"]


@pytest.mark.parametrize(("model", "highest"), [("STS3215", 4095), ("SCS0009", 1023)])
def test_limits_of_another_face_are_foreign_and_are_widened(monkeypatch, model, highest):
    chain, line = fresh(model=model)
    (servo,) = chain.servos
    servo["min_position_limit"], servo["max_position_limit"] = 396, 708
    monkeypatch.setattr(
        "firmware_bridge.serial_servos.provisioning.open_port", lambda *_: line.transport
    )
    monkeypatch.setattr(line.transport, "close", lambda: None)
    how = ("here", RATE, {1: model})
    foreign = foreign_settings(*how)
    clear_foreign_settings(*how, foreign)

    assert {each.name for each in foreign[1]} == {"min_position_limit", "max_position_limit"}
    assert (servo["min_position_limit"], servo["max_position_limit"]) == (0, highest)
    assert foreign_settings(*how) == {}


@pytest.mark.parametrize("ids", [(1, 1), (1, 1, 2)])
def test_servos_from_the_box_in_one_chain_are_not_taken_for_none_or_left_out(monkeypatch, ids):
    _, line = fresh(ids=ids)
    monkeypatch.setattr(
        "firmware_bridge.serial_servos.provisioning.open_port", lambda *_: line.transport
    )
    with pytest.raises(ServoError, match="two servos answer to id 1: connect one at a time and"):
        find_unknown("here", RATE)


def test_two_servos_from_the_box_are_not_set_up_as_one_joint():
    _, line = fresh(ids=(1, 1))
    with pytest.raises(ServoError, match="two servos answer to id 1: connect the servo of "):
        plan_alone(line, SERVO, find_servos(line, [2], RATE), RATE)


@pytest.mark.parametrize("place", [20, 1000])
def test_a_servo_at_the_end_of_its_range_is_not_nudged_beyond_it(monkeypatch, place):
    chain, line = fresh(model="SCS0009")
    chain.servos[0]["min_position_limit"], chain.servos[0]["max_position_limit"] = 20, 1003
    monkeypatch.setattr(
        "firmware_bridge.serial_servos.provisioning.open_port",
        lambda _port, rate: MemoryTransport(chain, line.transport.clock, rate),
    )
    chain.servos[0].stand_at(place)
    with pytest.raises(ServoError, match=rf"at {place}, .*by hand towards the middle \(512\)"):
        lone_servo("here", RATE, 1, "SCS0009", 4.0)
    chain.servos[0].stand_at(40)

    assert lone_servo("here", RATE, 1, "SCS0009", 4.0)[2] == 40


def test_two_alike_at_one_id_are_noticed():
    _, line = fresh(ids=(1, 1))
    found = {1: [(RATE, b"\x09\x03")]}

    with pytest.raises(ServoError, match="two servos answer to id 1: connect the servo of 'jaw'"):
        plan_chain(line, four_servos()[:1], found, RATE)


def test_more_than_one_or_none_or_another_model_is_refused():
    _, line = fresh(ids=(1, 5))
    with pytest.raises(ServoError, match=r"2 servos answer \(ids \[1, 5\]\); connect one at a"):
        plan_alone(line, SERVO, find_servos(line, [2], RATE), RATE)
    with pytest.raises(ServoError, match="no servo answers at any baud rate"):
        plan_alone(line, SERVO, {}, RATE)
    _, line = fresh(model="SCS0009")
    with pytest.raises(ServoError, match="is SCS0009, the YAML says STS3215"):
        plan_alone(line, SERVO, find_servos(line, [1], RATE), RATE)


def findings(chain_options=None, set_up=None):
    on = wired(set_up=set_up, **(chain_options or {}))
    line = Line(on.open(), extra_wait_s=0.06)
    with contextlib.closing(line.transport):
        return list(examine(line, on.servos, 50.0)), on


def test_doctor_has_nothing_bad_to_say_of_a_face_that_is_set_up_and_writes_nothing():
    found, on = findings()

    assert [each.what for each in found if each.severity is Severity.BAD] == []
    assert "no watchdog" in found[-1].what
    assert not on.chain.changes


@pytest.mark.parametrize(
    ("register", "value", "words"),
    [
        ("baud_rate", 4, "answers at 115,200 baud, the YAML says 1,000,000"),
        ("id", 9, "does not answer"),
        ("return_delay_time", 100, "return_delay_time is 100, should be 0"),
        ("max_voltage", 70, "has 7.4 V, needs 4..7"),
        ("torque_enable", 1, "has torque on"),
        ("max_temperature", 30, "switches off at 30"),
        ("id", 2, "are spoilt: two servos may have this id"),
    ],
)
def test_doctor_names_what_is_wrong(register, value, words):
    found, _ = findings(set_up=lambda chain: chain.servos[0].__setitem__(register, value))

    assert any(words in each.what for each in found), [each.what for each in found]


def test_limp_finds_everybody_at_whatever_rate_and_each_confirms():
    chain, line = fresh(ids=(1, 200))
    for servo in chain.servos:
        servo["baud_rate"] = 3
        servo.write(40, b"\1")
    release = LineRelease(line.transport, (1_000_000, 128_000))

    assert release.find(()) == [1, 200]
    assert [release.ask(each) for each in (1, 200, 7)] == ["", "", "did not answer"]
    assert not any(servo["torque_enable"] for servo in chain.servos)


def test_limp_of_unknown_feetech_servos_needs_no_adapter_that_can_do_a_million_baud(monkeypatch):
    chain, line = fresh()
    chain.servos[0]["baud_rate"] = 4
    chain.servos[0].write(40, b"\1")

    class SlowAdapter(MemoryTransport):
        def __setattr__(self, name, value):
            if name == "baud_rate" and value > 250_000:
                raise RateError(f"this adapter cannot do {value:,} baud")
            super().__setattr__(name, value)

    def same_adapter(_port, rate):
        return lambda: SlowAdapter(chain, line.transport.clock, rate)

    monkeypatch.setattr(serial_transport, "SameAdapter", same_adapter)
    release = bus_kind("feetech").port_release("here", None)()

    assert release.find(()) == [1]
    assert release.ask(1) == ""
