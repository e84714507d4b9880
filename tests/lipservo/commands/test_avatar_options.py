"""`--osc` and `--live-link`: what a screen avatar gets while the robot's face runs."""

import socket
from importlib import resources

import pytest
from in_process import lipservo, refused
from speech import clip_start

livelink = pytest.importorskip("pylivelinkface")
osc_bundle = pytest.importorskip("pythonosc.osc_bundle")
pytestmark = pytest.mark.usefixtures("own_folder")


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        end.setblocking(False)
        yield end


@pytest.fixture
def phrase(tmp_path):
    return clip_start(tmp_path, 1.0)


def waiting(receiver):
    found = []
    try:
        while True:
            found.append(receiver.recv(2048))
    except BlockingIOError:
        return found


def jaws_of_live_link(packets):
    faces = [livelink.PyLiveLinkFace.decode(packet)[1] for packet in packets]
    return [face.get_blendshape(livelink.FaceBlendShape.JawOpen) for face in faces]


def jaws_of_osc(packets):
    messages = (m for packet in packets for m in osc_bundle.OscBundle(packet) if m.params)
    return [m.params[1] for m in messages if m.params[0] == "jawOpen"]


def named_in_yaml(folder, key, target):
    """What is typed for a face whose YAML names an avatar."""
    shipped = resources.files("lipservo.config") / "face_sim.yaml"
    face = folder / "face.yaml"
    face.write_text(f"{shipped.read_text()}\navatars: {{{key}: '{target}'}}\n")
    return ["--config", str(face)]


@pytest.mark.parametrize(
    ("key", "jaws_of"), [("osc", jaws_of_osc), ("live_link", jaws_of_live_link)]
)
def test_an_avatar_speaks_with_the_robot_and_closes_its_mouth_at_the_end(
    receiver, phrase, key, jaws_of, tmp_path
):
    at = "{}:{}".format(*receiver.getsockname())
    given = ["--osc", at] if key == "osc" else named_in_yaml(tmp_path, key, at)
    done = lipservo("run", "--wav", phrase, *given, "--json")

    assert done.returncode == 0, done.stderr
    jaws = jaws_of(waiting(receiver))
    assert 20 < len(jaws) < 60 * 3, "a second of speech and its tail, 60 a second at most"
    assert max(jaws) > 0.2
    assert jaws[-1] == 0.0


def test_a_text_that_is_said_is_shown_there_too(receiver):
    at = "{}:{}".format(*receiver.getsockname())
    done = lipservo("say", "Papa.", "--mute", "--live-link", at, "--quiet")

    assert done.returncode == 0, done.stderr
    jaws = jaws_of_live_link(waiting(receiver))
    assert max(jaws) > 0.1
    assert jaws[-1] == 0.0


def test_nobody_who_listens_there_is_no_reason_to_stop(phrase):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
        gone.bind(("127.0.0.1", 0))
        at = "{}:{}".format(*gone.getsockname())
    done = lipservo("run", "--wav", phrase, "--osc", at, "--quiet")

    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("option", ["--osc", "--live-link"])
@pytest.mark.parametrize("target", ["localhost:port", "no-such-host.invalid"])
@pytest.mark.parametrize(
    "command",
    [
        ["run"],
        ["say", "Hello.", "--mute"],
        ["daemon", "--listen", "none"],
        ["daemon", "--listen", "none", "--port", "/dev/no_such_port"],
    ],
)
def test_a_bad_address_is_refused_in_one_line_before_a_servo_is_spoken_to(
    command, target, option, tmp_path
):
    given = [option, target]
    if command[0] == "daemon" or (command[0], option) == ("run", "--live-link"):
        given = named_in_yaml(tmp_path, option[2:].replace("-", "_"), target)
    assert refused(*command, *given).startswith(f"lipservo: {option} '{target}': ")
