"""A daemon's face at rest works out one period of five, and shows what it would have shown."""

import numpy as np
import pytest
import soundfile
from speaking_side import SpeakingSide
from speech import CLIP_PATH
from spoken_phonemes import spoken

from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.recognition.recognizers import make_recognizer

RATE_HZ = 16_000
RESTS_S = 1.9


def say(robot, samples, known=()):
    stream = PlayoutStream("a", RATE_HZ, robot.playout.output_rate_hz, known)
    stream.push(samples)
    stream.end()
    robot.playout.requests.append(PlayoutRequest("say", stream))


def shown(said_s, say_it, until_s, *, holds, recognizer=None):
    """What is seen of a face that rests, and is asked at `said_s` to say something."""
    robot, waiting = SpeakingSide(recognizer=recognizer), [said_s]

    def act(now_s):
        while waiting and now_s >= waiting[0]:
            waiting.pop()
            say_it(robot)

    return robot.run(until_s, act, holds=holds).encoders_deg, robot


@pytest.mark.parametrize("period", range(5))
def test_a_word_comes_as_soon_in_any_period_of_a_rest(period):
    known = spoken(("SIL", 0.1), ("M", 0.1), ("AA", 0.2), ("P", 0.1), ("SIL", 0.1))

    def say_it(robot):
        say(robot, np.full(round(known[-1].end_s * RATE_HZ), 0.1, np.float32), known)

    said_s = RESTS_S + 0.01 * period
    every, _ = shown(said_s, say_it, 3.2, holds=False)
    held, robot = shown(said_s, say_it, 3.2, holds=True)

    assert np.ptp(every[:, 0]) > 3.0  # it speaks
    assert robot.n_held > 40
    np.testing.assert_array_equal(held, every)


def test_what_is_recognised_after_a_rest_moves_the_mouth_alike():
    samples = soundfile.read(CLIP_PATH, dtype="float32")[0][: round(1.2 * RATE_HZ)]
    found = [
        shown(
            RESTS_S + 0.02,
            lambda robot: say(robot, samples),
            6.0,
            holds=holds,
            recognizer=make_recognizer(),
        )
        for holds in (False, True)
    ]
    (every, _), (held, robot) = found
    assert np.ptp(every[:, 0]) > 3.0
    assert robot.n_held > 100  # before it and after it
    np.testing.assert_allclose(held, every, atol=1e-9)


def test_nothing_is_put_off_while_the_face_speaks():
    known = spoken(("AA", 0.5), ("IY", 0.5), ("AA", 0.5))
    _, robot = shown(
        0.0,
        lambda robot: say(robot, np.full(24_000, 0.1, np.float32), known),
        1.5,
        holds=True,
    )
    assert robot.n_held == 0
