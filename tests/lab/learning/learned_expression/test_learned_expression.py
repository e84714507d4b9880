import math
from dataclasses import astuple, replace

import numpy as np
import pytest
from expression_tracks import small_model
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.learning.learned_expression.expression_model import (
    ExpressionModelError,
    is_expression,
    load_expression,
    save_expression,
)
from lipservo_lab.learning.learned_expression.learned_expression import LearnedExpression

from lipsync.expression.cue import ExpressionCue
from lipsync.prosody.voice_frame import SILENT_VOICE

MODEL = small_model()


def voices(n, seed=0):
    """A voice whose loudness and pitch wander, 100 times a second."""
    rng = np.random.default_rng(seed)
    loud, high = np.repeat(rng.normal(0.0, 1.0, (2, n // 20 + 1)), 20, axis=1)[:, :n].tolist()
    return [
        replace(SILENT_VOICE, is_speech=True, loudness_z=a, pitch_z=b)
        for a, b in zip(loud, high, strict=True)
    ]


def motion(heard, *, model=MODEL, seed=0, variety=1.0, **cue):
    """(n, 7): head pitch, yaw, roll, eye pitch, yaw, lids."""
    expression = LearnedExpression(model, np.random.default_rng(seed), variety=variety)
    rows = [
        astuple(expression.step(ExpressionCue(0.01 * (i + 1), each, **cue)))[:7]
        for i, each in enumerate(heard)
    ]
    return np.array(rows, dtype=np.float64)


def test_the_same_cues_and_seed_give_the_same_motion():
    heard = voices(400)

    assert (motion(heard) == motion(heard)).all()
    assert not (motion(heard) == motion(heard, seed=1)).all()


def test_what_is_heard_later_changes_nothing_before():
    heard, other = voices(400), voices(400, seed=1)

    assert (motion(heard)[:200] == motion(heard[:200] + other[200:])[:200]).all()


def test_head_and_gaze_move_without_jumps_every_10_ms():
    moved = motion(voices(2000))[:, :5]

    assert moved.std(axis=0).min() > 0.1
    # The recorded head that the model knows turns by 10 degrees a second at most.
    assert np.abs(np.diff(moved, axis=0)).max() < 0.5


def test_the_head_nods_after_the_voice():
    heard = voices(5_000)
    pitch = motion(heard, variety=0.0)[:, 0]
    loud = np.array([each.loudness_z for each in heard])
    lags = range(0, 60, 2)
    r = [-np.corrcoef(loud[: len(loud) - lag], pitch[lag:])[0, 1] for lag in lags]

    assert max(r) > 0.3
    assert 0.01 * lags[int(np.argmax(r))] <= 0.25  # 0 to 160 ms of the model, 60 of its steps


def test_without_variety_the_motion_is_smaller():
    heard = voices(2000)

    assert motion(heard, variety=0.0)[:, 1].std() < motion(heard)[:, 1].std()


def test_an_amount_of_nothing_is_stillness():
    assert not motion(voices(1000), amount=0.0).any()


def test_twice_the_amount_is_twice_the_head():
    heard = voices(400)
    once, more = motion(heard, amount=0.75), motion(heard, amount=1.5)

    assert more[:, :3] == pytest.approx(2.0 * once[:, :3])


def test_who_is_looked_at_stays_in_view_while_the_head_moves():
    seen = motion(voices(600), look_at_deg=(16.0, -8.0))[200:]
    head_pitch, head_yaw, _, eye_pitch, eye_yaw = seen[:, :5].T

    assert head_yaw + eye_yaw == pytest.approx(16.0, abs=0.5)
    assert head_pitch + eye_pitch == pytest.approx(-8.0, abs=0.5)
    assert 2.0 < head_yaw.mean() < 6.0


def test_blinks_shut_both_lids_alike():
    lids = motion([SILENT_VOICE] * 3000)[:, 5:]

    assert (lids[:, 0] == lids[:, 1]).all()
    assert lids.max() == pytest.approx(1.0, abs=0.05)
    assert lids.min() >= -0.2
    assert np.median(lids) < 0.3


def test_tracks_without_eyes_or_lids_say_nothing_about_them():
    head_only = replace(MODEL, gaze=None, farthest_gaze_deg=None, lids=None, blinks=None)
    shown = LearnedExpression(head_only, np.random.default_rng(0)).step(ExpressionCue(0.01))

    assert shown.neck_yaw_deg is not None
    assert (shown.eye_yaw_deg, shown.eye_pitch_deg) == (None, None)
    assert (shown.lid_left, shown.lid_right, shown.brow, shown.smile) == (None,) * 4


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.booleans(), st.floats(-1.0, 1.0)),
        min_size=1,
        max_size=8,
    ),
    st.integers(0, 5),
)
def test_whatever_is_heard_the_head_stays_within_what_was_seen(pieces, seed):
    expression = LearnedExpression(MODEL, np.random.default_rng(seed))
    for number, (loudness_z, pitch_z, is_speech, arousal) in enumerate(pieces):
        voice = replace(SILENT_VOICE, loudness_z=loudness_z, pitch_z=pitch_z, is_speech=is_speech)
        for _ in range(20):
            shown = expression.step(ExpressionCue(float(number), voice, arousal=arousal))
            assert max(abs(v) for v in astuple(shown)[:3]) <= 8.0 * 1.6 + 1e-9
            assert max(abs(v) for v in astuple(shown)[3:5]) <= 25.0
            assert -0.2 <= shown.lid_left <= 1.0


def test_a_saved_model_moves_the_same(tmp_path):
    path = tmp_path / "head.npz"
    save_expression(MODEL, path)
    heard = voices(300)

    assert motion(heard, model=load_expression(path)) == pytest.approx(motion(heard))
    assert is_expression(path.read_bytes()[:4096])
    assert path.stat().st_size < 50_000
    assert list(tmp_path.iterdir()) == [path]


def test_what_tracks_did_not_tell_is_not_there_when_loaded(tmp_path):
    path = tmp_path / "head.npz"
    save_expression(replace(MODEL, gaze=None, farthest_gaze_deg=None, blinks=None), path)
    loaded = load_expression(path)

    assert loaded.gaze is None
    assert loaded.blinks is None
    assert loaded.lids == pytest.approx(MODEL.lids)


def _changed(path, **arrays):
    with np.load(path) as file:
        content = {name: file[name] for name in file.files}
    np.savez(path, **{k: v for k, v in (content | arrays).items() if v is not None})


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda p: p.unlink(), "no such file"),
        (lambda p: p.write_bytes(b"PK nothing"), "damaged"),
        (lambda p: p.write_bytes(p.read_bytes()[:-400]), "damaged"),
        (lambda p: _changed(p, format=np.array(9)), "format 9"),
        (lambda p: _changed(p, means=None), "'means' is missing"),
        (lambda p: _changed(p, gaze=np.zeros((2, 4))), "shape"),
        (lambda p: _changed(p, lids=np.full(6, math.nan)), "no numbers"),
        (lambda p: _changed(p, precisions=np.zeros((3, 11, 11))), "positive definite"),
        (lambda p: _changed(p, weights=np.array(["a", "b", "c"])), "again"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_in_one_line(tmp_path, damage, words):
    path = tmp_path / "head.npz"
    save_expression(MODEL, path)
    damage(path)

    with pytest.raises(ExpressionModelError, match=words) as refused:
        load_expression(path)
    assert "\n" not in str(refused.value)
    assert str(path) in str(refused.value)
