"""Packets: the e-manual's own examples, properties, and the vendor's SDK as the other opinion."""

import random
import struct

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from places import DATA

from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import FrameParser

GOLDEN = {
    name: bytes.fromhex(text)
    for name, text in yaml.safe_load((DATA / "golden_packets.yaml").read_text()).items()
}
MADE = {
    "ping id1": codec.ping(1),
    "ping broadcast": codec.ping(codec.BROADCAST_ID),
    "status ping id1 1030 fw38": codec.status(1, 0, struct.pack("<HB", 1030, 38)),
    "read id1 132 4": codec.read(1, 132, 4),
    "status read 166": codec.status(1, 0, struct.pack("<i", 166)),
    "write id1 116=512": codec.write(1, 116, struct.pack("<i", 512)),
    "status ok id1": codec.status(1),
    "reg_write id1 104=200": codec.packet(1, codec.Instruction.REG_WRITE, b"\x68\0\xc8\0\0\0"),
    "action id1": codec.packet(1, codec.Instruction.ACTION),
    "factory_reset id1 opt1": codec.packet(1, codec.Instruction.FACTORY_RESET, b"\1"),
    "reboot id1": codec.reboot(1),
    "clear id1": codec.packet(1, codec.Instruction.CLEAR, bytes.fromhex("0144584C22")),
    "sync_read 132 4 [1,2]": codec.sync_read([1, 2], 132, 4),
    "sync_write 116 1=150 2=170": codec.sync_write(
        116, 4, [(1, struct.pack("<i", 150)), (2, struct.pack("<i", 170))]
    ),
    "bulk_read 1:144/2 2:146/1": codec.packet(
        codec.BROADCAST_ID,
        codec.Instruction.BULK_READ,
        struct.pack("<BHHBHH", 1, 144, 2, 2, 146, 1),
    ),
}
#: Bytes as noise would have them, and bytes chosen to look like headers and stuffing.
nasty = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0xFE, 0x55]), max_size=60).map(bytes)
payloads = st.binary(max_size=60) | nasty


@pytest.mark.parametrize("name", GOLDEN)
def test_packets_are_those_printed_in_the_manual(name):
    assert MADE[name] == GOLDEN[name]


@pytest.mark.parametrize("name", GOLDEN)
def test_printed_packets_are_read_back(name):
    (frame,) = FrameParser().feed(GOLDEN[name])

    assert frame.raw == GOLDEN[name]
    assert codec.packet(frame.packet_id, frame.instruction, frame.parameters) == GOLDEN[name]


@given(st.integers(0, 252), payloads)
def test_what_is_packed_is_parsed(servo_id, data):
    (frame,) = FrameParser().feed(codec.status(servo_id, 0, data))

    assert (frame.packet_id, frame.parameters) == (servo_id, b"\0" + data)


@given(payloads)
def test_no_packet_contains_a_second_header(data):
    assert codec.HEADER not in codec.status(1, 0xFF, data)[4:-2]


@given(payloads)
def test_unstuffing_undoes_stuffing(data):
    assert codec.unstuff(codec.stuff(data)) == data


def test_minus_one_current_followed_by_fd_survives_the_reply():
    """present_current = -1 is FF FF; FD behind it must be stuffed and unstuffed.

    https://github.com/pollen-robotics/rustypot/issues/121
    """
    data = struct.pack("<hi", -1, 0xFD)
    raw = codec.status(1, 0, data)

    assert b"\xff\xff\xfd\xfd" in raw
    assert FrameParser().feed(raw)[0].parameters[1:] == data


@given(st.lists(payloads, min_size=1, max_size=6), st.data())
def test_the_stream_may_come_in_any_pieces(contents, data):
    stream = b"".join(codec.status(n + 1, 0, each) for n, each in enumerate(contents))
    parser, frames, at = FrameParser(), [], 0
    while at < len(stream):
        size = data.draw(st.integers(1, 30))
        frames += parser.feed(stream[at : at + size])
        at += size

    assert [frame.parameters[1:] for frame in frames] == contents
    assert (parser.n_bad, parser.pending) == (0, b"")


@given(st.binary(max_size=300) | nasty)
def test_garbage_never_raises_and_is_not_hoarded(noise):
    parser = FrameParser()
    for _ in range(5):
        parser.feed(noise)

    assert len(parser.pending) <= codec.MAX_LENGTH + 7


def damaged(raw, rng):
    """One packet after one mishap: a flipped bit, a lost, an added or a cut off part."""
    kind, at = rng.randrange(4), rng.randrange(len(raw))
    if kind == 0:
        return raw[:at] + bytes((raw[at] ^ 1 << rng.randrange(8),)) + raw[at + 1 :]
    if kind == 1:
        return raw[:at] + raw[at + 1 :]
    if kind == 2:
        return raw[:at] + bytes((rng.randrange(256),)) + raw[at:]
    return raw[:at]


def check_damage(n_streams, seed):
    """A damaged packet costs that packet and no other, wherever it is.

    But for one in 65,536 of the damaged ones, whose CRC holds by chance: 16 bits tell no more.
    """
    rng = random.Random(seed)
    n_by_chance = 0
    for _ in range(n_streams):
        packets = [codec.status(n, 0, nasty_bytes(rng)) for n in range(10)]
        victim = rng.randrange(9)
        packets[victim] = damaged(packets[victim], rng)
        frames = FrameParser().feed(b"".join(packets))
        others = [n for n in range(10) if n != victim]
        found = [f.packet_id for f in frames if f.packet_id != victim]
        n_by_chance += found != others
        assert found == others or victim in [f.packet_id for f in frames]
    assert n_by_chance <= 1 + 5 * n_streams / 65_536


def nasty_bytes(rng):
    if rng.random() < 0.5:
        return rng.randbytes(rng.randrange(16))
    return bytes(rng.choices((0xFF, 0xFD, 0x00, 0x55), k=rng.randrange(16)))


def test_a_damaged_packet_costs_that_packet_only():
    check_damage(1_000, seed=1)


@pytest.mark.slow
def test_a_million_packets_survive_the_trip_and_damage_costs_one_each():
    rng = random.Random(2)
    parser = FrameParser()
    for _ in range(10_000):
        contents = [nasty_bytes(rng) for _ in range(50)]
        frames = parser.feed(b"".join(codec.status(n, 0, c) for n, c in enumerate(contents)))
        assert [frame.parameters[1:] for frame in frames] == contents
    check_damage(50_000, seed=3)


@given(
    st.lists(
        st.tuples(st.integers(0, 252), st.integers(0, 255), st.binary(min_size=10, max_size=10)),
        min_size=1,
        max_size=20,
    )
)
def test_a_fast_reply_is_taken_apart(blocks):
    frame = codec.fast_status(blocks)

    assert codec.split_fast_status(frame, 10) == blocks
    assert [f.raw for f in FrameParser().feed(frame)] == [frame]


def test_a_truncated_fast_reply_keeps_its_whole_blocks():
    """A silent servo cuts the frame off; https://github.com/robohouse-delft/dynamixel2-rs/issues/37"""
    blocks = [(n, 0, bytes(range(n, n + 10))) for n in range(5)]
    frame = codec.fast_status(blocks)

    assert codec.split_fast_status(frame[: 8 + 3 * 14 + 5], 10) == blocks[:3]
    assert codec.split_fast_status(b"", 10) == []


def test_a_damaged_fast_reply_keeps_the_blocks_before_the_damage():
    blocks = [(n, 0, bytes(10)) for n in range(5)]
    frame = bytearray(codec.fast_status(blocks))
    frame[8 + 2 * 14 + 4] ^= 0x10

    assert codec.split_fast_status(bytes(frame), 10) == blocks[:2]


def test_too_much_for_one_packet_is_refused():
    with pytest.raises(ValueError, match="too many for one packet"):
        codec.write(1, 0, bytes(70_000))


class CapturePort:
    """A port of the SDK that keeps what is written; dynamixel-sdk is the other opinion here."""

    def __init__(self):
        self.is_using = False
        self.written = b""

    def clearPort(self):  # noqa: N802 - the SDK's name
        pass

    def writePort(self, packet):  # noqa: N802 - the SDK's name
        self.written = bytes(packet)
        return len(packet)


def sdk_bytes(servo_id, instruction, parameters):
    from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

    port = CapturePort()
    length = len(parameters) + 3
    head = [0, 0, 0, 0, servo_id, length & 0xFF, length >> 8, instruction]
    Protocol2PacketHandler().txPacket(port, head + list(parameters) + [0, 0])
    return port.written


@given(st.integers(0, 254), st.sampled_from([1, 2, 3, 8, 0x82, 0x83, 0x8A]), payloads)
def test_the_sdk_sends_the_same_bytes_but_for_its_known_fault(servo_id, instruction, parameters):
    """Known fault: dynamixel-sdk 4.1.0 computes the stuffing and sends the packet without it."""
    theirs = sdk_bytes(servo_id, instruction, parameters)
    if b"\xff\xff\xfd" in parameters:
        assert theirs != codec.packet(servo_id, instruction, parameters)
    else:
        assert theirs == codec.packet(servo_id, instruction, parameters)


def test_the_sdk_does_not_stuff_what_it_sends():
    """The worked case: goal current -1 and goal velocity -3 in one write."""
    data = struct.pack("<hi", -1, -3)
    theirs = sdk_bytes(1, codec.Instruction.WRITE, struct.pack("<H", 102) + data)

    assert theirs.endswith(bytes.fromhex("6600ffff fdffffff5e16"))
    assert codec.write(1, 102, data).endswith(bytes.fromhex("6600ffff fdfdffffff0935"))


@given(payloads)
def test_the_sdk_unstuffs_what_we_stuff_but_for_its_known_fault(data):
    """Known fault: removeStuffing works in place and looks back at bytes it has already moved.

    Behind the first stuffed place it takes FF FD FD for another.
    """
    from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

    raw = codec.status(1, 0, data)
    theirs = bytes(Protocol2PacketHandler().removeStuffing(list(raw)))
    length = int.from_bytes(theirs[5:7], "little")
    if b"\xff\xfd\xfd" not in raw[8:-1].partition(b"\xff\xff\xfd\xfd")[2]:
        assert theirs[9 : 5 + length] == data
    assert codec.unstuff(raw[8:-2]) == b"\0" + data
