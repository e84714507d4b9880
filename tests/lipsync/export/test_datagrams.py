"""Datagrams for avatars, read by other people's libraries."""

import struct

import numpy as np
import pytest

from lipsync.export.arkit import ARKIT_NAMES, MOUTH_NAMES
from lipsync.export.weight_track import MOST_BYTES, live_link_packet, osc_message, vmc_packets

osc_bundle = pytest.importorskip("pythonosc.osc_bundle")
livelink = pytest.importorskip("pylivelinkface")


def told(packet):
    """(address, arguments) of each message of a bundle, as python-osc reads it."""
    return [(message.address, message.params) for message in osc_bundle.OscBundle(packet)]


def test_a_message_is_that_of_the_specifications_example():
    """OSC 1.0, "Examples": /oscillator/4/frequency with the float 440."""
    expected = b"/oscillator/4/frequency\x00,f\x00\x00" + struct.pack(">f", 440.0)
    assert osc_message("/oscillator/4/frequency", 440.0) == expected


def test_a_mouth_is_one_datagram_that_python_osc_reads():
    values = [(name, i / 16) for i, name in enumerate(MOUTH_NAMES)]
    (packet,) = vmc_packets(values)
    *shapes, apply = told(packet)
    assert shapes == [("/VMC/Ext/Blend/Val", list(pair)) for pair in values]
    assert apply == ("/VMC/Ext/Blend/Apply", [])


def test_all_52_are_told_in_datagrams_that_pass_an_ethernet_and_are_applied_last():
    packets = vmc_packets((name, 0.5) for name in ARKIT_NAMES)
    assert all(len(packet) <= MOST_BYTES for packet in packets)
    messages = [message for packet in packets for message in told(packet)]
    assert [params[0] for _, params in messages[:-1]] == list(ARKIT_NAMES)
    assert [address for address, _ in messages].index("/VMC/Ext/Blend/Apply") == 52


def test_a_live_link_packet_is_read_by_pylivelinkface():
    values = np.arange(52) / 64.0
    is_face, face = livelink.PyLiveLinkFace.decode(live_link_packet(values, "robot", 2.5 + 1 / 240))
    assert is_face
    assert (face.name, face.fps, face._version) == ("robot", 60, 6)
    assert (face._frames, face._denominator) == (150, 1)
    assert face._sub_frame == pytest.approx(0.25, abs=1e-6)
    for name, value in zip(ARKIT_NAMES, values, strict=True):
        shape = livelink.FaceBlendShape[name[0].upper() + name[1:]]
        assert face.get_blendshape(shape) == value
    assert face.get_blendshape(livelink.FaceBlendShape.HeadYaw) == 0.0


def test_times_before_the_first_sound_and_after_a_year_can_be_sent():
    for time_s in (-0.3, 500 * 86_400.0):
        assert livelink.PyLiveLinkFace.decode(live_link_packet(np.zeros(52), "a", time_s))[0]
