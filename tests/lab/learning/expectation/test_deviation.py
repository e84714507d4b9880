"""Components that moved too little in the mean move further, and no further than they should."""

from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.corpus.utterance import Utterance, speech_frames
from lipservo_lab.learning.expectation.deviation import SHARE, with_deviation
from lipservo_lab.learning.motion.trained_model import load_trained_model

from lipsync.expectation.expectation import contexts, track_of
from lipsync.phonemes import PhonemeEvent

SPOKEN = ("SIL", "B", "IH", "N", "B", "L", "UW", "AE", "T", "EH", "F", "AY", "V", "SIL")
RATE_HZ = 25.0


@pytest.fixture(scope="module")
def expectation():
    return load_trained_model().expectation


@pytest.fixture(scope="module")
def utterance():
    phones = tuple(PhonemeEvent(p, 0.1 * i, 0.1 * i + 0.1) for i, p in enumerate(SPOKEN))
    n_frames = round(0.1 * len(SPOKEN) * RATE_HZ)
    return Utterance("one", np.zeros((n_frames, 1, 3)), RATE_HZ, Path("one.flac"), phones, ())


def expected(expectation, utterance):
    times_s = np.arange(len(utterance.markers_mm)) / RATE_HZ
    phonemes, known_s = contexts(track_of(utterance.phones), times_s, 0.1)
    return expectation.faces(phonemes, known_s, np.full(len(times_s), 0.1))


def test_what_moves_too_little_moves_as_far_as_asked_and_the_rest_as_before(expectation, utterance):
    spoken = speech_frames(utterance)
    before = expected(expectation, utterance)
    ratio = np.array([1.0, 0.5, 1.25, 1.5, 2.0, 2.25, 10.0, 1.0])
    recorded = before * ratio
    after = expected(with_deviation(expectation, [utterance], [recorded]), utterance)
    gain = after[spoken].std(axis=0) / before[spoken].std(axis=0)
    assert gain == pytest.approx(np.clip(SHARE * ratio, 1.0, 2.0), rel=1e-6)
    assert after[spoken].mean(axis=0) == pytest.approx(before[spoken].mean(axis=0), abs=1e-6)


def test_without_speech_nothing_changes(expectation, utterance):
    silent = Utterance("two", utterance.markers_mm, RATE_HZ, Path("two.flac"), (), ())
    assert with_deviation(expectation, [silent], [np.ones((35, 8))]) is expectation
