"""What `doctor --listen` tells of a microphone, by speech that is spoilt in known ways."""

import json

import numpy as np
import pytest
import soundfile
from lipservo_lab.evaluation.recognition.conditions import parse_condition
from speech import CLIP_PATH
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.health import listening
from lipservo.health.listening import findings, listen
from lipservo.runtime import sound
from lipsync.audio_block import AudioBlock
from lipsync.recognition.network import load_shipped_weights

RATE_HZ = 16_000


@pytest.fixture(scope="module")
def speech():
    """19 s of a voice with pauses, with as faint a hiss as microphones have."""
    clip = np.tile(np.append(soundfile.read(CLIP_PATH, dtype="float32")[0], np.zeros(RATE_HZ)), 2)
    hiss = 1e-4 * np.random.default_rng(0).standard_normal(len(clip))
    return (0.5 * clip + hiss).astype(np.float32)


def told(samples):
    return [each.what for each in findings(samples, load_shipped_weights())]


@pytest.mark.parametrize(
    ("condition", "row"),
    [
        ("level:0", "own microphones"),
        ("white:10", "10 dB, white"),
        ("servos:10", "10 dB, babble, music or servos"),
        ("telephone", "telephone"),
        ("clipped", "clipped"),
        ("room:2.5", "a room"),
        ("level:-30", "-30 dB"),
    ],
)
def test_spoilt_speech_is_like_its_row_of_the_table(speech, condition, row):
    spoilt = parse_condition(condition).apply(speech, "talker", [])

    assert told(np.clip(spoilt, -1.0, 1.0))[-1].startswith(f"like the row {row!r} ")


def test_an_echo_is_told_with_its_delay_and_share(speech):
    repeated = speech.copy()
    repeated[1_920:] += 0.4 * speech[:-1_920]

    (echo,) = [what for what in told(repeated) if what.startswith("echo")]
    share, delay = echo.removeprefix("echo of ").split(" after ")
    assert delay == "120 ms"
    assert 30 <= int(share.removesuffix("%")) <= 45


@pytest.mark.parametrize(
    ("samples", "what"),
    [
        (np.zeros(RATE_HZ * 2), "the microphone sends nothing"),
        (np.full(RATE_HZ * 2, 0.3), "it sends one value"),
        (np.zeros(0), "the microphone sends nothing"),
        (0.1 * np.sin(np.arange(RATE_HZ * 8) * 2 * np.pi * 50 / RATE_HZ), "0 s of speech"),
    ],
)
def test_a_broken_microphone_is_bad_and_no_row_is_named(samples, what):
    (only,) = findings(samples.astype(np.float32), load_shipped_weights())

    assert only.severity.name == "BAD"
    assert only.what.startswith(what)
    assert only.remedy


class Card:
    """A microphone that delivers 100 ms in each 100 ms of a clock that `sleep` moves."""

    name = "array"

    def __init__(self, samples):
        self.now_s, self.samples = 0.0, samples

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        pass

    def sleep(self, seconds):
        self.now_s += seconds

    def blocks(self, _until_s):
        first = round(self.now_s * RATE_HZ) - 1_600
        return [AudioBlock(self.samples[first : first + 1_600], first / RATE_HZ)]


def test_half_a_minute_is_heard_and_nothing_is_left_out(speech):
    card = Card(np.tile(speech, 2))

    np.testing.assert_array_equal(
        listen(card, lambda: card.now_s, card.sleep), np.tile(speech, 2)[: 30 * RATE_HZ]
    )


def test_the_command_listens_at_the_microphone_of_the_face(monkeypatch, speech):
    asked = []
    monkeypatch.setattr(sound, "open_microphone", lambda *of: asked.append(of) or Card(speech))
    monkeypatch.setattr(listening, "listen", lambda *_: np.zeros(RATE_HZ * 2, np.float32))
    done = CliRunner().invoke(app, ["doctor", "--listen", "--json"])

    assert done.exit_code == 1
    assert asked == [("default", "mix")]
    assert json.loads(done.stdout)["findings"][0]["what"] == "the microphone sends nothing"
