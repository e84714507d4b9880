"""Head and eyes of a line that is known to its end."""

import numpy as np
import pytest
from spoken_phonemes import spoken
from synthetic_voice import voice

from lipservo.rendering.line_expression import line_expression, silent_s, voice_frames
from lipsync.errors import UserError
from lipsync.offline.line_methods import Line
from lipsync.offline.performance import EXPRESSION_NAMES

EVENTS = spoken(("SIL", 0.5), ("AA", 0.5), ("SIL", 0.2), ("M", 0.2), ("SIL", 0.6), ("AA", 0.2))
N_FRAMES = 221


def line(seed=0):
    samples = voice(2.2, np.random.default_rng(seed)).astype(np.float32)
    return Line(EVENTS, samples)


def test_a_pause_is_one_from_its_first_moment_and_one_within_a_sentence_never():
    found = dict(zip(range(N_FRAMES), silent_s(EVENTS, N_FRAMES), strict=True))

    assert found[0] == pytest.approx(0.3)
    assert found[50] == found[99] == found[110] == found[139] == 0.0
    assert found[140] == pytest.approx(0.3)
    assert found[199] == pytest.approx(0.3 + 0.59)
    assert found[200] == found[219] == 0.0
    assert found[220] == pytest.approx(0.3)


def test_every_line_has_a_motion_of_its_own_and_the_same_line_the_same():
    first, again, other = (line_expression("face_head", line(seed), N_FRAMES) for seed in (0, 0, 1))

    assert tuple(first) == EXPRESSION_NAMES
    for name, values in first.items():
        assert values.shape == (N_FRAMES,)
        assert values.dtype == np.float32
        np.testing.assert_array_equal(values, again[name])
    assert np.abs(first["neck_yaw_deg"] - other["neck_yaw_deg"]).max() > 1.0
    assert np.ptp(first["neck_pitch_deg"]) > 1.0
    # In the middle of a conversation: it does not set out from neutral.
    assert np.abs([first[name][0] for name in EXPRESSION_NAMES[:5]]).max() > 0.5


def test_the_voice_is_judged_by_the_whole_line():
    """What is said first is as loud for its line as the same is later."""
    samples = line().samples
    frames = voice_frames(np.concatenate((samples, samples)))
    loudness = np.array([frame.loudness_z for frame in frames])
    first, second = loudness[:220], loudness[220:440]

    assert np.abs(first).max() > 0.3
    assert abs(np.mean(first[first != 0.0]) - np.mean(second[second != 0.0])) < 0.2


def test_a_face_that_is_not_there_is_refused():
    with pytest.raises(UserError):
        line_expression("no_such_face", line(), N_FRAMES)
