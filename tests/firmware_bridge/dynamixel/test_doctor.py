"""What `doctor` tells of adapters, of servos that share an id, and while answers come late."""

import random
import struct

import pytest
from dynamixel_chain import BAUD_RATE, MemoryFace
from lipservo_lab.campaigns.line_campaign import Disturbance, DisturbedTransport

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import cycle_s, slow_adapter
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.doctor import Severity, examine
from firmware_bridge.dynamixel.provisioning import shares_id
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.serial_servos.provisioning import UNHURRIED_S
from firmware_bridge.simulator.chain import SimulatedChain
from firmware_bridge.simulator.ports import MemoryTransport


def examined(face, rate_hz=30.0, latency_timer_ms=1, seed=0, **disturbances):
    port = DisturbedTransport(
        face.chain, face.clock, random.Random(seed), Disturbance(**disturbances)
    )
    line = Line(port, return_delay_s=0.0, extra_wait_s=UNHURRIED_S)
    found = list(examine(line, face.servos, rate_hz, latency_timer_ms))
    # These faces have no current limits, which is another finding.
    told = [f for f in found if "max_current_ma" not in f.what]
    return {severity: [f.what for f in told if f.severity is severity] for severity in Severity}


def test_an_adapter_that_echoes_is_a_finding_and_no_fault():
    found = examined(MemoryFace(3), echo=True)

    assert found[Severity.BAD] == []
    assert found[Severity.WARNING] == [
        "the adapter gives back what is sent (echo); that is swallowed"
    ]


def test_servos_without_fast_reads_are_a_finding_and_no_fault():
    found = examined(MemoryFace(3), fast_sync_read=False)

    assert found[Severity.BAD] == []
    (line,) = found[Severity.WARNING]
    assert line.startswith("all servos do not answer Fast Sync Read")


@pytest.mark.parametrize("seed", range(8))
def test_a_healthy_face_stays_healthy_behind_a_bad_adapter(seed):
    """Ten in a hundred answers 25 ms late, echo, no fast reads, noise around every fifth."""
    bad = {"late": 0.1, "echo": True, "fast_sync_read": False, "stray": 0.2}
    found = examined(MemoryFace(10), seed=seed, **bad)

    assert found[Severity.BAD] == []
    assert len(found[Severity.WARNING]) == 2
    assert "joint_7 (id 7): XL330-M288, firmware 52, 5.0 V, 25 degC" in found[Severity.GOOD]


def test_an_adapter_of_16_ms_is_bad_where_the_rate_cannot_be_met():
    """The measured case: 32 ms a tick, 50 Hz asked for."""
    found = examined(MemoryFace(3), rate_hz=50.0, latency_timer_ms=16)

    (line,) = found[Severity.BAD]
    assert line.startswith("at 16 ms of adapter latency a tick takes 3")
    assert line.endswith("50 Hz cannot be met; set the latency timer to 1 ms (docs/hardware.md)")
    assert slow_adapter(10, BAUD_RATE, 50.0, 16) is not None
    assert cycle_s(10, BAUD_RATE, latency_s=0.016) == pytest.approx(0.0355, abs=0.001)
    assert slow_adapter(10, BAUD_RATE, 25.0, 16) is None
    assert slow_adapter(10, BAUD_RATE, 50.0, 1) is None
    assert slow_adapter(10, BAUD_RATE, 50.0, None) is None


def test_an_adapter_that_declares_nothing_is_measured():
    slow = examined(MemoryFace(3), latency_timer_ms=None, latency_s=0.016)
    quick = examined(MemoryFace(3), latency_timer_ms=None)

    assert "answers come 16 ms later than on the wire" in slow[Severity.WARNING]
    assert quick[Severity.WARNING] == []


class InStep:
    """A chain and one more servo whose bits overlay: equal ones come through, others are lost."""

    plugged = True

    def __init__(self, chain, other):
        self.chains = (chain, other)

    @property
    def next_delivery_s(self):
        return min(chain.next_delivery_s for chain in self.chains)

    def advance(self, now_s):
        for chain in self.chains:
            chain.advance(now_s)

    def receive(self, data, now_s, baud_rate):
        for chain in self.chains:
            chain.receive(data, now_s, baud_rate)

    def deliver(self, now_s):
        first, second = (chain.deliver(now_s) for chain in self.chains)
        n = min(len(first), len(second))
        both = bytes(a & b for a, b in zip(first[:n], second[:n], strict=True))
        return both + first[n:] + second[n:]


def other_servo(servo_id, place, **settings):
    chain = SimulatedChain([servo_models()["XL330-M288"]], [servo_id], baud_rate=BAUD_RATE)
    chain.motors.position[0] = place
    for name, value in settings.items():
        chain.servos[0][name] = value
    return chain


def with_twin(twin):
    face = MemoryFace(3)
    for name in ("max_position_limit", "min_position_limit"):
        twin.servos[0][name] = face.chain.servos[1][name]
    face.chain = InStep(face.chain, twin)
    return face


def test_two_servos_of_one_id_that_answer_in_step_are_seen_by_what_differs():
    """Their pings and settings look healthy; they stand apart, so their places spoil each other."""
    face = with_twin(other_servo(2, 1500.0))
    line = Line(MemoryTransport(face.chain, face.clock, BAUD_RATE))
    assert line.ping(2) is not None
    assert [shares_id(line, each) for each in (1, 2, 3)] == [False, True, False]

    assert examined(face)[Severity.BAD] == [
        "answers of id 2 are spoilt: two servos may have this id"
    ]


def test_a_face_of_one_joint_whose_id_two_servos_have_is_told_so():
    face = MemoryFace(1)
    face.chain = SimulatedChain([servo_models()["XL330-M288"]] * 2, [1, 1], baud_rate=BAUD_RATE)

    assert examined(face)[Severity.BAD] == [
        "answers of id 1 are spoilt: two servos may have this id"
    ]


def test_two_servos_of_one_id_that_answer_one_after_another_are_seen():
    """A new one waits 500 us, one that is set up answers at once: two whole answers to a ping."""
    chain = SimulatedChain([servo_models()["XL330-M288"]] * 2, [2, 2], baud_rate=BAUD_RATE)
    chain.servos[1]["return_delay_time"] = 250
    line = Line(MemoryTransport(chain, ManualClock(), BAUD_RATE))

    assert line.ping(2) is not None
    assert shares_id(line, 2)


@pytest.mark.parametrize(
    "disturbance",
    [Disturbance(late=0.1), Disturbance(stray=0.2), Disturbance(echo=True), Disturbance(lost=0.2)],
)
def test_one_servo_on_a_bad_line_is_not_taken_for_two(disturbance):
    for seed in range(10):
        face = MemoryFace(2)
        port = DisturbedTransport(face.chain, face.clock, random.Random(seed), disturbance)

        assert not any(shares_id(Line(port, 0.0), each) for each in (1, 2))


def test_looking_for_shared_ids_writes_nothing():
    face, sent = MemoryFace(2), []
    shares_id(Line(DisturbedTransport(face.chain, face.clock, random.Random(0), sent=sent)), 1)

    assert {data[7] for data in sent} == {1, 2}
    assert struct.unpack_from("<HH", sent[-1], 8) == (120, 27)
