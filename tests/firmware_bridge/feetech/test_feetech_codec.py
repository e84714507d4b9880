"""Feetech packets: worked examples of the manual, noise around them, and what is never written."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.feetech import codec
from firmware_bridge.feetech.codec import GoalWrite, Instruction, SpanRead, Status, packets_in
from firmware_bridge.feetech.control_table import model_name, servo_models

STS = servo_models()["STS3215"].dialect
SCS = servo_models()["SCS0009"].dialect
DATA = st.binary(min_size=0, max_size=40)


def test_packets_are_those_of_the_manual():
    """http://doc.feetech.cn/ , FT-SCS-Protocol: 1.3.2 and 1.3.7."""
    assert codec.read(1, 56, 2).hex() == "ffff0104023802be"
    assert SpanRead((1, 2), 56, 8).request.hex() == "fffffe068238080102" + "36"
    assert codec.statuses_in(bytes.fromhex("ffff0104001805dd")) == [Status(1, 0, b"\x18\x05")]
    assert STS.decode("present_position", b"\x18\x05", 56) == 1304


@given(st.lists(st.tuples(st.integers(0, 253), DATA), max_size=4))
def test_whole_packets_in_a_row_are_all_found(packets):
    stream = b"".join(codec.packet(each, 0, data) for each, data in packets)

    assert codec.statuses_in(stream) == [Status(each, 0, data) for each, data in packets]


@given(DATA.filter(lambda noise: b"\xff" not in noise), st.integers(0, 253), DATA)
def test_noise_before_a_packet_does_not_hide_it(noise, servo_id, data):
    assert codec.statuses_in(noise + codec.packet(servo_id, 0, data)) == [Status(servo_id, 0, data)]


@given(DATA, st.data())
def test_one_wrong_bit_is_never_taken_for_an_answer(data, draw):
    raw = bytearray(codec.packet(7, 0, data))
    at = draw.draw(st.integers(2, len(raw) - 1))
    raw[at] ^= 1 << draw.draw(st.integers(0, 7))

    assert Status(7, 0, data) not in codec.statuses_in(bytes(raw))


@pytest.mark.parametrize("dialect", [STS, SCS])
@given(value=st.integers(-1023, 1023))
def test_what_is_encoded_is_decoded(dialect, value):
    data = dialect.encode("present_load", value)

    assert dialect.decode("present_load", data, 60) == value


def test_a_minus_is_a_bit_and_not_a_complement():
    assert STS.encode("goal_position", -100) == b"\x64\x80"
    assert STS.encode("homing_offset", -100) == b"\x64\x08"
    assert SCS.encode("goal_position", 300) == b"\x01\x2c"


def test_a_model_is_known_by_its_bytes_whatever_their_order():
    assert model_name(b"\x09\x03") == "STS3215"
    assert model_name(b"\x05\x04") == "SCS0009"
    assert model_name(b"\x01\x02") == "unknown model 1.2"


@pytest.mark.parametrize("dialect", [STS, SCS])
def test_a_prepared_sync_write_is_that_made_block_by_block(dialect):
    goals = {1: 0, 7: 515, 200: 1023}
    speeds = {1: 1, 7: 683, 200: 3000}
    blocks = [
        (each, dialect.encode("goal_position", goals[each]) + bytes(2)
        + dialect.encode("goal_speed", speeds[each]))
        for each in goals
    ]  # fmt: skip
    prepared = GoalWrite([*goals], 42, dialect.byte_order)
    values = [np.array([*each.values()], float) for each in (goals, speeds)]

    assert prepared.request(*values) == codec.sync_write(42, 6, blocks)


def test_more_goals_than_a_packet_holds_go_in_several():
    ids = list(range(1, 80))
    frames = list(packets_in(GoalWrite(ids, 42, "little").request(np.arange(79), np.full(79, 9))))
    told = [frame.data[at] for frame, _ in frames for at in range(2, len(frame.data), 7)]

    assert [len(frame.data) for frame, _ in frames] == [2 + 7 * 35, 2 + 7 * 35, 2 + 7 * 9]
    assert told == ids


@given(st.integers(0, 60), st.binary(min_size=1, max_size=30))
def test_only_torque_writes_the_torque_register(address, data):
    """128 in it would make the present place the middle."""
    reaches = address <= 40 < address + len(data)
    if reaches:
        with pytest.raises(ValueError, match="torque"):
            codec.write(1, address, data)
        with pytest.raises(ValueError, match="torque"):
            codec.sync_write(address, len(data), [(1, data)])
    else:
        assert codec.write(1, address, data)[4] == Instruction.WRITE


def test_torque_is_off_or_on_and_nothing_else():
    assert codec.torque((3,), on=True)[5:-1] == b"\x28\x01\x03\x01"
    assert codec.torque((3, 4), on=False)[5:-1] == b"\x28\x01\x03\x00\x04\x00"
    assert codec.torque((), on=False)[2:-1] == b"\xfe\x04\x03\x28\x00"


def test_an_answer_of_all_is_undisturbed_or_not():
    span = SpanRead((1, 2), 56, 3)
    stream = codec.packet(1, 0, b"abc") + codec.packet(2, 0x20, b"\xff\xffx")

    assert span.is_undisturbed(stream)
    for at in range(len(stream)):
        broken = stream[:at] + bytes((stream[at] ^ 4,)) + stream[at + 1 :]
        # An error bit and the checksum hang together; every other byte is checked too.
        assert not span.is_undisturbed(broken)
    assert not span.is_undisturbed(stream[:-1])
