"""All generators together, at the one place where a face asks them."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.evaluation.expression.expression_figures import cues_of, shown
from synthetic_prosody import synthetic_voice

from lipsync.expression.cue import CUE_PERIOD_S, ExpressionCue
from lipsync.expression.live_expression import LiveExpression
from lipsync.face.frame import Expression
from lipsync.prosody.voice_frame import VoiceFrame

NEUTRAL = Expression(*(0.0,) * 9)
#: Of a critically damped filter of 4 Hz that never exceeds 120 degrees a second: 4 w v.
MOST_DEG_S2 = 4.0 * 2.0 * math.pi * 4.0 * 120.0

anything = st.floats(allow_nan=True, allow_infinity=True)
voices = st.builds(VoiceFrame, *[anything] * 5, st.booleans(), *[anything] * 4)
wild_cues = st.builds(
    ExpressionCue,
    time_s=anything,
    voice=voices,
    is_speaking=st.booleans(),
    silent_s=anything,
    look_at_deg=st.none() | st.tuples(anything, anything),
    valence=anything,
    arousal=anything,
    amount=anything,
)


def talk(seed, duration_s, **fields):
    for cue in cues_of(synthetic_voice(seed, duration_s, 3.0, 1.0)):
        yield ExpressionCue(cue.time_s, cue.voice, cue.is_speaking, cue.silent_s, **fields)


def silence(duration_s, since_s=0.0, **fields):
    for n in range(round(duration_s / CUE_PERIOD_S)):
        time_s = n * CUE_PERIOD_S
        yield ExpressionCue(time_s, silent_s=since_s + time_s, **fields)


def played(source, cues):
    return [source.step(cue) for cue in cues]


def head(expressions):
    return np.array([astuple(each)[:3] for each in expressions])


def gaze(expression):
    return (
        expression.neck_yaw_deg + expression.eye_yaw_deg,
        expression.neck_pitch_deg + expression.eye_pitch_deg,
    )


def test_same_cues_and_seed_give_the_same_motion_and_another_seed_another():
    first, second, other = (played(LiveExpression(s), talk(1, 20.0)) for s in (7, 7, 8))
    assert first == second
    assert first != other


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(wild_cues, st.integers(1, 40)), min_size=1, max_size=8))
def test_whatever_a_cue_says_motion_is_finite_and_within_its_limits(cues):
    source = LiveExpression(1)
    expressions = [source.step(cue) for cue, n in cues for _ in range(n)]
    assert {own for each in expressions for own in astuple(each)[9:]} == {None}  # the mouth's
    values = np.array([astuple(each)[:9] for each in expressions])
    least = [-15, -25, -10, -25, -35, -0.4, -0.4, 0, -1]
    most = [15, 25, 10, 25, 35, 1, 1, 1, 1]
    assert np.isfinite(values).all()
    assert (values >= np.array(least) - 1e-9).all()
    assert (values <= np.array(most) + 1e-9).all()
    speeds = np.diff(head([NEUTRAL, *expressions]), axis=0) / CUE_PERIOD_S
    assert np.abs(speeds).max() <= 120.0 + 1e-9
    accelerations = np.diff(speeds, axis=0) / CUE_PERIOD_S
    assert np.abs(accelerations).max(initial=0.0) <= MOST_DEG_S2


def test_at_amount_0_everything_is_still_with_the_lids_open():
    assert set(played(LiveExpression(1), talk(1, 20.0, amount=0.0, arousal=1.0))) == {NEUTRAL}


@pytest.mark.parametrize("target_deg", [(5.0, -3.0), (-30.0, 10.0), (50.0, 0.0), (10.0, -35.0)])
@pytest.mark.parametrize("amount", [0.0, 1.0])
def test_gaze_goes_to_whom_it_is_told_to_look_at_by_eyes_first(target_deg, amount):
    source = LiveExpression(4)
    played(source, silence(1.0, amount=amount))
    expressions = played(source, silence(2.0, look_at_deg=target_deg, amount=amount))
    for expression in expressions[100:]:
        assert math.dist(gaze(expression), target_deg) < 2.0
    at_saccade, later = expressions[15], expressions[-1]
    yaw_deg = target_deg[0]
    assert abs(at_saccade.eye_yaw_deg) > abs(later.eye_yaw_deg) or abs(yaw_deg) > 45.0
    if amount == 0.0:
        farthest = max(map(abs, target_deg))
        part = max(abs(later.neck_yaw_deg), abs(later.neck_pitch_deg)) / farthest
        assert 0.25 - 1e-6 <= part <= 0.6


def test_somebody_who_moves_is_followed():
    source = LiveExpression(4)
    for n in range(500):
        yaw_deg = 0.04 * n
        cue = ExpressionCue(n * 0.01, silent_s=0.1, look_at_deg=(yaw_deg, 0.0), amount=0.0)
        assert abs(gaze(source.step(cue))[0] - yaw_deg) < 2.2


def test_gaze_stays_put_in_the_world_while_the_head_moves():
    track = shown(LiveExpression(5), talk(3, 60.0))
    steps = np.hypot(*np.diff(track.gaze_deg, axis=0).T)
    holds = steps < 1e-9
    assert holds.mean() > 0.9  # all but saccades
    assert np.abs(np.diff(track.column("neck_yaw_deg")))[holds].mean() > 0.005


def test_a_long_silence_brings_the_face_to_rest_and_it_stays_there():
    source = LiveExpression(6, rest_after_s=20.0)
    played(source, talk(1, 5.0, valence=1.0, arousal=0.5))
    expressions = played(source, silence(20.0, valence=1.0, arousal=-1.0))
    assert not source.is_resting
    expressions += played(source, silence(5.0, 20.0, valence=1.0, arousal=-1.0))
    assert source.is_resting
    assert set(played(source, silence(60.0, 25.0, valence=1.0))) == {NEUTRAL}
    steps = np.abs(np.diff(head(expressions[-600:]), axis=0)) / CUE_PERIOD_S
    assert steps.max() < 30.0


def test_waking_is_no_jump():
    source = LiveExpression(6, rest_after_s=5.0)
    played(source, silence(15.0))
    assert source.is_resting
    woken = played(source, talk(4, 5.0, arousal=1.0))
    assert not source.is_resting
    path = head([NEUTRAL, *woken])
    speeds = np.diff(path, axis=0) / CUE_PERIOD_S
    assert np.abs(speeds[:5]).max() < 1.0
    assert np.abs(speeds).max() < 60.0
    assert np.abs(path).max() > 1.0  # it moves again


def test_somebody_to_look_at_wakes_a_face_at_rest_and_a_steady_one_does_not():
    source = LiveExpression(6, rest_after_s=5.0)
    played(source, silence(15.0, look_at_deg=(20.0, 0.0)))
    assert source.is_resting
    shaking = [(20.0 + 0.5 * math.sin(n), 0.0) for n in range(100)]
    played(source, (ExpressionCue(0.0, silent_s=15.0, look_at_deg=at) for at in shaking))
    assert source.is_resting
    last = played(source, silence(1.0, 20.0, look_at_deg=(-20.0, 0.0)))[-1]
    assert not source.is_resting
    assert gaze(last)[0] == pytest.approx(-20.0, abs=1.0)


def test_only_what_is_said_makes_it_smile():
    silent = played(LiveExpression(1), talk(1, 5.0, arousal=1.0))
    assert {each.smile for each in silent} == {0.0}
    assert played(LiveExpression(1), talk(1, 5.0, valence=0.6))[-1].smile == pytest.approx(0.6)
    assert played(LiveExpression(1), talk(1, 5.0, valence=-0.6))[-1].smile == pytest.approx(-0.6)


def test_excitement_widens_the_eyes_and_its_lack_lets_the_lids_droop():
    def lid(arousal):
        track = shown(LiveExpression(1), silence(20.0, arousal=arousal))
        return float(np.median(track.column("lid_left")))

    assert lid(1.0) < lid(0.0) - 0.15
    assert lid(-1.0) > lid(0.0) + 0.1


@pytest.mark.parametrize("share", [0.0, 1.1, math.nan])
def test_a_share_of_gaze_that_is_none_is_refused(share):
    with pytest.raises(ValueError, match="share of time looking at the partner"):
        LiveExpression(1, talking_mutual_share=share)
