"""How sure posteriors are, and weights of another temperature."""

import numpy as np
import pytest
from lipservo_lab.learning.recognition.temperature import calibration_error, reliability, tempered
from small_network import random_weights

from lipsync.phonemes import PHONEMES
from lipsync.recognition.network import StreamingNetwork


def test_the_error_of_a_worked_example():
    """Ten frames at .9 of which 7 are right, ten at .6 of which 6 are: off by .2 and by 0."""
    confidence = np.repeat([0.9, 0.6], 10)
    is_right = np.concatenate([np.arange(10) < 7, np.arange(10) < 6]).astype(float)
    assert calibration_error(confidence, is_right) == pytest.approx(0.1)
    assert calibration_error(np.ones(4), np.ones(4)) == 0.0


def test_phones_of_one_class_are_right_as_visemes():
    """P where B was said, always: the phone is never right, what is seen always."""
    posteriors = np.zeros((8, len(PHONEMES)), np.float32)
    posteriors[:, PHONEMES.index("P")] = 1.0
    said = np.full(8, PHONEMES.index("B"))
    assert reliability(posteriors, said) == (1.0, 0.0)


def test_a_temperature_makes_less_sure_and_decides_the_same():
    weights = random_weights()
    features = 0.2 * np.random.default_rng(0).standard_normal((50, 40)).astype(np.float32)
    given, cooler = (
        StreamingNetwork(each).push(features) for each in (weights, tempered(weights, 1.5))
    )
    assert np.array_equal(given.argmax(axis=2), cooler.argmax(axis=2))
    assert (cooler.max(axis=2) < given.max(axis=2)).all()
    np.testing.assert_allclose(cooler.sum(axis=2), 1.0, atol=1e-5)
