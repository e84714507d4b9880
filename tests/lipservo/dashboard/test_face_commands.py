"""The words that a face hears, and what becomes of commands that are none."""

import asyncio
import json
import socket
import threading

import pytest
from lipservo_client.protocol import FaceError
from places import short_folder

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.web.api_models import StopBody
from lipservo.dashboard.web.stop_route import stop_face


class Ear:
    """Writes down every word, and answers with its name."""

    def __enter__(self):
        self.path = short_folder() / "ear.sock"
        self.words = []
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(str(self.path))
        self._listener.listen()
        threading.Thread(target=self._hear, daemon=True).start()
        return self

    def __exit__(self, *exc):
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _hear(self):
        """Answer one word of each client, and keep it; in a thread until the socket is closed."""
        try:
            while True:
                client, _ = self._listener.accept()
                with client:
                    self.words.append(client.recv(4096).decode())
                    client.send(json.dumps({"heard": True}).encode())
        except OSError:
            return


def heard(do):
    """The words that reach a face by one command."""
    with Ear() as ear:
        commands = FaceLink(lambda: ear.path)
        try:
            asyncio.run(do(commands))
        finally:
            commands.close()
        return ear.words


@pytest.mark.parametrize(
    ("do", "word"),
    [
        (lambda face: stop_face(face, StopBody()), "soft"),
        (lambda face: stop_face(face, StopBody(level="limp")), "limp"),
        (lambda face: stop_face(face, StopBody(level="soft", end=True)), "soft end"),
        (lambda face: face.start(), "start"),
        (lambda face: face.change({"strength": 0.5}), "set strength 0.5"),
        (lambda face: face.change({"a": 1, "b": 1e-9}), "set a 1.0 b 1e-09"),
        (lambda face: face.servo("jaw", "reboot"), "servo jaw reboot"),
        (lambda face: face.jog_arm(), "jog arm"),
        (lambda face: face.jog("jaw", -1.5), "jog jaw -1.5"),
        (lambda face: face.jog_end(), "jog end"),
        (
            lambda face: face.look_at(5, -2),
            "set look_yaw_deg 5.0 look_pitch_deg -2.0 look_weight 1.0",
        ),
        (lambda face: face.look_at(None), "set look_weight 0.0"),
    ],
)
def test_a_command_is_one_word(do, word):
    assert heard(do) == [word]


def test_a_mood_says_when_it_was_set():
    (word,) = heard(lambda face: face.affect(0.5, -0.25, 10.0))
    words = word.split()
    assert words[:7] == ["set", "affect_valence", "0.5", "affect_arousal", "-0.25", "affect_tau_s",
                         "10.0"]  # fmt: skip
    assert words[7] == "affect_at_s"
    assert float(words[8]) > 0.0


@pytest.mark.parametrize(
    "do",
    [
        lambda face: face.change({}),
        lambda face: face.change({"strength": float("nan")}),
        lambda face: face.change({"strength": float("inf")}),
        lambda face: face.change({"strength 1 other": 1.0}),
        lambda face: face.change({"": 1.0}),
        lambda face: face.change({"a" * 5000: 1.0}),
        lambda face: face.servo("jaw", "explode"),
        lambda face: face.servo("jaw off\nlimp", "off"),
        lambda face: face.servo("ja\0w", "off"),
        lambda face: face.jog("jaw", float("nan")),
        lambda face: face.jog("arm me", 1.0),
        lambda face: face.say("hello"),
    ],
)
def test_what_is_no_command_reaches_no_face(do):
    async def refused(face):
        with pytest.raises(FaceError) as raised:
            await do(face)
        assert len(str(raised.value).splitlines()) == 1

    assert heard(refused) == []
