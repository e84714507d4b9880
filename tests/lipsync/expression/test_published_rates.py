"""What a face does in minutes, against what was measured on people."""

from random import Random

import numpy as np
import pytest
from gaze_shifts import gaze_shifts
from lipservo_lab.evaluation.expression.expression_figures import (
    blink_cues,
    blinks_per_min,
    cues_of,
    shown,
)
from scipy import stats
from synthetic_prosody import synthetic_voice

from lipsync.expression.cue import CUE_PERIOD_S, ExpressionCue
from lipsync.expression.gaze import STRAIGHT_AHEAD, Gaze, listening_habit, talking_habit
from lipsync.expression.live_expression import LiveExpression


def silent_cues(minutes, silent_s):
    for n in range(round(minutes * 60.0 / CUE_PERIOD_S)):
        yield ExpressionCue(n * CUE_PERIOD_S, silent_s=silent_s)


@pytest.fixture(scope="module")
def talking():
    return shown(LiveExpression(11), cues_of(synthetic_voice(11, 1200.0, silent_s=0.0)))


@pytest.fixture(scope="module")
def dialogue():
    return shown(LiveExpression(12), cues_of(synthetic_voice(12, 300.0)))


@pytest.fixture(scope="module")
def listening():
    return shown(LiveExpression(13), silent_cues(5.0, 0.0))


@pytest.fixture(scope="module")
def idle():
    return shown(LiveExpression(14), silent_cues(6.0, 60.0))


def rate(track):
    return blinks_per_min(track.column("lid_left"), np.ones_like(track.is_speaking))


@pytest.mark.slow
def test_blinks_a_minute_lie_within_the_ranges_of_people(talking, dialogue, listening, idle):
    assert rate(talking) == pytest.approx(24.0, abs=3.0)  # Doughty: 10.5 to 32.5
    assert rate(dialogue) == pytest.approx(24.0, abs=3.0)
    assert 8.0 < rate(listening) < 21.0  # Doughty, silent
    assert 8.0 < rate(idle) < 21.0


def test_no_two_blinks_begin_within_four_tenths_of_a_second(talking, dialogue):
    for track in (talking, dialogue):
        assert np.diff(blink_cues(track.column("lid_left"))).min() * CUE_PERIOD_S >= 0.4 - 1e-9


@pytest.mark.parametrize(("name", "share"), [("talking", 0.41), ("listening", 0.75)])
def test_gaze_is_on_the_partner_for_its_share_of_the_time(name, share, request):
    gaze_deg = request.getfixturevalue(name).gaze_deg
    mutual = np.hypot(gaze_deg[:, 0], gaze_deg[:, 1]) < 0.2
    assert mutual.mean() == pytest.approx(share, abs=0.05)


@pytest.mark.parametrize("share", [0.2, 0.6, 0.9, 1.0])
def test_the_share_of_gaze_is_as_it_is_set(share):
    gaze = Gaze(Random(1), talking_habit(share), listening_habit())
    gaze.set_talking(is_talking=True)
    mutual = []
    for _ in range(40_000):
        gaze.step(STRAIGHT_AHEAD, 3.0, 1.0)
        mutual.append(gaze.is_mutual)
    assert np.mean(mutual) == pytest.approx(share, abs=0.05)


def test_saccades_are_as_large_and_as_long_as_people_make_them(talking):
    shifts = gaze_shifts(talking.gaze_deg)
    assert (shifts.magnitude_deg < 15.0).mean() >= 0.9
    assert 5.0 < shifts.magnitude_deg.mean() < 7.5  # 7.2 without a limit of their range
    assert shifts.seconds_per_deg == pytest.approx(0.0024, abs=0.0002)


def test_brows_flash_and_rest(talking, idle):
    brow = talking.column("brow")
    assert 0.05 < (brow > 0.25).mean() < 0.5
    assert idle.column("brow").max() == 0.0


def test_most_of_the_heads_motion_is_below_2_hz(talking):
    hz, power = stats_of_spectrum(talking.column("neck_pitch_deg"))
    assert power[hz < 2.0].sum() / power.sum() > 0.97


def stats_of_spectrum(values):
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2
    return np.fft.rfftfreq(len(values), CUE_PERIOD_S), power


def test_an_idle_neck_keeps_its_budget_of_travel_and_holds_between_moves(idle):
    settled = slice(1000, None)
    moves = []
    for axis in ("pitch", "yaw", "roll"):
        speed = np.abs(np.diff(idle.column(f"neck_{axis}_deg")[settled])) / CUE_PERIOD_S
        assert 0.0 < speed.mean() < 0.4
        moves.append(speed > 0.0)
        assert moves[-1].mean() < 0.4
        n_moves = (np.diff(moves[-1].astype(int)) == 1).sum()
        assert n_moves / (len(speed) * CUE_PERIOD_S / 60.0) < 12.0
    assert np.any(moves, axis=0).mean() < 0.6


def test_idle_breathes_less_than_a_degree(idle):
    pitch_deg, gaze_deg = idle.column("neck_pitch_deg"), idle.gaze_deg
    with_partner = np.hypot(gaze_deg[:, 0], gaze_deg[:, 1]) < 0.2
    assert np.percentile(np.abs(pitch_deg[with_partner]), 90) < 2.0
    assert stats.iqr(pitch_deg) < 1.0
