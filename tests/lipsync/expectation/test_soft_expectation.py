"""What a recogniser doubts has its share in the face; what is known has none."""

import numpy as np
import pytest
from spoken_phonemes import spoken

from lipsync.expectation.expectation import track_of
from lipsync.expectation.soft_expectation import (
    FRAMES_PER_S,
    LARGEST_SHARE,
    OFFSETS,
    WINDOWS,
    BelievedFrames,
    SoftExpectation,
    shares_of,
    softened_line,
    window_means,
)
from lipsync.phonemes import PHONEMES, FramePosteriors

TRACK = track_of(spoken(("AA", 1.0), ("IY", 1.0)))
AA, IY, SIL = (PHONEMES.index(phoneme) for phoneme in ("AA", "IY", "SIL"))
DELAYS = (2, 7, 12)
AT = np.array([0.5])


def constant_map(face=5.0):
    """Return a map from posteriors to faces that gives the same face, of one component, for all."""
    d = len(WINDOWS)
    output = np.zeros((1 + d + 1 + 1, 1), np.float32)
    output[-1] = face
    return SoftExpectation(
        np.ones((len(PHONEMES), 1), np.float32),
        np.zeros((d, 1), np.float32),
        np.zeros(1, np.float32),
        np.zeros((d + 1, 1), np.float32),
        np.zeros((2, 1), np.float32),
        output,
    )


def posteriors(n, first_frame=0, **shares):
    """n rows whose heads all believe the same: shares of phonemes by name."""
    values = np.zeros((n, len(DELAYS), len(PHONEMES)), np.float32)
    for phoneme, share in shares.items():
        values[..., PHONEMES.index(phoneme)] = share
    return FramePosteriors(FRAMES_PER_S, first_frame, DELAYS, values)


def mixed(believed, known_until_s=0.6):
    return constant_map().mixed(np.zeros((1, 1)), believed, TRACK, AT, known_until_s)[0, 0]


def test_phonemes_that_are_known_move_the_mouth_as_they_are_decided():
    assert mixed(BelievedFrames()) == 0.0


def test_a_recogniser_that_is_sure_changes_nothing():
    believed = BelievedFrames()
    believed.push(posteriors(200, AA=1.0))
    assert mixed(believed) == pytest.approx(0.0, abs=1e-6)


def test_a_tenth_of_doubt_gives_the_soft_face_three_tenths():
    believed = BelievedFrames()
    believed.push(posteriors(200, AA=0.9, IY=0.1))
    assert mixed(believed) == pytest.approx(5.0 * 0.3, rel=1e-4)


def test_a_recogniser_that_knows_nothing_leaves_the_decided_face_its_part():
    believed = BelievedFrames()
    believed.push(posteriors(200, AA=0.5, IY=0.5))
    assert mixed(believed) == pytest.approx(5.0 * LARGEST_SHARE)


@pytest.mark.parametrize(
    "given",
    [
        posteriors(200, AA=0.5, IY=0.3),
        posteriors(200, AA=1.5, IY=-0.5),
        posteriors(200, AA=float("nan")),
        FramePosteriors(50, 0, DELAYS, posteriors(200, AA=0.5, IY=0.5).values),
        FramePosteriors(FRAMES_PER_S, 0, DELAYS, np.full((200, 3, 61), 1 / 61, np.float32)),
        FramePosteriors(FRAMES_PER_S, 0, (2, 7), posteriors(200, AA=0.5, IY=0.5).values),
    ],
    ids=["sum", "negative", "nan", "rate", "inventory", "heads"],
)
def test_what_are_no_posteriors_of_ours_is_passed_over(given):
    believed = BelievedFrames()
    believed.push(given)
    assert mixed(believed) == 0.0


def test_a_head_that_waits_longer_replaces_what_a_quick_one_believed():
    values = np.zeros((60, 3, len(PHONEMES)), np.float32)
    values[:, 0, AA], values[:, 1, SIL], values[:, 2, IY] = 1.0, 1.0, 1.0
    believed = BelievedFrames()
    believed.push(FramePosteriors(FRAMES_PER_S, 0, DELAYS, values))
    rows = believed.around(TRACK, np.array([0.45]), 1.0)[0]
    newest = 59
    for offset, row in zip(OFFSETS, rows, strict=True):
        frame = 45 + offset
        by_age = IY if frame <= newest - 12 else SIL if frame <= newest - 7 else AA
        if frame <= newest - 2:
            assert row.argmax() == by_age


def test_beyond_what_is_known_nothing_is_believed():
    rows = BelievedFrames().around(TRACK, np.array([0.95]), 1.0)[0]
    assert rows[OFFSETS <= 4].sum(axis=1) == pytest.approx(1.0)
    assert not rows[OFFSETS > 5].any()


def test_windows_are_means_of_their_frames():
    rows = np.random.default_rng(0).random((2, len(OFFSETS), 3)).astype(np.float32)
    means = window_means(rows)
    for number, (first, last) in enumerate(WINDOWS):
        inside = (first <= OFFSETS) & (last >= OFFSETS)
        np.testing.assert_allclose(means[:, number], rows[:, inside].mean(axis=1), rtol=1e-5)
    assert shares_of(np.zeros((1, len(OFFSETS), 3), np.float32))[0] <= LARGEST_SHARE


def test_a_line_heard_whole_has_the_shares_that_its_last_heads_give_it():
    """Five seconds, more than is remembered at once: doubted in the third, sure in the others."""
    heard = posteriors(512, AA=1.0)
    heard.values[212:312, -1, IY] = heard.values[212:312, -1, AA] = 0.5
    times_s = np.arange(400) / 100.0
    faces = softened_line(constant_map(), np.zeros((400, 1)), spoken(("AA", 5.0)), heard, times_s)
    assert not faces[:180].any()
    assert faces[220:280, 0] == pytest.approx(5.0 * LARGEST_SHARE)
    assert not faces[330:].any()


def test_old_frames_make_place_for_new_ones():
    believed = BelievedFrames()
    for first in range(0, 2000, 10):
        believed.push(posteriors(10, first, AA=0.5, IY=0.5))
    rows = believed.around(TRACK, np.array([19.5]), 19.6)
    assert rows.max() == 0.5
    assert believed.around(TRACK, AT, 0.6).max() == 1.0  # forgotten: as decided


def test_a_map_whose_arrays_do_not_fit_is_refused():
    constant_map().check(1)
    with pytest.raises(ValueError, match="soft/output has shape"):
        constant_map().check(2)
    with pytest.raises(ValueError, match="not finite"):
        constant_map(float("nan")).check(1)
