"""Head, eyes and smile beside the lips: who owns a servo, what is asked for, when servos rest."""

import math

import numpy as np
import pytest

from firmware_bridge.process.commands import CommandError, CommandQueue
from lipservo.runtime.speech.expression import (
    ExpressionLayer,
    ExpressionRequests,
    expression_servos,
    expression_settings,
    make_expression,
)
from lipservo.runtime.speech.layers import Claim, Layer, ServoLayers
from lipservo.runtime.speech.phoneme_sources import HeardVoice
from lipservo.settings.settings import load_shipped_face
from lipsync.audio_block import AudioBlock
from lipsync.expression.cue import CUE_PERIOD_S
from lipsync.face.frame import NO_EXPRESSION, Expression
from lipsync.prosody.voice_frame import SILENT_VOICE

HEAD = load_shipped_face("face_head")
NAMES = list(HEAD.servos)
CORNERS = {"corner_left_out", "corner_left_up", "corner_right_out", "corner_right_up"}
MOUTH = np.array([NAMES.index(name) for name in HEAD.mouth_servos])
LIPS = Claim(Layer.LIPS, MOUTH, np.zeros(len(MOUTH)))


class Told:
    """An expression that is given, and remembers what it was made from."""

    def __init__(self):
        self.cues = []
        self.shows = Expression(neck_yaw_deg=1.0, smile=0.5)
        self.is_resting = False

    def step(self, cue):
        self.cues.append(cue)
        return self.shows


class Counting:
    """Tells a voice whose peak is the number of the block, in hundredths."""

    n = 0

    def feed(self, _samples):
        self.n += 1
        return type(SILENT_VOICE)(0.0, self.n / 100, -20.0, 120.0, 0.0, True, 0.0, 0.0, 0.0, 0.3)


@pytest.fixture
def told():
    return Told()


@pytest.fixture
def layer(told):
    voice = HeardVoice(Counting())
    return ExpressionLayer(told, voice, expression_servos(HEAD), ExpressionRequests(1.0))


def advance(layer, seconds, *, is_speaking, now_s=0.0):
    for _ in range(round(seconds / CUE_PERIOD_S)):
        layer.advance(0.0, now_s, is_speaking=is_speaking)


def owners(layer):
    servos = ServoLayers(NAMES, np.zeros(len(NAMES)), CUE_PERIOD_S)
    servos.compose(layer.claims(LIPS))
    return servos.owners


def test_lips_own_the_whole_mouth_while_it_speaks_and_in_the_pauses_between_words(layer):
    advance(layer, 1.0, is_speaking=True)
    speaking = owners(layer)
    advance(layer, 0.2, is_speaking=False)
    assert owners(layer) == speaking
    assert {n for n, owner in speaking.items() if owner is Layer.LIPS} == set(HEAD.mouth_servos)
    assert speaking["neck_yaw"] is Layer.EXPRESSION


def test_in_silence_the_corners_smile_and_the_lips_keep_the_rest(layer):
    advance(layer, 1.0, is_speaking=False)
    silent = owners(layer)
    assert {name for name in HEAD.mouth_servos if silent[name] is Layer.EXPRESSION} == CORNERS


def test_after_some_silence_the_head_is_idle_unless_there_is_somebody_to_look_at(layer):
    advance(layer, 5.0, is_speaking=False)
    assert owners(layer)["neck_yaw"] is Layer.IDLE
    layer.change({"look_weight": 1.0, "look_yaw_deg": 20.0})
    advance(layer, 5.0, is_speaking=False)
    assert owners(layer)["neck_yaw"] is Layer.EXPRESSION


def test_cues_tell_who_to_look_at_how_long_nobody_spoke_and_what_affect_is_left(layer, told):
    layer.change(
        {
            "look_weight": 1.0,
            "look_yaw_deg": 20.0,
            "look_pitch_deg": -5.0,
            "affect_valence": 0.8,
            "affect_arousal": 0.4,
            "affect_tau_s": 2.0,
            "affect_at_s": 100.0,
            "expression": 0.5,
            "strength": 0.1,
        }
    )
    advance(layer, 0.5, is_speaking=False, now_s=100.0)
    advance(layer, 0.5, is_speaking=False, now_s=102.0)
    first, last = told.cues[0], told.cues[-1]

    assert (first.look_at_deg, first.amount) == ((20.0, -5.0), 0.5)
    assert (first.valence, first.arousal) == (0.8, 0.4)
    assert last.valence == pytest.approx(0.8 / math.e)
    assert last.silent_s == pytest.approx(1.0)
    assert last.time_s - first.time_s == pytest.approx(0.99)


def test_the_voice_of_a_cue_is_what_was_heard_at_its_sound_time(layer, told):
    for n in range(30):
        layer.voice.hear(AudioBlock(np.zeros(160, np.float32), n * 0.01))
    layer.advance(0.125, 0.0, is_speaking=True)
    layer.advance(5.0, 0.0, is_speaking=True)

    assert told.cues[0].voice.peak == pytest.approx(0.13)
    assert told.cues[0].arousal == pytest.approx(0.3)
    assert told.cues[1].voice is SILENT_VOICE
    assert layer.voice.peaks(0.10, 0.14, 10) == pytest.approx([0.12, 0.13, 0.14, 0.15])
    assert layer.voice.peaks(0.10, 0.14, 2) == pytest.approx([0.14, 0.15])


def test_a_face_rests_only_in_silence_and_gets_up_for_whatever_happens(layer, told):
    told.is_resting = True
    advance(layer, 5.0, is_speaking=False)
    assert layer.is_resting
    layer.change({"look_weight": 0.0})
    assert layer.is_resting  # nothing new
    layer.change({"look_weight": 1.0})
    assert not layer.is_resting
    advance(layer, 5.0, is_speaking=False)
    layer.wake()
    assert not layer.is_resting


@pytest.mark.parametrize(
    ("arousal", "gain"), [(0.0, 1.0), (0.5, 1.1), (1.0, 1.2), (-0.5, 0.9), (-1.0, 0.85)]
)
def test_a_face_without_servos_for_it_still_opens_its_mouth_wider_when_excited(arousal, gain):
    mouth = load_shipped_face("face_sim")
    layer = make_expression(mouth, is_watched=False)
    layer.change({"affect_arousal": arousal, "affect_valence": 0.5, "affect_at_s": 1.0})
    advance(layer, 0.1, is_speaking=True, now_s=1.0)

    assert layer.mouth_gain == pytest.approx(gain)
    assert layer.valence == 0.5
    assert layer.expression is NO_EXPRESSION
    assert [claim.layer for claim in layer.claims(LIPS)] == [Layer.LIPS]


def test_a_face_without_servos_for_it_has_a_head_on_the_page_and_rests_as_others_do():
    mouth = load_shipped_face("face_sim")
    watched = make_expression(mouth, is_watched=True)
    advance(watched, 1.0, is_speaking=True)
    assert watched.expression.neck_yaw_deg is not None

    asked = mouth.expression.model_copy(update={"rest_after_s": 10.0})
    alone = make_expression(mouth.model_copy(update={"expression": asked}), is_watched=False)
    advance(alone, 9.9, is_speaking=False)
    assert not alone.is_resting
    advance(alone, 0.2, is_speaking=False)
    assert alone.is_resting


@pytest.mark.parametrize(
    ("name", "value"),
    [("look_yaw_deg", 61.0), ("affect_valence", -1.1), ("affect_tau_s", 0.0), ("expression", 1.6)],
)
def test_what_is_beyond_its_bounds_is_refused(name, value):
    with pytest.raises(CommandError, match=f"{name} is .*; allowed"):
        CommandQueue(expression_settings(1.0)).change({name: value})


def test_the_settings_that_may_be_asked_for_are_those_that_are_followed():
    assert ExpressionRequests(0.7).values == {
        name: each.value for name, each in expression_settings(0.7).items()
    }
