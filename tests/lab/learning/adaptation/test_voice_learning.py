"""A network learns a voice and stays near what it was."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.corpus.alignment_cache import align_utterance
from lipservo_lab.corpus.transcribed import TranscribedUtterance
from lipservo_lab.learning.recognition.training_data import feature_scale, read_labelled
from small_network import random_weights
from speech import CLIP_LABELS_PATH, CLIP_PATH

pytest.importorskip("torch", reason="the extra `train` is not installed")


@pytest.fixture(scope="module")
def clip():
    utterance = TranscribedUtterance("clip", "robot", "hello", CLIP_PATH, CLIP_LABELS_PATH)
    return read_labelled(utterance, align_utterance(utterance))


@pytest.fixture(scope="module")
def adapted(clip):
    """A function of a plan's changes: the weights before, and after."""
    from lipservo_lab.learning.adaptation.voice_learning import AdaptationPlan, adapt

    def run(delays=(2, 7, 12), **changes):
        start = replace(
            random_weights(n_channels=8, dilations=(1, 2), delays=delays),
            scale=feature_scale([clip]),
        )
        plan = AdaptationPlan(batch=2, window=200, n_copies=0, n_threads=1, **changes)
        return start, adapt(start, [clip], plan)

    return run


def way(start, end):
    """How far the kernels have gone."""
    pairs = zip((start.entry, *start.residuals), (end.entry, *end.residuals), strict=True)
    return float(np.sqrt(sum(np.square(a.kernel - b.kernel).sum() for a, b in pairs)))


def test_no_rate_changes_nothing(adapted):
    start, end = adapted(n_steps=3, peak_rate=0.0)

    assert way(start, end) < 1e-4
    assert np.abs(start.output - end.output).max() < 1e-6


def test_a_strong_pull_keeps_the_weights_near(adapted):
    start, free = adapted(n_steps=20, peak_rate=1e-2, pull=0.0)
    _, pulled = adapted(n_steps=20, peak_rate=1e-2, pull=50.0)

    assert 0.01 < way(start, pulled) < 0.7 * way(start, free)


def test_it_learns_the_voice(adapted, clip):
    from lipservo_lab.evaluation.recognition.recognition_scores import settled_score

    start, end = adapted(n_steps=60, peak_rate=2e-2, pull=0.0)
    before, after = (settled_score(w, [clip]).figures()["viseme_all"] for w in (start, end))

    assert after > before + 0.1


def test_the_same_seed_gives_the_same_weights_of_a_network_of_any_shape(adapted):
    _, once = adapted(delays=(0, 5), n_steps=3)
    _, again = adapted(delays=(0, 5), n_steps=3)

    assert once.delays == (0, 5)
    assert np.array_equal(once.output, again.output)
    assert np.array_equal(once.entry.kernel, again.entry.kernel)
