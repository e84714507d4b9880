"""Phonemes with times, where those times are wrong; what is heard is made of the true ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lipsync.phonemes import PHONEMES, FramePosteriors, PhonemeEvent
from lipsync.recognition.unit_follower import UnitFollower

DELAYS = (2, 7, 12)
SOUND_S = 4.0
N_FRAMES = round(SOUND_S * 100)
SAID = ("P", "IY", "SH", "AA", "M", "OW", "F", "EH", "W", "AY", "T", "UW", "K", "B", "ER", "TH")


def sentence(seed=0, phonemes=SAID):
    """Return random phonemes of 50 to 150 ms from 0.2 s on, no two equal ones in succession."""
    rng, events, at_s = np.random.default_rng(seed), [], 0.2
    while at_s < SOUND_S - 0.3:
        phoneme = rng.choice([p for p in phonemes if not events or p != events[-1].phoneme])
        end_s = at_s + float(rng.integers(5, 16)) / 100
        events.append(PhonemeEvent(str(phoneme), at_s, end_s))
        at_s = end_s
    return events


def moved_in_time(events, change):
    return [PhonemeEvent(e.phoneme, change(e.start_s), change(e.end_s)) for e in events]


def noisy_posteriors(events):
    """Return posteriors (n_frames, n_heads, n_phonemes) that are right in nine frames of ten."""
    rng = np.random.default_rng(1)
    values = np.full((N_FRAMES, len(DELAYS), len(PHONEMES)), 0.002, np.float32)
    for head, delay in enumerate(DELAYS):
        for frame in range(delay, N_FRAMES):
            time_s = (frame - delay + 0.5) / 100
            phonemes = [e.phoneme for e in events if e.start_s <= time_s < e.end_s] or ["SIL"]
            if rng.random() < 0.1:
                phonemes = [str(rng.choice(SAID))]
            values[frame, head, PHONEMES.index(phonemes[0])] = 0.9
    return values


def run_follower(told, said, until_s=SOUND_S):
    """Return the follower after `until_s` of sound, and by frame the phoneme of its units then.

    told: the units sent; said: the phonemes in the sound. A frame's phoneme is read 0.2 s after it.
    """
    follower, values, shown = UnitFollower(0.0), noisy_posteriors(said), {}
    follower.tell(told)
    for frame in range(round(until_s * 100)):
        follower.hear(FramePosteriors(100, frame, DELAYS, values[frame : frame + 1]))
        now_s = (frame - 20 + 0.5) / 100
        for start_s, end_s, events in follower.stretches(now_s, now_s + 1.0):
            if start_s <= now_s < end_s:
                covering = [e.phoneme for e in events if e.start_s <= now_s < e.end_s]
                shown[frame - 20] = covering[0]
    return follower, shown


def share_right(shown, said, from_s=1.0):
    """Return the share of frames from `from_s` on in which the units have the phoneme spoken.

    Frames that are left to the recogniser do not count.
    """
    frames = [
        (shown.get(round(e.start_s * 100) + n), e.phoneme)
        for e in said
        if e.start_s >= from_s and e.end_s < SOUND_S - 0.3
        for n in range(round((e.end_s - e.start_s) * 100))
    ]
    frames = [(one, other) for one, other in frames if one is not None]
    return np.mean([one == other for one, other in frames])


def test_true_times_stay_as_they_are():
    said = sentence()
    follower, shown = run_follower(said, said)
    assert share_right(shown, said, 0.0) == 1.0
    assert follower.shifted_s == 0.0


@settings(max_examples=8, deadline=None)
@given(st.integers(-60, 60), st.integers(0, 100))
def test_an_offset_is_found_within_a_second_whatever_is_said(offset, seed):
    said = sentence(seed)
    told = [e for e in moved_in_time(said, lambda s: s + offset / 100) if e.start_s >= 0.0]
    follower, shown = run_follower(told, said)
    assert follower.shifted_s == pytest.approx(-offset / 100, abs=0.011)
    assert share_right(shown, said) > 0.9


@pytest.mark.parametrize("pace", [0.97, 1.03])
def test_a_wrong_pace_is_followed(pace):
    said = sentence()
    _, shown = run_follower(moved_in_time(said, lambda s: s * pace), said)
    assert share_right(shown, said) > 0.75


def test_scattered_times_are_smoothed_where_what_is_heard_disagrees():
    said, rng = sentence(), np.random.default_rng(2)
    starts_s = sorted(max(0.0, e.start_s + rng.normal(0.0, 0.04)) for e in said)
    ends_s = [*starts_s[1:], SOUND_S]
    told = [PhonemeEvent(e.phoneme, *t) for e, *t in zip(said, starts_s, ends_s, strict=True)]
    _, shown = run_follower(told, said)
    as_told = {
        n: e.phoneme for e in told for n in range(round(e.start_s * 100), round(e.end_s * 100))
    }
    assert share_right(as_told, said) < 0.75
    assert share_right(shown, said) > 0.9


def test_units_of_another_sentence_are_left_for_what_is_heard():
    follower, shown = run_follower(sentence(5), sentence(0))
    assert not follower.is_believed
    assert not [n for n in shown if n > 150]


def test_units_are_believed_until_something_is_heard_and_end_with_their_sound():
    follower = UnitFollower(1.0)
    follower.tell([PhonemeEvent("M", 1.2, 1.3), PhonemeEvent("AA", 1.4, 1.9)])
    follower.end_s = 1.7
    ((start_s, end_s, events),) = follower.stretches(1.0, 3.0)
    assert (start_s, end_s) == (1.0, 1.7)
    assert [(e.phoneme, e.start_s) for e in events] == [
        ("SIL", 1.0), ("M", 1.2), ("SIL", 1.3), ("AA", 1.4),
    ]  # fmt: skip


def test_a_long_gap_between_units_is_left_to_what_is_heard():
    follower = UnitFollower(0.0)
    follower.tell([PhonemeEvent("M", 0.0, 0.1), PhonemeEvent("AA", 0.7, 0.9)])
    assert [(a, b) for a, b, _ in follower.stretches(0.0, 1.0)] == [(0.0, 0.1), (0.7, 0.9)]
