"""Answers at once with bytes made beforehand, so that only the master's own work is measured.

Run as `python -m lipservo_lab.bench.bus.canned_peer N SIZE [--on-time]`; prints its port, ends
when its standard input closes. --on-time: real-time scheduling, where permitted, so that it answers
at once on a busy computer, too. Servos 1..N are XL330-M288 at 1 Mbaud, at 64 instants of a
motion of a few degrees about the middle of their turn; each question gets the next moment's answer.
What is read beforehand is SIZE bytes from present_current on; any other span is made at its first
question, then kept.

Understood are ping, read, sync read and fast sync read. Writes are answered and remembered, so that
a bus can arm these servos; goals are not pursued, and sync writes of goals not even looked at.
"""

import os
import select
import struct
import sys
import tty
from typing import Final

from firmware_bridge.dynamixel.control_table import register, servo_models
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import BROADCAST_ID, Frame, FrameParser, Instruction
from firmware_bridge.process.operating_system import run_on_time
from firmware_bridge.simulator.chain import SimulatedChain, sync_read, sync_write

_BAUD_RATE: Final = 1_000_000
_GOAL, _TORQUE = register("goal_position").address, register("torque_enable").address
_PRESENT_CURRENT: Final = register("present_current").address
#: 64 moments, 20 ms apart; goals change every 40 ms, by up to 45 pulses (4 degrees).
_N_TIMES, _MOMENT_S, _SWING_PULSES = 64, 0.020, 45
#: More different questions than any master asks; then the oldest are forgotten.
_MOST_KEPT: Final = 4096
_CHUNK: Final = 65_536


class CannedServos:
    """The control tables of servos 1..n at each instant of a motion, and answers made from them.

    Each request is answered from the next instant's tables, cyclically.
    """

    def __init__(self, n_servos: int) -> None:
        self._tables = _simulate_motion(n_servos)
        self._answers: dict[bytes, tuple[bytes, ...]] = {}
        self._turn = 0

    def answer(self, frame: Frame) -> bytes:
        """Return the status packets with which the servos answer a packet; b"" where none does."""
        answers = self._answers.get(frame.raw)
        if answers is None:
            if frame.instruction == Instruction.SYNC_WRITE and frame.parameters[0] == _GOAL:
                return b""
            answers = self._make_answers(frame)
        self._turn = (self._turn + 1) % _N_TIMES
        return answers[self._turn % len(answers)]

    def _make_answers(self, frame: Frame) -> tuple[bytes, ...]:
        """Return the answers to a packet, one for each instant of the motion; keep those of reads.

        Writes, pings and unknown instructions have one answer, which is not kept.
        """
        instruction, parameters = frame.instruction, frame.parameters
        if instruction in (Instruction.WRITE, Instruction.SYNC_WRITE):
            return (self._write_tables(frame),)
        if instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ):
            wanted = [tuple(each) for each in sync_read(parameters)]
        elif instruction == Instruction.READ and len(parameters) == 4:
            wanted = [(frame.packet_id, *struct.unpack("<HH", parameters))]
        elif instruction == Instruction.PING:
            ids = sorted(self._tables) if frame.packet_id == BROADCAST_ID else [frame.packet_id]
            return (b"".join(self._ping_status(each) for each in ids if each in self._tables),)
        else:
            return (b"",)
        fast = instruction == Instruction.FAST_SYNC_READ
        answers = tuple(self._statuses(wanted, moment, fast=fast) for moment in range(_N_TIMES))
        if len(self._answers) >= _MOST_KEPT:
            self._answers.pop(next(iter(self._answers)))
        self._answers[frame.raw] = answers
        return answers

    def _statuses(self, spans: list[tuple[int, ...]], instant: int, *, fast: bool) -> bytes:
        """Return the status packets of one instant for triples (servo id, address, size).

        fast: one joint status packet, as for a fast sync read. Unknown servos are left out.
        """
        blocks = [
            (servo_id, 0, bytes(self._tables[servo_id][instant][address : address + size]))
            for servo_id, address, size in spans
            if servo_id in self._tables
        ]
        if fast:
            return codec.fast_status(blocks) if blocks else b""
        return b"".join(codec.status(*block) for block in blocks)

    def _ping_status(self, servo_id: int) -> bytes:
        """Return a servo's status packet for a ping: model number and firmware version."""
        table = self._tables[servo_id][0]
        return codec.status(servo_id, 0, bytes((table[0], table[1], table[6])))

    def _write_tables(self, frame: Frame) -> bytes:
        """Write into the servos' tables of all instants; drop prepared answers if a table changes.

        Returns the status packet, b"" for sync writes, broadcasts and unknown servos.
        """
        if frame.instruction == Instruction.SYNC_WRITE:
            data_of_servo = sync_write(frame.parameters)
        else:
            is_broadcast = frame.packet_id == BROADCAST_ID
            ids = list(self._tables) if is_broadcast else [frame.packet_id]
            data_of_servo = dict.fromkeys(ids, frame.parameters)
        for servo_id, block in data_of_servo.items():
            address = block[0] | block[1] << 8
            end = address + len(block) - 2
            tables = self._tables.get(servo_id, [])
            if any(table[address:end] != block[2:] for table in tables):
                self._answers.clear()
            for table in tables:
                table[address:end] = block[2:]
        is_write = frame.instruction == Instruction.WRITE and frame.packet_id in self._tables
        return codec.status(frame.packet_id) if is_write else b""


def _simulate_motion(n_servos: int) -> dict[int, list[bytearray]]:
    """Simulate servos with goals of their own; return each id's control table at each instant."""
    model = servo_models()["XL330-M288"]
    ids = range(1, n_servos + 1)
    chain = SimulatedChain([model] * n_servos, ids, baud_rate=_BAUD_RATE)
    for servo in chain.servos:
        servo.write(struct.pack("<HB", _TORQUE, 1))
    tables: dict[int, list[bytearray]] = {servo_id: [] for servo_id in ids}
    for moment in range(-1, _N_TIMES):  # the first is only for the motion to begin
        for servo in chain.servos:
            if moment % 2 == 0:
                # -1 to 1, different for each servo and goal.
                share = ((7 * moment + 5 * servo.servo_id) % 31) / 15 - 1.0
                goal = model.center_pulse + round(share * _SWING_PULSES)
                servo.write(struct.pack("<Hi", _GOAL, goal))
        chain.advance((moment + 2) * _MOMENT_S)
        for servo in chain.servos:
            if moment >= 0:
                tables[servo.servo_id].append(bytearray(servo.read_span(0, model.table_size)[1]))
    for servo_tables in tables.values():
        for table in servo_tables:
            table[_TORQUE] = 0  # limp, until a master says otherwise
    return tables


def serve(n_servos: int, size: int) -> None:
    """Answer for servos 1..n_servos until standard input closes."""
    servos = CannedServos(n_servos)
    parser = FrameParser()
    for fast in (False, True):
        request = codec.sync_read(range(1, n_servos + 1), _PRESENT_CURRENT, size, fast=fast)
        servos.answer(parser.feed(request)[0])
    master, slave = os.openpty()
    tty.setraw(slave)
    sys.stdout.write(f"{os.ttyname(slave)}\n")
    sys.stdout.flush()
    while True:
        ready = select.select([master, sys.stdin], [], [])[0]
        if sys.stdin in ready:
            return
        for frame in parser.feed(os.read(master, _CHUNK)):
            answer = servos.answer(frame)
            if answer:
                os.write(master, answer)


if __name__ == "__main__":
    if "--on-time" in sys.argv[3:]:
        run_on_time()
    serve(int(sys.argv[1]), int(sys.argv[2]))
