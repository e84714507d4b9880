import math
from dataclasses import replace

import numpy as np
import pytest
import soundfile
from small_network import random_weights
from speech import CLIP_PATH, white_noise

from lipsync.audio_block import AudioBlock
from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.energy_recognizer import EnergyRecognizer, NeutralRecognizer
from lipsync.recognition.fallback import FallbackLevel, FallbackRecognizer
from lipsync.recognition.network import WeightsError, load_weights, save_weights
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.timeline import PhonemeTimeline

RATE_HZ = 16_000
ENERGY = FallbackLevel("energy", EnergyRecognizer)


class Throwing(NetworkRecognizer):
    """The real recogniser until a moment, then a fault in it."""

    def __init__(self, fails_at_s):
        super().__init__(random_weights())
        self._fails_at_s = fails_at_s

    def feed(self, block):
        if block.start_s >= self._fails_at_s:
            raise FloatingPointError("a fault")
        super().feed(block)


def failing(at_s):
    return FallbackLevel("network", lambda: Throwing(at_s))


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0][: 3 * RATE_HZ]


def listen(recognizer, samples, start_s=0.0):
    """Feed samples in blocks of 10 ms from `start_s` on; return the timeline of all updates."""
    timeline = PhonemeTimeline(horizon_s=math.inf)
    for first in range(0, len(samples), 160):
        block = AudioBlock(samples[first : first + 160], start_s + first / RATE_HZ)
        recognizer.feed(block)
        for update in recognizer.updates():
            timeline.apply(update)
    return timeline


def test_the_first_level_that_can_be_made_listens():
    def missing():
        raise ImportError("no such library")

    recognizer = FallbackRecognizer([FallbackLevel("network", missing), ENERGY], 0.095)

    assert recognizer.level == "energy"
    assert recognizer.reasons == ("network: no such library",)


def test_a_fault_falls_back_a_level_and_what_was_final_stays(clip):
    recognizer = FallbackRecognizer(
        [FallbackLevel("network", lambda: Throwing(1.5)), ENERGY], 0.095
    )
    timeline = listen(recognizer, clip)
    sound = listen(NetworkRecognizer(random_weights()), clip[: int(1.49 * RATE_HZ)])
    border_s = sound.final_until_s - 0.01

    assert recognizer.level == "energy"
    assert "a fault" in recognizer.reasons[0]
    before = [e.phoneme for e in timeline.events if (e.end_s or math.inf) <= border_s]
    assert before == [e.phoneme for e in sound.events if (e.end_s or math.inf) <= border_s]
    after = {e.phoneme for e in timeline.events if e.start_s > 1.6}
    assert after <= {"AA", "AH", SILENCE}
    assert timeline.final_until_s > 2.8


@pytest.mark.filterwarnings("ignore:.*encountered in matmul:RuntimeWarning")
def test_weights_that_overflow_leave_the_jaw_to_loudness(clip):
    """Training that diverged: finite weights, whose products are no numbers."""
    weights = random_weights()
    layers = tuple(
        replace(each, kernel=each.kernel * np.float32(1e25)) for each in weights.residuals
    )
    overflowing = replace(weights, residuals=layers)
    network = FallbackLevel("network", lambda: NetworkRecognizer(overflowing))
    recognizer = FallbackRecognizer([network, ENERGY], 0.095)
    timeline = listen(recognizer, clip)
    assert recognizer.level == "energy"
    assert "the weights compute no finite numbers; train them again" in recognizer.reasons[0]
    assert {event.phoneme for event in timeline.events} <= {"AA", "AH", SILENCE}


def test_when_every_level_fails_the_mouth_is_closed(clip):
    recognizer = FallbackRecognizer([failing(0.5)], 0.095)
    timeline = listen(recognizer, clip)

    assert recognizer.level == "neutral"
    assert timeline.event_at(2.0).phoneme == SILENCE
    assert timeline.final_until_s == pytest.approx(3.0)


def test_a_level_slower_than_the_declared_latency_is_not_taken():
    late = FallbackLevel("network", lambda: NetworkRecognizer(random_weights(), 0.145))

    assert FallbackRecognizer([late, ENERGY], 0.095).level == "energy"


def test_reset_goes_back_to_the_best_level(clip):
    recognizer = FallbackRecognizer(
        [FallbackLevel("network", lambda: Throwing(0.5)), ENERGY], 0.095
    )
    listen(recognizer, clip)
    recognizer.reset()

    assert (recognizer.level, recognizer.reasons) == ("network", ())


def test_energy_opens_the_jaw_for_speech_and_not_for_steady_noise(clip):
    spoken = listen(EnergyRecognizer(), clip)
    assert {"AA", SILENCE} <= {e.phoneme for e in spoken.events}
    noise = white_noise(4.0, -40.0).astype(np.float32)
    steady = [e for e in listen(EnergyRecognizer(), noise).events if e.start_s > 1.6]
    assert {e.phoneme for e in steady} <= {SILENCE}


def test_the_neutral_level_takes_anything():
    neutral = NeutralRecognizer()
    neutral.feed(AudioBlock(np.full(10, np.nan, np.float32), 5.0))

    (update,) = neutral.updates()
    assert update.events[0].phoneme == SILENCE
    assert neutral.updates() == []


def test_weights_survive_the_file(tmp_path):
    weights = random_weights()
    path = tmp_path / "weights.npz"
    save_weights(weights, path)
    loaded = load_weights(path)

    assert loaded.delays == weights.delays
    assert loaded.residuals[2].dilation == 4
    assert np.abs(loaded.entry.kernel - weights.entry.kernel).max() < 1e-3


@pytest.mark.parametrize("spoil", ["cut", "text", "gone", "nan"])
def test_a_damaged_weights_file_is_named_in_one_line(tmp_path, spoil):
    path = tmp_path / "weights.npz"
    save_weights(random_weights(), path)
    if spoil == "cut":
        path.write_bytes(path.read_bytes()[:2_000])
    elif spoil == "text":
        path.write_text("no weights")
    elif spoil == "gone":
        path.unlink()
    else:
        with np.load(path) as file:
            arrays = dict(file)
        arrays["output"][0, 0] = np.nan
        np.savez(path, **arrays)
    with pytest.raises(WeightsError, match=r"weights\.npz: .*"):
        load_weights(path)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("format", 2, "of format 2, this lipservo reads format 1; update lipservo"),
        ("phonemes", np.array([*PHONEMES[:-1], "QQ"]), "made for other phonemes"),
    ],
)
def test_weights_that_mean_something_else_are_refused(tmp_path, name, value, said):
    path = tmp_path / "weights.npz"
    save_weights(random_weights(), path)
    with np.load(path) as file:
        arrays = dict(file) | {name: value}
    np.savez(path, **arrays)
    with pytest.raises(WeightsError, match=said) as refused:
        load_weights(path)
    assert "\n" not in str(refused.value)
