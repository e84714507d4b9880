"""What avatars are sent while a face runs, over real sockets on this computer."""

import socket
from contextlib import ExitStack
from types import SimpleNamespace

import pytest

from lipservo.runtime.avatar_stream import avatar_stream, entered_avatars, resolved_avatars
from lipservo.runtime.run_request import AvatarError, AvatarTargets
from lipservo.runtime.status.street_tick import StreetTick
from lipsync.animpho.units import load_face_with_animphos
from lipsync.face.frame import Expression, Frame

osc_bundle = pytest.importorskip("pythonosc.osc_bundle")
livelink = pytest.importorskip("pylivelinkface")

MODEL = load_face_with_animphos()
OPEN = max(MODEL.animphos.frames, key=MODEL.lip_gap_mm)


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        end.settimeout(5.0)
        yield end


def place(receiver):
    return "{}:{}".format(*receiver.getsockname())


def tick(time_s, coefficients=OPEN, expression=None):
    frame = Frame(time_s - 0.2, coefficients, expression or Expression())
    return StreetTick(time_s - 0.2, "AA", frame, SimpleNamespace(time_s=time_s))


def waiting(receiver):
    """All datagrams that have come."""
    receiver.setblocking(False)
    found = []
    try:
        while True:
            found.append(receiver.recv(2048))
    except BlockingIOError:
        return found


def shapes(packet):
    return {m.params[0]: m.params[1] for m in osc_bundle.OscBundle(packet) if m.params}


def test_both_kinds_of_receivers_get_the_frame_and_at_the_end_the_closed_mouth(receiver):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with avatar_stream(AvatarTargets(place(receiver), place(other))) as stream:
            stream.observe(tick(1.0))
            assert shapes(receiver.recv(2048))["jawOpen"] > 0.4
        assert stream.n_sent == 4
        assert stream.n_failed == 0
        faces = [livelink.PyLiveLinkFace.decode(packet)[1] for packet in waiting(other)]
    jaw = livelink.FaceBlendShape.JawOpen
    assert [face.get_blendshape(jaw) > 0.4 for face in faces] == [True, False]
    (closed,) = waiting(receiver)
    assert set(shapes(closed).values()) == {0.0}


@pytest.mark.parametrize(("rate_hz", "n_frames"), [(30, 31), (60, 61), (100, 60), (200, 60)])
def test_a_second_of_ticks_is_60_datagrams_at_most(receiver, rate_hz, n_frames):
    with avatar_stream(AvatarTargets(osc=place(receiver))) as stream:
        for n in range(rate_hz + 1):
            stream.observe(tick(10.0 + n / rate_hz))
        assert abs(stream.n_sent - n_frames) <= 1
        assert stream.n_sent <= 61


def test_ticks_that_come_late_are_not_made_up_for(receiver):
    with avatar_stream(AvatarTargets(osc=place(receiver))) as stream:
        for time_s in (0.0, 5.0, 5.005, 5.01):
            stream.observe(tick(time_s))
        assert stream.n_sent == 2


def test_eyes_are_sent_once_anything_was_said_of_them(receiver):
    with avatar_stream(AvatarTargets(osc=place(receiver))) as stream:
        stream.observe(tick(0.0))
        stream.observe(tick(0.1, expression=Expression(lid_left=1.0)))
        stream.observe(tick(0.2))
        first, second, third = (shapes(each) for each in waiting(receiver))
    assert "eyeBlinkLeft" not in first
    assert second["eyeBlinkLeft"] == 1.0
    assert third["eyeBlinkLeft"] == 0.0


def test_nobody_there_stops_nothing(receiver):
    target = place(receiver)
    receiver.close()
    with avatar_stream(AvatarTargets(osc=target, live_link=target)) as stream:
        for n in range(40):
            stream.observe(tick(n / 60))
    assert stream.n_sent + stream.n_failed == 82
    assert stream.n_failed > 0


def test_without_targets_nothing_is_sent():
    with avatar_stream(AvatarTargets()) as stream:
        stream.observe(tick(0.0))
    assert stream.n_sent == stream.n_failed == 0


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("", "write HOST:PORT, such as 127.0.0.1:11111"),
        (":39540", "write HOST:PORT, such as 127.0.0.1:11111"),
        ("two words", "write HOST:PORT"),
        ("line\nline:1", "write HOST:PORT"),
        ("localhost:", "write HOST:PORT, such as localhost:11111"),
        ("localhost:osc", "write HOST:PORT"),
        ("localhost:²", "write HOST:PORT"),
        ("::1", "write HOST:PORT"),
        ("localhost:0", "1 to 65535"),
        ("localhost:70000", "1 to 65535"),
        (f"localhost:{'9' * 5000}", "1 to 65535"),
    ],
)
def test_what_is_no_address_is_told_in_one_line(target, said):
    with pytest.raises(AvatarError, match=said) as raised:
        AvatarTargets(live_link=target)
    assert str(raised.value).startswith("--live-link ")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("target", ["no-such-host.invalid:39540", f"{'a' * 300}"])
def test_a_host_that_is_none_is_told_in_one_line(target):
    targets = AvatarTargets(osc=target)
    for sends in (lambda: avatar_stream(targets).__enter__(), lambda: resolved_avatars(targets)):
        with pytest.raises(AvatarError, match=r"^--osc .*: no such host \(") as raised:
            sends()
        assert "\n" not in str(raised.value)


def test_a_process_that_speaks_goes_on_where_a_host_is_not_to_be_found_any_more(caplog):
    with ExitStack() as stack:
        found = entered_avatars(AvatarTargets("no-such-host.invalid"), None, stack)
    assert found is None
    (line,) = caplog.messages
    assert "no-such-host.invalid" in line
    assert entered_avatars(AvatarTargets(), None, ExitStack()) is None


def test_without_a_port_that_of_the_protocol_is_taken_and_hosts_become_numbers():
    assert resolved_avatars(AvatarTargets("localhost", "localhost")) == AvatarTargets(
        "127.0.0.1:39540", "127.0.0.1:11111"
    )
    assert resolved_avatars(AvatarTargets(live_link="localhost:4000")) == AvatarTargets(
        live_link="127.0.0.1:4000"
    )


def test_an_avatar_with_vowels_gets_them_and_no_shape_of_arkits_mouth(receiver):
    targets = resolved_avatars(AvatarTargets(osc=place(receiver) + "/vowels"))
    with avatar_stream(targets) as stream:
        stream.observe(tick(0.0, expression=Expression(lid_left=1.0)))
        spoken = shapes(receiver.recv(2048))
    (closed,) = waiting(receiver)
    assert set(spoken) == {*"AIUEO", "eyeBlinkLeft"}
    assert 0.4 < sum(spoken[vowel] for vowel in "AIUEO") <= 1.0
    assert sum(shapes(closed)[vowel] for vowel in "AIUEO") == 0.0
