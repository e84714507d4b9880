"""A map from posteriors is learned from what is believed as it is believed live."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.learning.expectation.soft_training import (
    HeardCopies,
    believed_means,
    fit_soft_expectation,
    hear_copies,
    looks,
)
from small_network import random_weights
from spoken_phonemes import spoken

from lipsync.errors import UserError
from lipsync.expectation.expectation import track_of
from lipsync.expectation.soft_expectation import BelievedFrames, window_means
from lipsync.phonemes import PHONEMES, FramePosteriors

DELAYS = (2, 7, 12)


def random_posteriors(rng, n):
    values = rng.random((n, len(DELAYS), len(PHONEMES))).astype(np.float32) ** 8
    return values / values.sum(axis=2, keepdims=True)


@pytest.mark.parametrize("ahead", [7, 12, 17])
def test_frames_are_seen_as_they_are_live(ahead):
    values, at = random_posteriors(np.random.default_rng(0), 120), 60
    believed = BelievedFrames()
    for frame in range(at + ahead + 1):
        believed.push(FramePosteriors(100, frame, DELAYS, values[frame : frame + 1]))
    # Known no further than what was believed, so that no decided phoneme stands in.
    live = believed.around(track_of(()), np.array([at / 100]), 0.0)
    learned = believed_means(values, DELAYS, np.array([float(at)]), ahead)
    np.testing.assert_allclose(window_means(live), learned, atol=1e-6)


def sentence(rng, number):
    """Phonemes drawn by lot, and a face whose only component is up in AA and down else."""
    names = rng.choice(["AA", "S", "IY"], 12)
    phones = tuple(spoken(("SIL", 0.2), *((str(name), 0.12) for name in names), ("SIL", 0.2)))
    frames = np.full(190, PHONEMES.index("SIL"))
    for phone in phones:
        first, last = round(100 * phone.start_s), round(100 * phone.end_s)
        frames[first:last] = PHONEMES.index(phone.phoneme)
    utterance = Utterance(f"s{number}", np.zeros((45, 1, 3), np.float32), 25.0, None, phones, ())
    motion = np.where(frames[: 45 * 4 : 4] == PHONEMES.index("AA"), 10.0, -10.0)[:, None]
    values = np.zeros((190, len(DELAYS), len(PHONEMES)), np.float32)
    for head, delay in enumerate(DELAYS):
        values[delay:, head] = np.eye(len(PHONEMES))[frames[: 190 - delay]]
        values[:delay, head, PHONEMES.index("SIL")] = 1.0
    return utterance, motion, values


def test_what_goes_with_a_phoneme_is_learned_and_the_same_again():
    rng = np.random.default_rng(1)
    made = [sentence(rng, number) for number in range(12)]
    heard = {utterance.name: values for utterance, _, values in made}
    copies = HeardCopies(DELAYS, (heard,) * 5)
    utterances, motions = [u for u, _, _ in made], [m for _, m, _ in made]
    soft = fit_soft_expectation(utterances, motions, copies)
    soft.check(1)
    again = fit_soft_expectation(utterances, motions, copies)
    np.testing.assert_array_equal(soft.output, again.output)
    _, motion, values = sentence(rng, 99)
    faces = soft.faces(believed_means(values, DELAYS, np.arange(0.0, 180.0, 4.0), 17))
    assert np.corrcoef(faces[:, 0], motion[:, 0])[0, 1] > 0.8


def test_errors_of_other_weights_are_learned_too():
    """Ours tell AA from S, others hear IY in place of AA: a face goes with what either says."""
    rng = np.random.default_rng(1)
    made = [sentence(rng, number) for number in range(12)]
    heard = {utterance.name: values for utterance, _, values in made}
    order = np.arange(len(PHONEMES))
    order[[PHONEMES.index("AA"), PHONEMES.index("IY")]] = PHONEMES.index("S"), PHONEMES.index("AA")
    by_others = {name: values[..., order] for name, values in heard.items()}
    utterances, motions = [u for u, _, _ in made], [m for _, m, _ in made]
    _, motion, values = sentence(rng, 99)
    frames = np.arange(0.0, 180.0, 4.0)
    agreed = []
    for others in ((), (by_others,) * 5):
        copies = HeardCopies(DELAYS, (heard,) * 5, others)
        soft = fit_soft_expectation(utterances, motions, copies)
        faces = soft.faces(believed_means(values[..., order], DELAYS, frames, 17))
        agreed.append(np.corrcoef(faces[:, 0], motion[:, 0])[0, 1])
    assert agreed[1] > agreed[0] + 0.3


def test_weights_that_wait_for_other_times_cannot_listen_together():
    weights = random_weights()
    other = replace(weights, delays=(5,))
    with pytest.raises(UserError, match=r"the same delays: .* ms; 50 ms"):
        hear_copies(weights, [], lambda _, items: items, [other])


def test_too_few_sentences_teach_no_map():
    utterance, motion, values = sentence(np.random.default_rng(2), 0)
    copies = HeardCopies(DELAYS, ({utterance.name: values},) * 5)
    assert fit_soft_expectation([utterance], [motion], copies) is None
    assert fit_soft_expectation([utterance], [motion], HeardCopies(DELAYS, ({},) * 5)) is None


def test_phonemes_look_alike_within_their_class():
    table = looks()
    p, b, iy = (table[PHONEMES.index(name)] for name in ("P", "B", "IY"))
    assert np.linalg.norm(p - b) < np.linalg.norm(p - iy)
