"""`set` as a person types it, while a face plays; and what the face then says of itself."""

import json

import pytest
from logged import logged
from playing_face import invoke, listening, playing, status

from firmware_bridge.clock import ManualClock, MonotonicClock
from firmware_bridge.process.commands import Setting
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.motion_options import MotionOptions
from lipservo.runtime.run_request import SILENCE, RunRequest
from lipsync.audio.source import SilentSource
from lipsync.errors import UserError
from lipsync.motion.finishing import Style
from lipsync.recognition.energy_recognizer import EnergyRecognizer
from lipsync.recognition.fallback import FallbackLevel, FallbackRecognizer

pytestmark = pytest.mark.usefixtures("own_folder")


def test_a_face_says_what_it_plays_and_follows_what_is_set():
    with playing(motion=MotionOptions(style=Style(0.05, 1.2))) as outcomes:
        before = status()
        done = invoke("set", "strength", "0.25")
        in_json = invoke("set", "smoothness", "1", "--json")
        gap = invoke("set", "lip_gap_offset_mm", "-0.5")
        too_far = invoke("set", "lip_gap_offset_mm", "4")
        too_much = invoke("set", "unit_share", "1.2")
        shown = invoke("status").stdout
    (after,) = outcomes

    settings = {
        "lookahead_ms": 50.0, "strength": 1.2, "stage": 0.0, "smoothness": 0.0, "unit_share": 1.0,
        "lip_gap_offset_mm": 0.0,
    }  # fmt: skip
    said = before["strategy"], before["sound"], before["engine"], before["settings"]
    assert said == ("animpho", "silence", "network", settings)
    assert (done.exit_code, in_json.exit_code) == (0, 0)
    assert "strength is 0.25 from now on" in done.stdout
    (answer,) = json.loads(in_json.stdout)["faces"]
    assert (answer["set"], answer["value"]) == ("smoothness", 1.0)
    assert "animpho, lookahead_ms 50, strength 0.25, stage 0, smoothness 1" in shown
    changed = {"strength": 0.25, "smoothness": 1.0, "lip_gap_offset_mm": -0.5}
    assert after.status.speech.settings == settings | changed
    assert (gap.exit_code, too_far.exit_code) == (0, 1)
    assert "lip_gap_offset_mm is 4; allowed: -3 to 3" in too_far.stderr
    assert too_much.exit_code == 1
    assert "unit_share is 1.2; allowed: 0 to 1" in too_much.stderr
    assert after.summary.strategy == "animpho"
    assert after.summary.recognizer == after.status.speech.recognizer


def test_a_setting_that_a_strategy_has_not_is_refused_in_one_line():
    with playing(motion=MotionOptions(strategy="naive")):
        done = invoke("set", "smoothness", "0.5")

    assert done.exit_code == 1
    assert done.stderr.count("\n") == 1
    assert "'smoothness': no such setting; there are: " in done.stderr


def test_all_faces_are_asked_or_the_one_that_is_named_and_one_refusal_is_a_failure():
    strength = Setting(1.0, 0.0, 1.5)
    with listening("tim", settings={"strength": strength}), listening("tom"):
        both = invoke("set", "strength", "0.5", "--json")
        one = invoke("set", "strength", "0.5", "--face", "tim")
        negative = invoke("set", "strength", "-1", "--face", "tim")
        nobody = invoke("set", "strength", "0.5", "--face", "tam")

    tim, tom = json.loads(both.stdout)["faces"]
    assert (tim["value"], "no such setting" in tom["error"]) == (0.5, True)
    assert (both.exit_code, one.exit_code, negative.exit_code) == (1, 0, 1)
    assert "strength is -1; allowed: 0 to 1.5" in negative.stderr
    assert isinstance(nobody.exception, UserError)


class _ShortSilence(SilentSource):
    duration_s = 0.1


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        (
            MotionOptions(),
            "strategy animpho (lookahead_ms 100, strength 1, stage 0, smoothness 0, unit_share 1)",
        ),
        (
            MotionOptions("energy", strategy="naive"),
            "strategy naive (strength 1, stage 0); recogniser energy",
        ),
    ],
)
def test_the_banner_names_strategy_and_recogniser(capsys, motion, said):
    with _ShortSilence() as source:
        run_face(RunRequest("face_jaw", SILENCE, motion), source, ManualClock())

    assert said in capsys.readouterr().err


class _Faulty(EnergyRecognizer):
    def feed(self, _block):
        raise FloatingPointError("a fault")


@pytest.mark.parametrize("clock", [ManualClock(), MonotonicClock()])
def test_a_recogniser_that_is_left_is_one_line_and_a_trouble(monkeypatch, clock):
    monkeypatch.setattr(
        "lipservo.runtime.face_speech.make_recognizer",
        lambda _engine, timer_s, *_: FallbackRecognizer(
            [FallbackLevel("network", _Faulty), FallbackLevel("energy", EnergyRecognizer)],
            0.095,
            timer_s,
        ),
    )
    with _ShortSilence() as source, logged("lipsync.recognition") as lines:
        outcome = run_face(RunRequest("face_jaw", SILENCE, MotionOptions()), source, clock)

    why = "FloatingPointError: a fault"
    assert lines == [f"recogniser network left: {why}; energy takes over"]
    assert outcome.status.troubles == (f"recogniser energy in use: network: {why}",)
    speech = outcome.status.speech
    assert (speech.recognizer, speech.fallback_level) == ("energy", 1)
