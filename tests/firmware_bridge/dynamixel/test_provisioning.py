"""Setting up and examining servos, on simulated ones in memory."""

from dataclasses import replace

import pytest
from dynamixel_chain import BAUD_RATE, MemoryFace, mounted

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import budget
from firmware_bridge.dynamixel.control_table import baud_rates, servo_models
from firmware_bridge.dynamixel.doctor import Severity, examine
from firmware_bridge.dynamixel.mounting import identify_all
from firmware_bridge.dynamixel.provisioning import (
    SCANNED_RATES,
    find_unknown,
    lone_servo,
    read_settings,
    scan,
    set_up,
    wanted_settings,
)
from firmware_bridge.dynamixel.torque import LineRelease
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.errors import RateError, ServoError
from firmware_bridge.serial_servos.provisioning import UNHURRIED_S, Difference, differences
from firmware_bridge.simulator.chain import SimulatedChain
from firmware_bridge.simulator.ports import MemoryTransport


def fresh_servo():
    """A servo from the factory: id 1, 57,600 baud, 500 us return delay; and a line to it."""
    chain = SimulatedChain([servo_models()["XL330-M288"]], [1])
    return chain, Line(MemoryTransport(chain, ManualClock(), 57_600))


def lacking(line, model, wanted):
    return differences(read_settings(line, 1, model, wanted), wanted)


def test_a_servo_from_the_factory_is_set_up_and_the_line_follows_it():
    chain, line = fresh_servo()
    (servo,) = mounted(8)[7:]
    wanted = wanted_settings(servo, BAUD_RATE)
    changes = list(set_up(line, 1, servo.model, lacking(line, servo.model, wanted)))

    assert {change.name for change in changes} == {
        "id", "baud_rate", "return_delay_time", "min_position_limit", "max_position_limit",
    }  # fmt: skip
    assert line.baud_rate == BAUD_RATE
    assert chain.servos[0].servo_id == 8
    assert not differences(read_settings(line, 8, servo.model, wanted), wanted)


def test_setting_up_twice_writes_nothing_the_second_time():
    _, line = fresh_servo()
    (servo,) = mounted(1)
    wanted = wanted_settings(servo, 57_600)

    assert list(set_up(line, 1, servo.model, lacking(line, servo.model, wanted)))
    assert lacking(line, servo.model, wanted) == []


@pytest.mark.parametrize("found", [(3000, 3500), (0, 500), (1200, 1800), (900, 2200)])
def test_a_range_is_moved_up_or_down_without_ever_being_out_of_order(found):
    """Servos refuse a lower limit above the upper one, and the other way round."""
    chain, line = fresh_servo()
    servo = chain.servos[0]
    servo["min_position_limit"], servo["max_position_limit"] = found
    wanted = {"max_position_limit": 2000, "min_position_limit": 1000}
    list(set_up(line, 1, servo.model, lacking(line, servo.model, wanted)))

    assert (servo["min_position_limit"], servo["max_position_limit"]) == (1000, 2000)


def test_settings_survive_a_power_cycle():
    chain, line = fresh_servo()
    (servo,) = mounted(1)
    wanted = wanted_settings(servo, 57_600)
    list(set_up(line, 1, servo.model, lacking(line, servo.model, wanted)))
    chain.servos[0].reboot(line.transport.clock.now())
    line.transport.clock.advance(1.0)

    assert not differences(read_settings(line, 1, servo.model, wanted), wanted)


def test_a_servo_that_refuses_is_named_with_register_and_value():
    _, line = fresh_servo()
    model = servo_models()["XL330-M288"]

    with pytest.raises(ServoError, match=r"id 1 rejects max_position_limit = 9999 \(error 4\)"):
        list(set_up(line, 1, model, [Difference("max_position_limit", 4095, 9999)]))


def test_the_scan_finds_servos_at_any_rate():
    _, line = fresh_servo()
    found = dict(scan(line, [1_000_000, 57_600]))

    assert found == {1_000_000: {}, 57_600: {1: 1200}}


def test_the_scan_leaves_no_rate_out():
    assert set(SCANNED_RATES) == set(baud_rates().values())


@pytest.fixture
def at_port(monkeypatch):
    """A chain of new servos with these ids at the port `here`."""

    def wired(*ids):
        chain, clock = SimulatedChain([servo_models()["XL330-M288"]] * len(ids), ids), ManualClock()
        monkeypatch.setattr(
            "firmware_bridge.serial_servos.provisioning.open_port",
            lambda _port, rate: MemoryTransport(chain, clock, rate),
        )
        return chain

    return wired


@pytest.mark.parametrize("ids", [(1, 1), (1, 1, 2)])
def test_servos_from_the_box_in_one_chain_are_not_taken_for_none_or_left_out(at_port, ids):
    at_port(*ids)

    with pytest.raises(ServoError, match="two servos answer to id 1: connect one at a time and"):
        find_unknown("here", 1_000_000)


def test_servos_without_a_face_are_found_by_their_ids(at_port):
    at_port(1, 5)
    assert find_unknown("here", 1_000_000) == (57_600, {1: "XL330-M288", 5: "XL330-M288"})


def test_a_servo_at_the_end_of_its_range_is_not_nudged_beyond_it(at_port):
    chain = at_port(1)
    chain.motors.position[0] = 4060
    with pytest.raises(ServoError, match="id 1 stands at 4060, within 4 degrees of an end of its"):
        lone_servo("here", 57_600, 1, "XL330-M288", 4.0)
    chain.motors.position[0] = 4040
    _, joint, place = lone_servo("here", 57_600, 1, "XL330-M288", 4.0)

    assert (joint.min_deg, joint.max_deg, place) == (-4.0, 4.0, 4040)


class SlowAdapter(MemoryTransport):
    """An adapter that cannot do more than a million baud."""

    def __setattr__(self, name, value):
        if name == "baud_rate" and value > 1_000_000:
            raise RateError(f"this adapter cannot do {value:,} baud")
        super().__setattr__(name, value)


def test_an_adapter_that_cannot_do_every_rate_lets_go_at_those_that_it_can():
    chain = SimulatedChain([servo_models()["XL330-M288"]], [1], baud_rate=115_200)
    chain.servos[0]["torque_enable"] = 1
    release = LineRelease(SlowAdapter(chain, ManualClock(), 57_600), SCANNED_RATES)

    assert release.find(()) == [1]
    assert release.ask(1) == ""
    assert not chain.servos[0]["torque_enable"]


def examined(face, rate_hz=30.0, latency_timer_ms=1, servos=None):
    line = Line(face.open(), extra_wait_s=UNHURRIED_S)
    found = list(examine(line, servos or face.servos, rate_hz, latency_timer_ms))
    return {severity: [f.what for f in found if f.severity is severity] for severity in Severity}


def test_a_healthy_face_has_nothing_bad():
    servos = [replace(servo, max_current_ma=440.0) for servo in mounted(3)]
    found = examined(MemoryFace(servos=servos))

    assert found[Severity.BAD] == found[Severity.WARNING] == []
    assert "joint_1 (id 1): XL330-M288, firmware 52, 5.0 V, 25 degC" in found[Severity.GOOD]


def test_servos_that_nothing_bounds_are_named_with_a_value_to_write():
    bounded, other = mounted(2)
    unable = mounted(3, "XL430-W250")[2]
    servos = [replace(bounded, max_current_ma=300.0), other, unable]
    line = Line(MemoryFace(servos=servos).open(), extra_wait_s=UNHURRIED_S)
    found = list(examine(line, servos, 30.0, 1))

    (finding,) = [each for each in found if each.severity is Severity.WARNING]
    assert finding.what == "without max_current_ma these pull as hard as they can: joint_2"
    assert "`max_current_ma: 440`" in finding.remedy


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda s: s.__setitem__("id", 99), "joint_2 (id 2) does not answer"),
        (lambda s: s.__setitem__("baud_rate", 1), "joint_2 (id 2) answers at 57,600 baud"),
        (lambda s: s.__setitem__("model_number", 1190), "joint_2 (id 2) is XL330-M077, the YAML"),
        (lambda s: s.__setitem__("model_number", 77), "joint_2 (id 2) is unknown model 77"),
        (lambda s: s.__setitem__("drive_mode", 1), "joint_2 (id 2): drive_mode is 1, should be 0"),
        (lambda s: s.latch(0x21), "joint_2 (id 2) reports input voltage and overload"),
        (lambda s: s.__setitem__("id", 1), "answers of id 1 are spoilt: two servos"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_found_and_named(spoil, said):
    face = MemoryFace(3)
    spoil(face.chain.servos[1])

    assert any(line.startswith(said) for line in examined(face)[Severity.BAD])


def test_a_strange_servo_and_a_slow_adapter_are_warnings():
    face = MemoryFace(3)
    found = examined(face, latency_timer_ms=16, servos=face.servos[:2])

    assert any("holds bytes back for 16 ms" in line for line in found[Severity.WARNING])
    assert any("id 3 (XL330-M288) is on the bus" in line for line in found[Severity.WARNING])


def test_an_empty_bus_says_what_was_tried():
    face = MemoryFace(1)
    face.chain.servos[0].deaf_until_s = float("inf")

    assert examined(face)[Severity.BAD][0].startswith(
        "no servo answers at any of 1,000,000, 57,600"
    )


def test_a_bus_that_is_too_slow_is_told_what_to_do():
    """The issue's own example."""
    said = budget(12, 57_600, 30.0)

    assert said.startswith("12 servos at 57,600 baud cannot do 30 Hz with feedback")
    assert "set 1,000,000 baud" in said
    assert budget(12, 1_000_000, 30.0) is None
    assert "return delay" in budget(20, 1_000_000, 100.0, return_delay_s=0.0005)


def test_what_servos_hold_is_read_for_whoever_compares_it():
    face = MemoryFace(3)
    face.chain.servos[2]["id"] = 77
    first, second, third = identify_all(Line(face.open()), face.servos, strict=False)

    assert (first.model_number, first.firmware) == (1200, 52)
    assert (second.eeprom["homing_offset"], second.eeprom["drive_mode"]) == (0, 0)
    assert first.eeprom["min_position_limit"] < first.eeprom["max_position_limit"]
    assert third is None


@pytest.mark.parametrize(
    ("register", "value", "said"),
    [
        ("homing_offset", -300, "has homing offset -300 pulses, needs 0"),
        ("drive_mode", 1, "has drive mode 1, needs 0"),
        ("operating_mode", 16, "is in operating mode 16"),
        ("max_position_limit", 2100, "has limits"),
        ("startup_configuration", 1, "switches torque on by itself"),
    ],
)
def test_servos_that_differ_from_the_yaml_are_refused_with_the_remedy(register, value, said):
    face = MemoryFace(3)
    face.chain.servos[1][register] = value
    with pytest.raises(ServoError) as error:
        identify_all(Line(face.open()), face.servos, strict=False)

    first, last = str(error.value).splitlines()
    assert first.startswith(f"servo 'joint_2' (id 2) {said}")
    assert "setup-servos" in first
    assert "lipservo doctor" in last
    assert not any(servo.torque_on for servo in face.chain.servos)
