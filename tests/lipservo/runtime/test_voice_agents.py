"""A daemon that voice agents speak through, as a process: its port, its end, and a shot process."""

import json
import os
import signal
import socket
import subprocess
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from lipservo_client.protocol import FaceError
from running_daemon import (
    LIPSERVO,
    PATIENCE_S,
    all_driven,
    child,
    own_folder,
    run,
    running,
    wait_for,
)

import lipservo
from firmware_bridge.process.control_client import ask
from lipservo.access.token_file import read_token
from lipservo.runtime.requested_face import RequestedFace
from lipservo.runtime.run_request import SILENCE, RunRequest, VoiceOptions
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.runtime.voice_agents import bound_listener, voice_agents
from lipservo.settings.sections import SoundSettings
from lipsync.audio.playout import Playout
from lipsync.errors import UserError

RATE_HZ = 24_000


def vowel(duration_s):
    """Something between an A and a buzz, as s16le."""
    time_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    tones = sum(np.sin(2 * np.pi * f * time_s) / n for n, f in enumerate((120, 720, 1200), 1))
    return (8_000 * tones).astype("<i2").tobytes()


@contextmanager
def speaking(folder, *arguments):
    """A `lipservo daemon` with the simulated face in one process, once it answers."""
    with (folder / "said.txt").open("w") as log:
        process = subprocess.Popen(
            [*LIPSERVO, "daemon", "--listen", "127.0.0.1:0", *arguments], stdout=log, stderr=log
        )
        process.said = folder / "said.txt"
        try:
            wait_for(lambda: process.poll() is not None or status_of_any())
            yield process
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


def status_of_any():
    done = [ask_status(path) for path in faces()]
    return next((each for each in done if each), None)


def faces():
    return list(Path(os.environ["XDG_RUNTIME_DIR"], "lipservo").glob("*.sock"))


def ask_status(path):
    try:
        return ask(path, "status", PATIENCE_S)
    except OSError:
        return None


def is_open(url):
    host, _, port = url.removeprefix("ws://").partition(":")
    with socket.socket() as client:
        return client.connect_ex((host, int(port))) == 0


def test_a_daemon_tells_where_it_listens_is_spoken_through_and_stopped(tmp_path, monkeypatch):
    own_folder(monkeypatch)
    with speaking(tmp_path) as process:
        (face,) = json.loads(run("status", "--json").stdout)["faces"]
        url = face["listens_on"]
        assert url.startswith("ws://127.0.0.1:")
        with lipservo.connect(url) as agent:
            with (
                pytest.raises(FaceError, match="no loudspeaker") as silent,
                agent.stream(sample_rate=RATE_HZ) as speech,
            ):
                speech.write(vowel(0.1))
            assert silent.value.code == "no_loudspeaker"
            played = _said(agent, vowel(0.5))
            assert (played.finished, played.played_s) == (True, pytest.approx(0.5))
            agent.stop(end=True)
        assert process.wait(PATIENCE_S) == 0
        assert not is_open(url)
        assert faces() == []


@pytest.mark.slow
def test_a_speech_process_that_is_shot_while_an_agent_speaks_leaves_a_port_that_answers(
    tmp_path, monkeypatch
):
    own_folder(monkeypatch)
    with (
        simulated_port(["--config", "face_sim", "--on-time"]) as port,
        running(port, tmp_path, "--config", "face_sim", "--listen", "127.0.0.1:0") as process,
    ):
        wait_for(lambda: all_driven(process))
        wait_for(lambda: ask(process.control, "status", PATIENCE_S).get("listens_on"))
        url = ask(process.control, "status", PATIENCE_S)["listens_on"]
        first = child(process, "speech")
        n_stale = ask(process.control, "status", PATIENCE_S)["n_stale"]
        with pytest.raises(FaceError):
            _speak_until(url, lambda: os.kill(first, signal.SIGKILL))
        # The bridge, which hears nothing more, takes the mouth to rest by itself.
        wait_for(lambda: ask(process.control, "status", PATIENCE_S)["n_stale"] > n_stale)
        wait_for(lambda: child(process, "speech") != first)
        wait_for(lambda: _answers(url))
        with lipservo.connect(url) as agent:
            assert _said(agent, vowel(0.3)).finished
            assert agent.status()["listens_on"] == url
            agent.stop(end=True)
        process.wait(PATIENCE_S)
        assert not is_open(url)


def _said(agent, samples):
    """What was heard of them."""
    with agent.stream(sample_rate=RATE_HZ, playback="client") as speech:
        speech.write(samples)
        return speech.wait()


def _speak_until(url, shoot):
    """Do it in the middle of a word."""
    with (
        lipservo.connect(url) as agent,
        agent.stream(sample_rate=RATE_HZ, playback="client") as speech,
    ):
        events = agent.events()
        speech.write(vowel(10.0))
        next(each for each in events if each["type"] == "position" and each["n_played"])
        shoot()
        speech.wait()


def _answers(url):
    try:
        with lipservo.connect(url) as agent:
            return bool(agent.status())
    except FaceError:
        return False


def test_nobody_is_waited_for_where_a_face_listens_nowhere():
    assert bound_listener("none", None) is None


def test_a_speech_process_that_finds_no_token_any_more_serves_none_and_goes_on(tmp_path, caplog):
    """The folder of a login is gone once its user has logged out; the face goes on."""
    side = SimpleNamespace(voice=object(), speech=SimpleNamespace(delay=None))
    voice = VoiceOptions(token_file=str(tmp_path / "gone"))
    requested = RequestedFace(RunRequest("face_jaw", SILENCE, voice=voice))
    with (
        bound_listener("127.0.0.1:0", None) as listener,
        voice_agents(listener, side, requested) as url,
    ):
        assert url is None
    (line,) = caplog.messages
    assert "none are served" in line


@pytest.mark.parametrize(("n_channels", "level"), [(1, 0.1), (2, 0.2)])
def test_a_file_that_an_agent_lets_play_sounds_by_the_channel_of_the_face(
    tmp_path, n_channels, level
):
    """One that has no such channel is played as it is."""
    soundfile.write(tmp_path / "line.wav", np.tile([0.1, 0.2][:n_channels], (8_000, 1)), 16_000)
    voice = VoiceOptions(sounds=str(tmp_path))
    requested = RequestedFace(RunRequest("face_jaw", SILENCE, voice=voice))
    sound = SoundSettings(channel="right")
    requested.settings = requested.settings.model_copy(update={"sound": sound})
    playout = Playout()
    side = SimpleNamespace(
        voice=SimpleNamespace(playout=playout),
        speech=SimpleNamespace(delay=SimpleNamespace(total_s=0.0)),
    )
    with (
        bound_listener("127.0.0.1:0", None) as listener,
        voice_agents(listener, side, requested) as url,
        lipservo.connect(url) as agent,
    ):
        agent.play("line.wav")
        wait_for(lambda: playout.requests[0].stream.ended)
        playout.advance(0.0)
        heard = np.concatenate([block.samples for block in playout.blocks(0.5)])

    assert heard.max() == pytest.approx(level, abs=1e-3)


def test_a_second_face_takes_another_port():
    first, second = bound_listener(None, None), bound_listener(None, None)
    with first, second:
        assert first.getsockname() != second.getsockname()
        assert second.getsockname()[0] == "127.0.0.1"


def test_a_token_is_the_first_line_of_its_file(tmp_path):
    path = tmp_path / "token"
    path.write_text("  secret \nmore\n")
    assert read_token(str(path)) == "secret"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(UserError, match="cannot be read as a token"):
        read_token(str(path))
