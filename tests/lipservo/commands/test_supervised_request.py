"""The processes of a daemon get the whole request, and follow what is set while they run."""

import json
import os
import signal
import socket
import struct
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest
from running_daemon import PATIENCE_S, child, own_folder, run, running, wait_for
from speech import CLIP_PATH

from firmware_bridge.process.control_client import ask
from lipservo.runtime.motion_options import MotionOptions
from lipservo.runtime.requested_face import RequestedFace
from lipservo.runtime.run_request import AvatarTargets, RunRequest, Sound, request_of_json
from lipservo.runtime.servos.sim_process import simulated_port
from lipsync.motion.finishing import Style

# Real processes in real time.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def typed(tmp_path_factory):
    """A daemon with every option it has but --sim, --mic and --quiet, and the request they make."""
    folder = tmp_path_factory.mktemp("typed")
    with (
        pytest.MonkeyPatch.context() as monkeypatch,
        simulated_port(["--config", "face_sim", "--on-time"]) as port,
        resources.as_file(resources.files("lipsync.models") / "grid_s1.npz") as model,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as avatar,
    ):
        own_folder(monkeypatch)
        avatar.bind(("127.0.0.1", 0))
        avatar.settimeout(PATIENCE_S)
        avatar_at = "{}:{}".format(*avatar.getsockname())
        control = Path(os.environ["XDG_RUNTIME_DIR"], "lipservo", "typed.sock")
        control.parent.mkdir(mode=0o700)
        written = resources.files("lipservo.config") / "face_sim.yaml"
        face = folder / "face.yaml"
        face.write_text(
            written.read_text().replace("rate_hz: 30", "rate_hz: 50")
            + "motion: {engine: energy, weights: grid, strategy: expected, lookahead_ms: 50, "
            + f"strength: 1.25, smoothness: 0.25}}\navatars: {{live_link: '{avatar_at}'}}\n"
        )
        options = ["--config", face, "--wav", CLIP_PATH, "--model", model, "--control", control]
        motion = MotionOptions("energy", "grid", "expected", Style(0.05, 1.25, 0.25))
        wanted = RunRequest(
            config=str(face),
            sound=Sound("file", str(CLIP_PATH)),
            motion=motion,
            model=model,
            port=port,
            control=control,
            as_json=True,
            avatars=AvatarTargets(live_link=avatar_at),
        )
        wanted = replace(wanted, servos=RequestedFace(wanted).servos)
        with running(port, folder, *map(str, options), "--listen", "none", "--json") as process:
            process.wanted, process.avatar = wanted, avatar
            yield process


def settings(process):
    """What the speech side says is set; {} before it has said so."""
    return ask(process.control, "status", PATIENCE_S)["settings"]


def received(process, name):
    """The request that a child was given, read from its command line in the kernel."""
    words = Path(f"/proc/{child(process, name)}/cmdline").read_bytes().decode().split("\0")
    return request_of_json(words[words.index("--request") + 1])


def test_the_children_receive_all_that_was_typed(typed):
    wait_for(lambda: settings(typed))
    status = ask(typed.control, "status", PATIENCE_S)

    assert received(typed, "bridge") == typed.wanted
    assert received(typed, "speech") == typed.wanted
    assert (status["engine"], status["weights"]) == ("energy", "grid")
    assert status["settings"] == {
        "lookahead_ms": 50.0, "strength": 1.25, "stage": 0.0, "smoothness": 0.25,
        "lip_gap_offset_mm": 0.0,
    }  # fmt: skip
    assert status["sound"] == CLIP_PATH.name


def test_an_avatar_is_sent_the_faces_of_the_process_that_hears(typed):
    """Blendshapes of Live Link Face end the datagram, 61 numbers: the jaw is the 18th."""
    wait_for(lambda: struct.unpack(">61f", typed.avatar.recv(2048)[-244:])[17] > 0.2)


def test_what_is_set_reaches_the_speech_side_and_outlives_it(typed):
    done = run("set", "strength", "0.5", "--control", str(typed.control))
    wait_for(lambda: settings(typed).get("strength") == 0.5)
    refused = run("set", "lookahead_ms", "50", "--control", str(typed.control))
    first = child(typed, "speech")
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: child(typed, "speech") != first)
    wait_for(lambda: settings(typed).get("strength") == 0.5)

    assert (done.returncode, refused.returncode) == (0, 1)
    assert "strength is 0.5 from now on" in done.stdout
    assert "there are: strength (0 to 1.5), stage (0 to 1), smoothness (0 to 1)" in refused.stderr
    assert refused.stderr.count("\n") == 1


def test_json_at_the_end_says_what_was_played(typed):
    typed.terminate()
    typed.wait(PATIENCE_S)
    told = json.loads(typed.out.read_text())

    assert len(told["confirmed"]) == 10
    said = told["face_status"]
    assert (said["strategy"], said["engine"]) == ("expected", "energy")
