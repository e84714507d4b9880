import itertools
import math

import numpy as np
import pytest
import soundfile
import soxr
from small_network import random_weights
from speech import CLIP_PATH, phoneme_frames

from lipsync.audio_block import AudioBlock
from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.batch import settled_phonemes
from lipsync.recognition.decoder import ViterbiDecoder
from lipsync.recognition.features import LevelNormalizer, LogMelStream, log_mel
from lipsync.recognition.network import StreamingNetwork
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.posteriors import PosteriorStream
from lipsync.text_to_speech.pronunciation import pronounced
from lipsync.timeline import PhonemeTimeline

RATE_HZ = 16_000
WEIGHTS = random_weights()


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0][: 4 * RATE_HZ]


def blocks_of(samples, n_block, start_s=0.0, rate_hz=RATE_HZ):
    for first in range(0, len(samples), n_block):
        yield AudioBlock(samples[first : first + n_block], start_s + first / rate_hz, rate_hz)


def listen(recognizer, blocks):
    """Feed all blocks; return the timeline of all updates, and the updates."""
    timeline, updates = PhonemeTimeline(horizon_s=math.inf), []
    for block in blocks:
        recognizer.feed(block)
        for update in recognizer.updates():
            timeline.apply(update)
            updates.append(update)
    return timeline, updates


def settled(timeline):
    return phoneme_frames(timeline.events, round(timeline.final_until_s * 100))


def test_log_mel_agrees_with_a_filter_bank_worked_out_bin_by_bin():
    """A tone of 1 kHz: all its power lies in the triangles around 1 kHz."""
    tone = np.sin(2 * np.pi * 1000 * np.arange(400) / RATE_HZ).astype(np.float32)
    power = np.abs(np.fft.rfft(tone * np.hamming(400), 512)) ** 2
    mel = np.linspace(2595 * math.log10(1 + 60 / 700), 2595 * math.log10(1 + 7600 / 700), 42)
    hz = 700 * (10 ** (mel / 2595) - 1)
    expected = []
    for low, middle, high in zip(hz, hz[1:], hz[2:], strict=False):
        total = 0.0
        for k, p in enumerate(power):
            f = k * RATE_HZ / 512
            if low < f < high:
                total += p * min((f - low) / (middle - low), (high - f) / (high - middle))
        expected.append(math.log(total + 1e-7))

    assert log_mel(tone)[0] == pytest.approx(expected, abs=1e-3)


def test_the_stream_equals_the_batch(clip):
    features = LevelNormalizer(WEIGHTS.scale).push(LogMelStream().push(clip))
    stream = StreamingNetwork(WEIGHTS)
    streamed = np.concatenate([stream.push(features[n : n + 1]) for n in range(len(features))])

    assert np.abs(streamed - StreamingNetwork(WEIGHTS).push(features)).max() < 1e-5


@pytest.mark.parametrize("n_block", [1, 37, 160, 4_000])
def test_features_do_not_depend_on_the_size_of_the_blocks(clip, n_block):
    stream = LogMelStream()
    pieces = [stream.push(clip[n : n + n_block]) for n in range(0, 8_000, n_block)]
    whole = LogMelStream().push(
        clip[: 8_000 // n_block * n_block + (n_block if 8_000 % n_block else 0)]
    )

    assert np.abs(np.concatenate(pieces) - whole).max() < 1e-5


def test_a_voice_20_db_lower_looks_the_same_once_it_was_heard(clip):
    loud = LevelNormalizer(WEIGHTS.scale).push(LogMelStream().push(clip))
    quiet = LevelNormalizer(WEIGHTS.scale).push(LogMelStream().push(clip / 10))

    assert np.abs(loud - quiet)[200:].mean() < 0.1


@pytest.mark.parametrize("latency_s", [0.045, 0.095, 0.145])
@pytest.mark.parametrize("n_block", [37, 1_600])
def test_the_size_of_the_blocks_does_not_matter(clip, latency_s, n_block):
    whole, _ = listen(NetworkRecognizer(WEIGHTS, latency_s), blocks_of(clip, 160))
    other, _ = listen(NetworkRecognizer(WEIGHTS, latency_s), blocks_of(clip, n_block))
    n = min(len(settled(whole)), len(settled(other)))

    assert n > 350
    assert settled(whole)[:n] == settled(other)[:n]


@pytest.mark.parametrize(("latency_s", "patience_s"), [(0.045, 0.0), (0.095, 0.02), (0.145, 0.0)])
def test_the_declared_latency_holds_at_every_moment(clip, latency_s, patience_s):
    recognizer = NetworkRecognizer(WEIGHTS, latency_s)
    final_s = heard_s = 0.0
    for block in blocks_of(clip[:16_000], 37):
        recognizer.feed(block)
        for update in recognizer.updates():
            final_s, heard_s = update.final_until_s, update.heard_until_s
        assert heard_s >= block.end_s - recognizer.latency_s - 1e-9
        assert final_s >= block.end_s - recognizer.latency_s - patience_s - 1e-9


def test_a_phoneme_that_is_due_changes_for_20_ms_at_the_most(clip):
    """Look-ahead hides it: with 100 ms a face is decided 80 ms after its phoneme was final."""
    timeline, recognizer = PhonemeTimeline(horizon_s=math.inf), NetworkRecognizer(WEIGHTS)
    due: dict[int, list[str]] = {}
    for block in blocks_of(clip, 160):
        recognizer.feed(block)
        for update in recognizer.updates():
            timeline.apply(update)
            newest = round(update.heard_until_s * 100) - 8
            labels = phoneme_frames(timeline.events, max(0, newest))
            for frame, label in enumerate(labels[-8:], max(0, newest - 8)):
                due.setdefault(frame, []).append(label)
    kinds = [[*labels[:3], *set(labels[2:])] for labels in due.values() if len(labels) == 8]

    assert all(len(labels) == 4 for labels in kinds)
    assert any(len(set(labels)) > 1 for labels in kinds)


def test_what_is_final_is_told_from_and_never_taken_back(clip):
    timeline, final = PhonemeTimeline(horizon_s=math.inf), []
    recognizer = NetworkRecognizer(WEIGHTS)
    previous = None
    for block in blocks_of(clip, 160):
        recognizer.feed(block)
        for update in recognizer.updates():
            assert previous is None or update.replace_from_s == previous.final_until_s
            assert update.heard_until_s <= block.end_s + 1e-9
            pairs = itertools.pairwise(update.events)
            assert all(a.end_s == b.start_s and a.phoneme != b.phoneme for a, b in pairs)
            timeline.apply(update)
            now = settled(timeline)
            assert now[: len(final)] == final
            final, previous = now, update
    assert len(final) > 380


def test_whole_recordings_at_once_give_what_is_settled_live(clip):
    """Three recordings side by side, of different lengths; live each is followed by silence."""
    recordings = [clip[:20_000], clip[20_000:], clip[5_000:37_000]]
    for samples, events in zip(recordings, settled_phonemes(WEIGHTS, recordings), strict=True):
        n_frames = len(samples) // 160
        tail = np.zeros(4_000, np.float32)
        live, _ = listen(
            NetworkRecognizer(WEIGHTS), blocks_of(np.concatenate([samples, tail]), 160)
        )
        assert events[-1].end_s == pytest.approx(len(samples) / RATE_HZ)
        assert phoneme_frames(events, n_frames) == settled(live)[:n_frames]


def test_after_reset_the_same_is_heard_again(clip):
    recognizer = NetworkRecognizer(WEIGHTS)
    _, first = listen(recognizer, blocks_of(clip[:16_000], 160))
    recognizer.reset()
    _, again = listen(recognizer, blocks_of(clip[:16_000], 160))

    assert first == again


@pytest.mark.parametrize("gap_s", [0.3, 0.503, 4.0, 7_200.0])
def test_a_gap_is_silence_and_time_stays_right(clip, gap_s):
    resumed_s = 1.0 + gap_s
    blocks = [*blocks_of(clip[:16_000], 160), *blocks_of(clip[:16_000], 160, resumed_s)]
    timeline, updates = listen(NetworkRecognizer(WEIGHTS), blocks)
    in_gap = [e for e in timeline.events if e.start_s > 1.1 and (e.end_s or math.inf) < resumed_s]

    assert {e.phoneme for e in in_gap} <= {SILENCE}
    assert updates[-1].heard_until_s == pytest.approx(resumed_s + 1.0, abs=0.03)
    if gap_s > 1.0:
        assert timeline.event_at(resumed_s - 0.1).phoneme == SILENCE


@pytest.mark.parametrize("rate_hz", [8_000, 44_100, 48_000])
def test_another_rate_is_heard_at_the_same_times(clip, rate_hz):
    """soxr itself holds back some sound: what is known may end earlier by that, its times stay."""
    samples = soxr.resample(clip, RATE_HZ, rate_hz).astype(np.float32)
    n_block = rate_hz // 100
    timeline, updates = listen(
        NetworkRecognizer(WEIGHTS), blocks_of(samples, n_block, rate_hz=rate_hz)
    )

    assert updates[-1].heard_until_s == pytest.approx(4.0, abs=0.08)
    if rate_hz > 16_000:
        truth, _ = listen(NetworkRecognizer(WEIGHTS), blocks_of(clip, 160))
        n = len(settled(timeline))
        same = np.mean([a == b for a, b in zip(settled(timeline), settled(truth)[:n], strict=True)])
        assert same > 0.9


def test_nan_infinity_and_overload_do_no_harm(clip):
    spoilt = 20.0 * clip[:32_000]
    spoilt[5_000:5_100] = np.nan
    spoilt[9_000] = np.inf
    recognizer = NetworkRecognizer(WEIGHTS)
    listen(recognizer, blocks_of(spoilt, 160))
    recognizer.feed(AudioBlock(clip[:160], 2.0))
    (update,) = recognizer.updates()

    assert update.heard_until_s == pytest.approx(2.0, abs=0.011)


def test_digital_silence_is_silence_whatever_the_network_says():
    timeline, _ = listen(NetworkRecognizer(WEIGHTS), blocks_of(np.zeros(32_000, np.float32), 160))

    assert {event.phoneme for event in timeline.events} == {SILENCE}


def test_blocks_going_back_or_changing_their_rate_are_refused():
    recognizer = NetworkRecognizer(WEIGHTS)
    recognizer.feed(AudioBlock(np.zeros(320, np.float32), 0.0))

    with pytest.raises(ValueError, match=r"starts at 0\.01 s, but sound was heard until 0\.02 s"):
        recognizer.feed(AudioBlock(np.zeros(160, np.float32), 0.01))
    with pytest.raises(ValueError, match="48000 Hz in a stream at 16000 Hz"):
        recognizer.feed(AudioBlock(np.zeros(480, np.float32), 0.02, 48_000))


def test_a_latency_that_no_head_can_keep_is_refused():
    with pytest.raises(ValueError, match=r"needs at least 0\.045"):
        NetworkRecognizer(WEIGHTS, 0.03)


@pytest.mark.slow
def test_an_hour_of_sound_leaves_no_more_behind_than_a_minute(clip):
    """What is kept is counted, not the process: the same number of labels after any time."""
    recognizer = NetworkRecognizer(WEIGHTS)
    kept = []
    for n in range(120):
        recognizer.feed(AudioBlock(clip[:16_000], n * 30.0))
        recognizer.updates()
        kept.append(len(recognizer._settled) + len(recognizer._provisional))

    assert kept[-1] == kept[2] < 20


def heard_posteriors(updates):
    """Of all updates, in order: (n, n_heads, n_phonemes), and the first frame."""
    told = [update.posteriors for update in updates if update.posteriors is not None]
    for one, following in itertools.pairwise(told):
        assert one.first_frame + len(one.values) == following.first_frame
    return np.concatenate([each.values for each in told]), told[0].first_frame


@pytest.mark.parametrize("n_block", [160, 1234])
def test_updates_carry_the_posteriors_that_they_were_decided_from(clip, n_block):
    _, updates = listen(NetworkRecognizer(WEIGHTS), blocks_of(clip, n_block))
    values, first = heard_posteriors(updates)
    expected = PosteriorStream(WEIGHTS).push(clip)[: len(values)]
    assert first == 0
    np.testing.assert_allclose(values, expected, atol=1e-4)


def test_after_a_jump_in_time_frames_are_counted_in_sound_time(clip):
    recognizer = NetworkRecognizer(WEIGHTS)
    before = blocks_of(clip[:16_000], 160)
    after = blocks_of(clip[16_000:32_000], 160, start_s=61.0)
    _, updates = listen(recognizer, itertools.chain(before, after))
    last = updates[-1].posteriors
    assert last.first_frame + len(last.values) == round(updates[-1].heard_until_s * 100) - 1


@pytest.mark.parametrize(("words", "are_said"), [(None, True), ("seven kites in autumn", False)])
def test_words_are_not_doubted_while_they_are_followed(clip, words, are_said):
    recognizer = NetworkRecognizer(WEIGHTS)
    recognizer.tell(pronounced(words or CLIP_PATH.with_suffix(".txt").read_text()))
    _, updates = listen(recognizer, blocks_of(clip[: 2 * RATE_HZ], 160))
    assert (updates[-1].posteriors is None) == are_said


def test_sound_after_silence_is_heard_as_if_the_network_had_heard_every_frame_of_it(clip):
    silence = np.zeros(round(1.37 * RATE_HZ), np.float32)
    samples = np.concatenate((clip[:RATE_HZ], silence, clip[RATE_HZ : 2 * RATE_HZ]))
    stream = PosteriorStream(WEIGHTS)
    found = np.concatenate([stream.push(piece) for piece in np.split(samples, 337)])

    network, normalizer = StreamingNetwork(WEIGHTS), LevelNormalizer(WEIGHTS.scale)
    heard = network.push(normalizer.push(LogMelStream().push(samples)))
    newest_silent = np.flatnonzero(found[:, 0, PHONEMES.index(SILENCE)] == 1.0).max()
    after = newest_silent + WEIGHTS.delays[-1] + 1
    assert len(found) - after > 70
    np.testing.assert_allclose(found[after:], heard[after:], atol=1e-5)


def test_lasting_silence_is_decoded_as_any_other_frames():
    rng = np.random.default_rng(3)
    form = PosteriorStream(WEIGHTS).format
    decoder, thorough = (ViterbiDecoder(form, form.delays[0] + 3) for _ in range(2))
    noise = rng.dirichlet(np.full(len(PHONEMES), 0.1), (20, len(form.delays))).astype(np.float32)
    frames = [*decoder.scores(noise), *[decoder.silence] * 90, *decoder.scores(noise[::-1])]
    for scores in frames:
        assert decoder.push(scores) == thorough.push(scores.copy())
        assert decoder.is_awake == thorough.is_awake
