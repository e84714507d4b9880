import itertools
import math

import numpy as np
import pytest
import soundfile
from lipservo_lab.evaluation.recognition.pocketsphinx_recognizer import PocketsphinxRecognizer
from speech import (
    CLIP_LABELS_PATH,
    CLIP_PATH,
    phoneme_frames,
    viseme_accuracy,
    white_noise,
)

from lipsync.audio_block import AudioBlock
from lipsync.phoneme_files.reader import read_phonemes
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.textgrid import LabelError
from lipsync.timeline import PhonemeTimeline

RATE_HZ = 16_000


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0]


def blocks_of(samples, n_block, start_s=0.0):
    for first in range(0, len(samples), n_block):
        part = samples[first : first + n_block].astype(np.float32)
        yield AudioBlock(part, start_s + first / RATE_HZ)


def listen(samples, *, n_block=160, ask_every_s=0.01, latency_s=0.15):
    """All updates of a recogniser that hears `samples` and is asked on a grid of sound time."""
    recognizer, updates, asked = PocketsphinxRecognizer(latency_s), [], 0
    for block in blocks_of(samples, n_block):
        recognizer.feed(block)
        if math.floor(block.end_s / ask_every_s + 1e-9) > asked:
            asked = math.floor(block.end_s / ask_every_s + 1e-9)
            updates += recognizer.updates()
    return updates


def events_of(updates):
    timeline = PhonemeTimeline(horizon_s=math.inf)
    for update in updates:
        timeline.apply(update)
    return timeline.events


def phonemes_of(updates):
    return {event.phoneme for update in updates for event in update.events}


@pytest.fixture(scope="module")
def clip_updates(clip):
    return listen(clip)


def test_it_hears_most_visemes_that_the_synthetic_voice_spoke(clip_updates):
    n_frames = 861
    truth = phoneme_frames(read_phonemes(CLIP_LABELS_PATH), n_frames)

    assert viseme_accuracy(phoneme_frames(events_of(clip_updates), n_frames), truth) > 0.55


@pytest.mark.slow
def test_it_hears_most_visemes_of_a_real_speaker(corpus_dir):
    accuracies = []
    for path in sorted((corpus_dir / "grid_s1" / "labels").glob("*.TextGrid"))[::250]:
        try:
            labels = read_phonemes(path)
        except LabelError:  # where alignment failed there is no tier of phones
            continue
        sound_path = corpus_dir / "grid_s1" / "audio" / f"{path.stem}.flac"
        samples = soundfile.read(sound_path, dtype="float32")[0]
        n_frames = len(samples) // 160
        heard = phoneme_frames(events_of(listen(samples)), n_frames)
        accuracies.append(viseme_accuracy(heard, phoneme_frames(labels, n_frames)))

    assert len(accuracies) >= 3
    assert np.mean(accuracies) > 0.6


def test_each_update_is_contiguous_with_its_last_event_open(clip_updates):
    for update in clip_updates:
        events = update.events
        assert events[0].start_s <= update.replace_from_s
        assert all(a.end_s == b.start_s for a, b in itertools.pairwise(events))
        assert all(a.phoneme != b.phoneme for a, b in itertools.pairwise(events))
        assert events[-1].end_s is None
        assert events[-1].start_s < update.heard_until_s


def test_an_update_reaches_back_to_what_was_final_and_not_before(clip_updates):
    for update, following in itertools.pairwise(clip_updates):
        assert following.replace_from_s == update.final_until_s
        assert update.final_until_s == pytest.approx(max(0.0, update.heard_until_s - 0.15))


def test_what_was_final_is_never_taken_back(clip_updates):
    timeline, final = PhonemeTimeline(horizon_s=math.inf), []
    for update in clip_updates:
        timeline.apply(update)
        n_final = round(update.final_until_s * 100)
        now_final = phoneme_frames(timeline.events, n_final)
        assert now_final[: len(final)] == final
        final = now_final


def test_an_event_keeps_its_start_when_the_border_passes_it(clip_updates):
    """So that a long vowel stays one event, however often it is told."""
    starts_told = {
        update.events[0].start_s
        for update in clip_updates
        if update.events[0].start_s < update.replace_from_s
    }

    assert starts_told <= {event.start_s for event in events_of(clip_updates)}


@pytest.mark.slow
@pytest.mark.parametrize("n_block", [1, 37, 1_600])
def test_the_size_of_the_blocks_does_not_matter(clip, n_block):
    samples = clip[:40_000]

    assert listen(samples, n_block=n_block, ask_every_s=0.1) == listen(samples, ask_every_s=0.1)


def test_ten_seconds_in_one_block_are_heard(clip):
    (update,) = listen(clip, n_block=160_000)

    assert update.replace_from_s == 0.0
    assert update.heard_until_s == 8.61
    assert len(update.events) > 50


def test_updates_without_new_sound_say_nothing(clip):
    recognizer = PocketsphinxRecognizer()
    recognizer.feed(AudioBlock(clip[:1_000], 0.0))

    assert len(recognizer.updates()) == 1
    assert recognizer.updates() == []


@pytest.mark.slow
@pytest.mark.parametrize("gap_s", [0.5, 0.503, 4.0, 7_200.0])
def test_a_gap_is_silence_and_what_follows_is_at_its_own_time(clip, gap_s):
    half = clip[:32_000]
    resumed_s = len(half) / RATE_HZ + gap_s
    recognizer, updates = PocketsphinxRecognizer(), []
    for block in [*blocks_of(half, 160), *blocks_of(half, 160, resumed_s)]:
        recognizer.feed(block)
        updates += recognizer.updates()
    events = events_of(updates)

    # The pause around the word boundary is heard before the hang-over ends.
    in_gap = [e for e in events if e.start_s >= 2.2 and (e.end_s or math.inf) <= resumed_s]
    assert {e.phoneme for e in in_gap} <= {SILENCE}
    again = [e for e in events if e.start_s > resumed_s and e.phoneme != SILENCE]
    assert again[0].start_s - resumed_s == pytest.approx(first_speech_s(clip), abs=0.05)
    assert updates[-1].heard_until_s == pytest.approx(resumed_s + 2.0, abs=0.01)


def first_speech_s(clip):
    return next(e.start_s for e in events_of(listen(clip[:32_000])) if e.phoneme != SILENCE)


def test_silence_is_one_long_event():
    updates = listen(np.zeros(48_000))

    assert events_of(updates) == (PhonemeEvent(SILENCE, 0.0, None),)


@pytest.mark.parametrize("level_db", [-50.0, -26.0])
def test_steady_noise_is_silence_after_a_second_and_a_half(level_db):
    updates = listen(white_noise(4.0, level_db), ask_every_s=0.05)

    assert phonemes_of(u for u in updates if u.replace_from_s > 1.5) == {SILENCE}


@pytest.mark.slow
def test_talk_without_a_pause_is_cut_after_15_s_and_goes_on(clip):
    """A stretch of the clip with no pause, again and again: more than two utterances' worth."""
    talk = np.tile(clip[int(4.85 * RATE_HZ) : int(5.35 * RATE_HZ)], 64)
    updates = listen(talk, ask_every_s=0.1)
    events = events_of(updates)

    silent_s = sum(e.end_s - e.start_s for e in events if e.phoneme == SILENCE and e.end_s)
    assert updates[-1].heard_until_s == pytest.approx(32.0)
    assert silent_s < 1.0
    assert max(len(update.events) for update in updates) < 30


def test_after_reset_the_same_sound_is_heard_the_same(clip):
    recognizer = PocketsphinxRecognizer()
    twice = []
    for _ in range(2):
        updates = []
        for block in blocks_of(clip[:24_000], 160):
            recognizer.feed(block)
            updates += recognizer.updates()
        twice.append(updates)
        recognizer.reset()

    assert twice[0] == twice[1]


def test_sound_beyond_full_scale_is_heard_as_clipped(clip):
    assert listen(3 * clip[:16_000]) == listen(np.clip(3 * clip[:16_000], -1, 1))


def test_blocks_at_another_rate_or_going_back_are_refused():
    recognizer = PocketsphinxRecognizer()
    recognizer.feed(AudioBlock(np.zeros(320, np.float32), 0.0))

    with pytest.raises(ValueError, match="48000 Hz; 16000 Hz is needed"):
        recognizer.feed(AudioBlock(np.zeros(480, np.float32), 0.02, 48_000))
    with pytest.raises(ValueError, match=r"starts at 0\.01 s, but sound was heard until 0\.02 s"):
        recognizer.feed(AudioBlock(np.zeros(160, np.float32), 0.01))


def test_a_negative_latency_is_refused():
    with pytest.raises(ValueError, match=r"latency_s is -0\.1"):
        PocketsphinxRecognizer(latency_s=-0.1)
