"""Reg write, action, bulk and sync instructions: the manual's own packets, byte by byte."""

import struct

import pytest
from servo_bench import Bench

from firmware_bridge.dynamixel.control_table import register, servo_models
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import BROADCAST_ID, FrameParser, Instruction, StatusError
from firmware_bridge.simulator.chain import SimulatedChain
from firmware_bridge.simulator.motors import Environment
from firmware_bridge.simulator.wire import WireRules

BAUD_RATE = 1_000_000
DONE = "FFFFFD00 01 0400 55 00 A10C"
GOAL = register("goal_position").address


class Conversation:
    """A chain that is asked in bytes and answers in bytes."""

    def __init__(self, n=2, model="XM430-W210", **options):
        models = [servo_models()[model]] * n
        self.chain = SimulatedChain(models, range(1, n + 1), baud_rate=BAUD_RATE, **options)
        self.now_s = 1.0
        self.chain.advance(self.now_s)

    def __call__(self, request):
        self.chain.receive(request, self.now_s, BAUD_RATE)
        self.now_s += 0.1
        return self.chain.deliver(self.now_s)

    def statuses(self, request):
        return [
            (frame.packet_id, frame.parameters[0], frame.parameters[1:])
            for frame in FrameParser().feed(self(request))
        ]


def spaced(text):
    return bytes.fromhex(text)


def spans(*wanted):
    return b"".join(struct.pack("<BHH", *each) for each in wanted)


def test_bulk_read_as_printed_in_the_manual():
    """https://emanual.robotis.com/docs/en/dxl/protocol2/#bulk-read"""
    ask = Conversation(environment=Environment(supply_v=11.9, supply_ohm=0.0, ambient_degc=36.0))

    answer = ask(spaced("FFFFFD00 FE 0D00 92 01 9000 0200 02 9200 0100 1A05"))

    assert answer == spaced("FFFFFD00 01 0600 55 00 7700 C369 FFFFFD00 02 0500 55 00 24 8BA9")


def test_bulk_write_as_printed_in_the_manual():
    """https://emanual.robotis.com/docs/en/dxl/protocol2/#bulk-write"""
    ask = Conversation()
    ask.chain.servos[0]["max_voltage_limit"] = 100
    ask.chain.servos[1]["temperature_limit"] = 10

    assert ask(spaced("FFFFFD00 FE 1000 93 01 2000 0200 A000 02 1F00 0100 50 B768")) == b""

    assert ask.chain.servos[0]["max_voltage_limit"] == 160
    assert ask.chain.servos[1]["temperature_limit"] == 80


def test_reg_write_and_action_as_printed_in_the_manual():
    """https://emanual.robotis.com/docs/en/dxl/protocol2/#reg-write"""
    ask = Conversation()
    (servo, _) = ask.chain.servos

    assert ask(spaced("FFFFFD00 01 0900 04 68 00 C8000000 AE8E")) == spaced(DONE)
    assert (servo["goal_velocity"], servo["registered_instruction"]) == (0, 1)
    assert ask(spaced("FFFFFD00 01 0300 05 02CE")) == spaced(DONE)
    assert (servo["goal_velocity"], servo["registered_instruction"]) == (200, 0)


def test_clear_as_printed_in_the_manual():
    """https://emanual.robotis.com/docs/en/dxl/protocol2/#clear"""
    assert Conversation()(spaced("FFFFFD00 01 0800 10 01 44584C22 B1DC")) == spaced(DONE)


def test_one_action_to_all_moves_all_at_once_and_nobody_answers():
    ask = Conversation(n=3)
    for servo in ask.chain.servos:
        servo.write(struct.pack("<HB", register("torque_enable").address, 1))
        parameters = struct.pack("<Hi", GOAL, 2500)
        ask(codec.packet(servo.servo_id, Instruction.REG_WRITE, parameters))
    assert [servo["goal_position"] for servo in ask.chain.servos] == [2048] * 3

    assert ask(codec.packet(BROADCAST_ID, Instruction.ACTION)) == b""

    assert [servo["goal_position"] for servo in ask.chain.servos] == [2500] * 3
    assert ask.chain.motors.goal.tolist() == [2500.0] * 3


def test_an_action_without_a_registered_write_is_an_instruction_error():
    bench = Bench()

    assert bench.ask(Instruction.ACTION) == StatusError.INSTRUCTION
    assert (
        bench.ask(Instruction.REG_WRITE, struct.pack("<Hi", GOAL, 9999)) == StatusError.DATA_LIMIT
    )
    assert bench.ask(Instruction.REG_WRITE, struct.pack("<H", GOAL)) == StatusError.DATA_LENGTH
    assert bench.ask(Instruction.ACTION) == StatusError.INSTRUCTION
    assert bench.ask(Instruction.REG_WRITE, struct.pack("<Hi", GOAL, 3000)) == 0
    bench.servo.reboot(0.0)
    assert bench.ask(Instruction.ACTION) == StatusError.INSTRUCTION


def test_a_registered_write_of_indirect_addresses_waits_for_the_action():
    bench = Bench()

    assert bench.ask(Instruction.REG_WRITE, struct.pack("<HH", 168, 132)) == 0
    assert bench.servo.read_span(168, 2)[1] == struct.pack("<H", 208)
    assert bench.ask(Instruction.ACTION) == 0
    assert bench.servo.read_span(168, 2)[1] == struct.pack("<H", 132)


@pytest.mark.parametrize("fast", [False, True])
@pytest.mark.parametrize("bulk", [False, True])
def test_an_id_named_twice_is_answered_once(bulk, fast):
    ask = Conversation()
    if bulk:
        instruction = Instruction.FAST_BULK_READ if fast else Instruction.BULK_READ
        wanted = spans((1, 132, 4), (1, 132, 4), (2, 132, 4))
        request = codec.packet(BROADCAST_ID, instruction, wanted)
    else:
        request = codec.sync_read([1, 1, 2], 132, 4, fast=fast)

    if fast:
        found = [(s.servo_id, s.data) for s in codec.split_fast_status(ask(request), 4)]
    else:
        found = [(servo_id, data) for servo_id, _, data in ask.statuses(request)]

    assert found == [(1, struct.pack("<i", 2048)), (2, struct.pack("<i", 2048))]


@pytest.mark.parametrize("instruction", [Instruction.SYNC_READ, Instruction.BULK_READ])
def test_a_group_read_sent_to_one_id_is_answered_by_that_servo_alone(instruction):
    ask = Conversation(n=3)
    sync = struct.pack("<HH", 132, 4) + b"\1\2\3"
    bulk = spans((1, 132, 4), (2, 132, 4), (3, 132, 4))
    parameters = sync if instruction == Instruction.SYNC_READ else bulk

    assert ask.statuses(codec.packet(2, instruction, parameters)) == [
        (2, 0, struct.pack("<i", 2048))
    ]


def test_a_sync_write_sent_to_one_id_is_for_that_servo_alone():
    ask = Conversation()
    led = register("led").address
    ask(codec.packet(2, Instruction.SYNC_WRITE, struct.pack("<HH", led, 1) + b"\1\1\2\1"))

    assert [servo["led"] for servo in ask.chain.servos] == [0, 1]


@pytest.mark.parametrize(("chain_stops", "heard"), [(False, [1, 3]), (True, [1])])
def test_a_silent_servo_leaves_a_gap_in_a_bulk_read_or_stops_it(chain_stops, heard):
    ask = Conversation(n=3, rules=WireRules(chain_stops=chain_stops))
    ask.chain.servos[1].deaf_until_s = float("inf")
    request = codec.packet(
        BROADCAST_ID, Instruction.BULK_READ, spans((1, 132, 4), (2, 70, 1), (3, 126, 2))
    )

    assert [servo_id for servo_id, _, _ in ask.statuses(request)] == heard
    assert ask.chain.counts.contention == 0


def test_a_silent_servo_cuts_a_fast_bulk_read_off_where_its_part_should_be():
    ask = Conversation(n=3)
    ask.chain.servos[1].deaf_until_s = float("inf")
    wanted = spans((1, 132, 4), (2, 132, 2), (3, 132, 4))

    answer = ask(codec.packet(BROADCAST_ID, Instruction.FAST_BULK_READ, wanted))

    declared = int.from_bytes(answer[5:7], "little")
    assert declared == 1 + 8 + 6 + 8
    assert answer[8:14] == b"\0\1" + struct.pack("<i", 2048)
    assert len(answer) == 8 + 8


def test_group_instructions_cut_short_are_answered_by_nobody():
    ask = Conversation()
    for instruction in (0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A):
        for parameters in (b"", b"\1", b"\x74\0\4\0"):
            assert ask(codec.packet(BROADCAST_ID, instruction, parameters)) == b""
    half = struct.pack("<BHHB", 1, GOAL, 4, 0)
    ask(codec.packet(BROADCAST_ID, Instruction.BULK_WRITE, half))
    assert [servo["goal_position"] for servo in ask.chain.servos] == [2048, 2048]
