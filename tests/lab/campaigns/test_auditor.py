"""The auditor of the campaigns counts what it is there for, and nothing that nobody asked for."""

import struct

import numpy as np
import pytest
from dynamixel_chain import BAUD_RATE, mounted
from lipservo_lab.campaigns.auditor import Auditor, FeetechWire
from lipservo_lab.campaigns.chain_trials import face

from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.wire.codec import Instruction, packet
from firmware_bridge.feetech import codec
from firmware_bridge.feetech.control_table import servo_models
from firmware_bridge.feetech.simulator import chain_for as chain_for_feetechs
from firmware_bridge.simulator.chain import chain_for
from firmware_bridge.stopping import StopLevel

PERIOD_S = 1.0 / 30.0


class AuditedServo:
    """One servo of at most 300 deg/s, spoken to past all gates."""

    def __init__(self):
        servos = mounted(1)
        self.chain = chain_for(servos, BAUD_RATE)
        self.auditor = Auditor(servos, PERIOD_S)
        self.auditor.watch(self.chain)
        self.servo = self.chain.servos[0]
        self.motors = self.chain.motors
        self.now_s = 0.0
        self.write("bus_watchdog", 100)
        self.write("goal_position", self.servo["present_position"])

    def write(self, name, value):
        entry = register(name)
        parameters = struct.pack("<H", entry.address) + entry.encode(value)
        self.auditor.see(self.now_s, packet(1, Instruction.WRITE, parameters))
        self.servo.answer(Instruction.WRITE, parameters, self.now_s)

    def wait(self, seconds):
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            self.chain.advance(self.now_s)
            if self.now_s % 0.5 < 0.01:
                self.servo.answer(Instruction.PING, b"", self.now_s)  # its watchdog hears


@pytest.fixture
def audited():
    return AuditedServo()


def armed(audited, profile_velocity):
    audited.write("profile_velocity", profile_velocity)
    audited.write("torque_enable", 1)
    audited.wait(0.1)
    return audited.auditor


def test_a_jump_without_a_profile_is_too_fast_even_when_the_shaft_lags_behind(audited):
    auditor = armed(audited, profile_velocity=0)

    audited.write("goal_position", audited.servo["present_position"] + 400)
    audited.wait(0.5)

    assert auditor.too_fast > 0
    assert auditor.fastest > 1.1


def test_the_same_way_within_the_joints_speed_is_not(audited):
    auditor = armed(audited, profile_velocity=200)  # 275 deg/s

    audited.write("goal_position", audited.servo["present_position"] + 400)
    audited.wait(1.0)

    assert abs(audited.motors.position[0] - audited.servo["goal_position"]) < 2
    assert auditor.too_fast == 0
    assert auditor.fastest == pytest.approx(275.0 / 300.0, abs=0.02)


def test_a_pushed_shaft_that_comes_back_by_itself_is_not_the_programs_doing(audited):
    auditor = armed(audited, profile_velocity=200)

    audited.motors.position = audited.motors.position + np.array([300.0])
    audited.wait(0.5)

    assert abs(audited.motors.position[0] - audited.servo["goal_position"]) < 2
    assert auditor.too_fast == 0


def test_a_frozen_shaft_may_brake_and_then_not_move(audited):
    auditor = armed(audited, profile_velocity=25)
    auditor.note_stop(audited.now_s, StopLevel.FREEZE)

    audited.write("goal_position", audited.servo["present_position"] + 400)
    audited.wait(0.2)
    assert auditor.moved_frozen == 0

    audited.wait(0.5)
    assert auditor.moved_frozen > 0


def test_torque_without_a_watchdog_or_after_a_stop_is_counted(audited):
    audited.write("bus_watchdog", 0)
    audited.auditor.note_stop(-1.0, StopLevel.LIMP)

    audited.write("torque_enable", 1)

    assert (audited.auditor.armed_wrongly, audited.auditor.armed_late) == (1, 1)


@pytest.mark.parametrize(
    ("packet_of", "count"),
    [
        (lambda: codec.sync_write(42, 2, [(1, (3000).to_bytes(2, "little"))]), "goals_outside"),
        (lambda: codec.sync_write(42, 2, [(1, (2250).to_bytes(2, "little"))]), "steps_too_long"),
        (lambda: codec.write(1, 42, (2100).to_bytes(2, "little")), "goals_outside"),
        (lambda: codec.torque((1,), on=True), "armed_wrongly"),
    ],
)
def test_what_a_feetech_servo_must_not_be_told_is_counted(packet_of, count):
    """It stands at 2048, may go to 2503, by 114 a period, and has no bound of its speed yet."""
    servos = face(1, servo_models()["STS3215"])
    auditor = Auditor(servos, PERIOD_S, FeetechWire())
    auditor.watch(chain_for_feetechs(servos, BAUD_RATE))
    auditor.see(0.0, codec.sync_write(42, 2, [(1, (2048).to_bytes(2, "little"))]))
    assert not auditor.goals_outside + auditor.steps_too_long + auditor.armed_wrongly
    auditor.see(0.1, packet_of())

    assert getattr(auditor, count) == 1
