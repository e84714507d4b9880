"""One servo in the hand, for the tests of what it does with its registers."""

import struct

from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.wire.codec import Instruction
from firmware_bridge.simulator.chain import SimulatedChain

MODEL = servo_models()["XL330-M288"]


class Bench:
    """Spoken to without a wire."""

    def __init__(self, model=MODEL, **options):
        self.chain = SimulatedChain([model], [1], **options)
        self.servo = self.chain.servos[0]
        self.now_s = 0.0

    def wait(self, seconds, step_s=0.01):
        """The chain itself goes on in steps of 5 ms, whatever is asked for at once."""
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s = min(self.now_s + step_s, end_s)
            self.chain.advance(self.now_s)

    def ask(self, instruction, parameters=b""):
        """The status error."""
        return self.servo.answer(instruction, parameters, self.now_s)[0]

    def write(self, name, value):
        entry = self.servo.model.registers[name]
        return self.raw_write(entry.address, entry.encode(value))

    def raw_write(self, address, data):
        return self.ask(Instruction.WRITE, struct.pack("<H", address) + data)

    def read(self, name):
        entry = self.servo.model.registers[name]
        _, data = self.servo.read_span(entry.address, entry.size)
        return entry.decode(data)

    def shaft_deg(self):
        """Where the shaft really is, counter-clockwise, 0 in the middle of its turn."""
        return (self.chain.motors.position[0] - 2048) * 360 / 4096
