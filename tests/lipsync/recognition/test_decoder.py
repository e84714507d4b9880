from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lipsync.phonemes import PHONEMES, VISEME_OF
from lipsync.recognition.decoder import SMOOTH, DecoderSettings, PosteriorFormat, ViterbiDecoder

PLAIN = DecoderSettings(
    switch_penalty=0.0,
    closure_penalty=0.0,
    closure_bonus=0.0,
    phone_weight=1.0,
    waking_penalty=0.0,
    waking_frames=1,
)


def posteriors(*said):
    """One head's posteriors (n, 1, 40): the rest of each frame is spread over all phonemes."""
    frames = np.full((len(said), 1, len(PHONEMES)), 1e-3, np.float32)
    for frame, shares in zip(frames, said, strict=True):
        for phoneme, share in shares.items():
            frame[0, PHONEMES.index(phoneme)] = share
    return frames / frames.sum(axis=2, keepdims=True)


def decode(frames, delays, delay, settings_):
    decoder = ViterbiDecoder(PosteriorFormat(PHONEMES, delays), delay, settings_)
    answers = [decoder.push(decoder.scores(frame))[0] for frame in frames]
    return [PHONEMES[answer] for answer in answers if answer is not None]


@settings(max_examples=25)
@given(st.integers(0, 2**31))
def test_without_penalties_every_frame_is_its_own_best_phoneme(seed):
    frames = np.random.default_rng(seed).dirichlet(np.ones(40), (20, 1)).astype(np.float32)

    assert decode(frames, (0,), 0, PLAIN) == [PHONEMES[i] for i in frames[:, 0].argmax(axis=1)]


def test_a_penalty_removes_a_flicker_of_one_frame():
    frames = posteriors(*[{"AA": 0.6, "S": 0.4}] * 3, {"AA": 0.4, "S": 0.6}, *[{"AA": 0.6}] * 3)

    assert "S" in decode(frames, (0,), 0, PLAIN)
    assert set(decode(frames, (0,), 0, replace(PLAIN, switch_penalty=1.0))) == {"AA"}


def test_a_closure_changes_at_its_own_smaller_penalty():
    frames = posteriors(*[{"AA": 0.9}] * 3, {"AA": 0.3, "M": 0.7}, *[{"AA": 0.9}] * 3)
    hard = replace(PLAIN, switch_penalty=3.0, closure_penalty=3.0)
    quick = replace(PLAIN, switch_penalty=3.0, closure_penalty=0.3)

    assert "M" not in decode(frames, (0,), 0, hard)
    assert "M" in decode(frames, (0,), 0, quick)


def test_the_class_is_chosen_by_the_sum_of_its_phones():
    """T D S together .54 against AA .40, though AA is the best single phone."""
    frames = posteriors({"AA": 0.40, "T": 0.18, "D": 0.18, "S": 0.18})
    by_class = replace(PLAIN, phone_weight=0.1)

    (answer,) = decode(frames, (0,), 0, by_class)
    assert VISEME_OF[answer] == VISEME_OF["T"]


@pytest.mark.parametrize(("delays", "delay"), [((2, 7, 12), 2), ((2, 7, 12), 7), ((2, 7, 12), 12)])
def test_the_label_of_a_frame_comes_when_its_delay_is_over(delays, delay):
    """Every head says S about frame 20 alone, each at its own time."""
    frames = np.full((60, 3, 40), 1e-6, np.float32)
    frames[:, :, PHONEMES.index("AA")] = 1.0
    for head, wait in enumerate(delays):
        frames[20 + wait, head, :] = 1e-6
        frames[20 + wait, head, PHONEMES.index("S")] = 1.0
    decoder = ViterbiDecoder(PosteriorFormat(PHONEMES, delays), delay, DecoderSettings())
    for n, frame in enumerate(frames):
        answer, provisional = decoder.push(decoder.scores(frame))
        if answer is not None:
            assert (PHONEMES[answer] == "S") == (n - delay == 20)
            assert len(provisional) == delay - delays[0]


def test_a_quick_head_tells_a_closure_before_it_is_settled():
    frames = np.full((30, 2, 40), 1e-6, np.float32)
    frames[:, :, PHONEMES.index("AA")] = 1.0
    frames[12:, 0] = 1e-6
    frames[12:, 0, PHONEMES.index("M")] = 1.0  # the head with delay 2 about frame 10 on
    decoder = ViterbiDecoder(PosteriorFormat(PHONEMES, (2, 7)), 7, DecoderSettings())
    for frame in frames[:13]:
        settled, provisional = decoder.push(decoder.scores(frame))

    assert PHONEMES[settled] == "AA"
    assert PHONEMES[provisional[-1]] == "M"


def silence_then_speech(share_of_speech, n_frames, before=40):
    """Return posteriors of two heads: silence, `n_frames` of AA at a probability, silence.

    share_of_speech: that probability; the rest is silence's. before: frames of silence at first.
    """
    truth = [{"SIL": 1.0}] * before
    truth += [{"AA": share_of_speech, "SIL": 1.0 - share_of_speech}] * n_frames
    truth += [{"SIL": 1.0}] * 30
    one_head = posteriors(*truth)
    frames = np.repeat(one_head, 2, axis=1)
    # The quick head scores a frame 2 frames later, the late one 7.
    for head, delay in enumerate((2, 7)):
        frames[delay:, head] = one_head[:-delay, 0]
        frames[:delay, head] = one_head[0, 0]
    return frames


def frames_of_speech(frames, settings_=SMOOTH):
    answers = decode(frames, (2, 7), 7, settings_)
    return [index for index, answer in enumerate(answers) if answer != "SIL"]


def test_after_a_pause_a_sure_voice_is_settled_at_its_onset():
    assert frames_of_speech(silence_then_speech(0.999, 30))[0] == 40


def test_after_a_pause_a_blip_of_50_ms_wakes_nobody():
    assert frames_of_speech(silence_then_speech(0.999, 5)) == []
    asleep_never = replace(DecoderSettings(), waking_penalty=0.0, waking_frames=1)
    assert len(frames_of_speech(silence_then_speech(0.999, 5), asleep_never)) == 5


def test_with_patience_an_onset_is_told_as_early_and_settled_the_same():
    """Frame 40 is known to be speech at frame 47, whether 7 or 9 frames settle it."""
    frames = silence_then_speech(0.999, 30)
    told = {}
    for delay in (7, 9):
        decoder = ViterbiDecoder(PosteriorFormat(PHONEMES, (2, 7)), delay, SMOOTH)
        for n, frame in enumerate(frames):
            settled, later = decoder.push(decoder.scores(frame))
            path = [] if settled is None else [settled, *later]
            for place, number in enumerate(path):
                if PHONEMES[number] == "AA":
                    told.setdefault(delay, (n, n - delay + place))
    assert told == {7: (47, 40), 9: (47, 40)}


def test_what_is_hardly_likelier_than_silence_has_to_last():
    """ln(.8 / .2) is 1.4 a frame: eight for switching and waking take six frames."""
    frames = frames_of_speech(silence_then_speech(0.8, 30))
    assert 40 <= frames[0] <= 46
    assert frames_of_speech(silence_then_speech(0.8, 5)) == []
    assert frames_of_speech(silence_then_speech(0.6, 12)) == []


def test_within_speech_a_pause_of_a_stop_costs_nothing():
    """120 ms of silence between two vowels: the second is settled where it begins."""
    said = [{"SIL": 1.0}] * 20 + [{"AA": 0.99}] * 20 + [{"SIL": 0.99}] * 12 + [{"IY": 0.9}] * 5
    one = posteriors(*said, *[{"SIL": 0.99}] * 30)
    settled = decode(one, (0,), 0, DecoderSettings())
    assert "IY" in settled[52:57]
