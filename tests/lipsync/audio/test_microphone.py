import math
from functools import partial

import numpy as np
import pytest
from fake_sound_card import device, install_sound_card

from lipsync.audio.microphone import QUEUE_S, MicrophoneSource
from lipsync.audio.source import SoundError


@pytest.fixture
def install(monkeypatch):
    return partial(install_sound_card, monkeypatch)


def listen(card, device=None):
    """A microphone of that card, by its clock, looked after by the test."""
    return MicrophoneSource(device, clock=card.clock, is_watched=False)


@pytest.fixture
def microphone(card):
    with listen(card) as made:
        yield made


def ramp(n_samples, rate_hz=16_000):
    return np.arange(1, n_samples + 1) / rate_hz


def heard(blocks):
    return np.concatenate([block.samples for block in blocks])


def test_what_the_device_delivers_comes_out_in_blocks_of_10_ms(card):
    with listen(card) as microphone:
        card.inputs[0].deliver(ramp(400))
        blocks = microphone.blocks(math.inf)

    assert [block.start_s for block in blocks] == [0.0, 0.01]
    np.testing.assert_array_equal(heard(blocks), ramp(320).astype(np.float32))
    assert microphone.name == "USB mic: - (hw:2,0)"
    assert not card.inputs[0].active


def test_blocks_later_than_asked_for_wait(card, microphone):
    card.inputs[0].deliver(ramp(800))

    assert [b.start_s for b in microphone.blocks(0.02)] == [0.0, 0.01]
    assert [b.start_s for b in microphone.blocks(math.inf)] == [0.02, 0.03, 0.04]


def test_sound_dropped_from_a_full_queue_is_replaced_by_silence_of_the_same_length(
    card, microphone
):
    n_all = round(QUEUE_S * 100) + 30
    for n in range(n_all):
        card.inputs[0].deliver(np.full(160, (n + 1) / 1_000))
    blocks = microphone.blocks(math.inf)

    assert microphone.lost_blocks == 30
    assert len(blocks) == n_all
    assert not np.any(heard(blocks[:30]))
    assert blocks[30].samples[0] == np.float32(0.031)
    assert blocks[-1].samples[0] == np.float32(n_all / 1_000)


def test_sound_that_the_device_lost_is_replaced_by_as_much_silence_as_its_clock_says(card):
    with listen(card) as microphone:
        card.inputs[0].deliver(np.full(160, 0.1))
        card.inputs[0].deliver(np.full(160, 0.2), lost_before_s=0.05, overflow=True)
        blocks = microphone.blocks(math.inf)

    assert [float(b.samples[0]) for b in blocks] == pytest.approx([0.1, 0, 0, 0, 0, 0, 0.2])
    assert microphone.lost_blocks == 5


def test_a_device_clock_that_says_nothing_costs_one_block(card, microphone):
    card.inputs[0].deliver(np.full(160, 0.1))
    card.inputs[0].deliver(np.full(160, 0.2), overflow=True)

    assert len(microphone.blocks(math.inf)) == 3
    assert microphone.lost_blocks == 1


def test_a_device_that_cannot_do_16_khz_is_opened_at_its_own_rate_and_resampled(install):
    card = install(rates_hz=(48_000,))
    tone = np.sin(2 * np.pi * 300 * np.arange(48_000) / 48_000)
    with listen(card, "array") as microphone:
        stream = card.inputs[0]
        for first in range(0, 48_000, 480):
            stream.deliver(0.5 * tone[first : first + 480])
        samples = heard(microphone.blocks(math.inf))

    assert stream.rate_hz == 48_000
    assert len(samples) >= 15_680  # the resampler holds 20 ms back at most
    expected = 0.5 * np.sin(2 * np.pi * 300 * np.arange(len(samples)) / 16_000)
    np.testing.assert_allclose(samples[400:], expected[400:], atol=1e-3)


@pytest.mark.parametrize(
    ("channel", "level"), [("left", 0.1), ("right", 0.2), ("4", 0.4), ("mix", 0.25)]
)
def test_the_chosen_channel_of_a_microphone_is_heard(card, channel, level):
    microphone = MicrophoneSource("array", channel=channel, clock=card.clock, is_watched=False)
    with microphone:
        stream = card.inputs[0]
        assert stream.n_channels == (1 if channel == "mix" else 4)
        each = [0.25] if channel == "mix" else [0.1, 0.2, 0.3, 0.4]
        stream.deliver(np.tile(each, (320, 1)))
        np.testing.assert_allclose(heard(microphone.blocks(math.inf)), level, rtol=1e-6)


def test_a_channel_that_a_microphone_has_not_is_refused_before_it_is_opened(card):
    with pytest.raises(SoundError, match=r"USB mic.*: has 1 channel, not right"):
        MicrophoneSource(channel="right", clock=card.clock)
    assert not card.inputs


def test_listening_again_starts_at_sound_time_zero(card):
    microphone = listen(card)
    with microphone:
        card.inputs[0].deliver(ramp(480))
        microphone.blocks(math.inf)
    with microphone:
        card.inputs[1].deliver(ramp(160))

        assert [b.start_s for b in microphone.blocks(math.inf)] == [0.0]


def test_a_device_that_is_lost_is_silent_until_it_is_found_again(card):
    """The clock goes on: a second away is a second of silence, whatever its number is now."""
    with listen(card, "USB mic") as microphone:
        card.inputs[0].deliver(np.full(160, 0.1))
        assert len(microphone.blocks(math.inf)) == 1
        card.inputs[0].active = False
        card.now_s += 0.25
        microphone.watch.check()
        away = microphone.blocks(math.inf)
        card.plugged = [device(0, "array", n_inputs=4), device(1, "USB mic: - (hw:7,0)", 1)]
        card.now_s += 0.75
        microphone.watch.check()
        assert not microphone.is_lost
        card.now_s += 0.5
        slow = microphone.blocks(math.inf)
        card.now_s += 0.01
        card.inputs[1].deliver(np.full(160, 0.2))
        back = microphone.blocks(math.inf)

    assert len(away) == 25
    assert not np.any(heard(away))
    assert len(slow) == 125, "it is there, and has brought nothing yet"
    assert len(back) == 1
    assert back[-1].samples[0] == np.float32(0.2)
    assert back[-1].end_s == pytest.approx(0.01 + 1.51)
    assert (microphone.n_losses, microphone.lost_blocks) == (1, 150)
    assert microphone.name == "USB mic: - (hw:7,0)"


def test_a_lost_device_is_tried_again_at_most_once_a_second(card, microphone):
    card.plugged = []
    card.inputs[0].active = False
    for _ in range(100):
        card.now_s += 0.1
        microphone.watch.check()
    assert microphone.is_lost
    assert 9 <= card.n_looks <= 10
    assert len(microphone.blocks(math.inf)) == pytest.approx(1000, abs=1)


def test_a_device_that_stops_calling_is_lost_although_it_says_that_it_is_active(card, microphone):
    for _ in range(400):
        card.now_s += 0.01
        card.inputs[0].deliver(np.full(160, 0.1))
        microphone.watch.check()
    assert not microphone.is_lost
    card.now_s += 0.6
    microphone.watch.check()
    assert microphone.n_losses == 1
    assert card.inputs[0].is_closed
    assert len(card.inputs) == 2


def test_what_the_resampler_held_is_heard_before_the_silence(install):
    """Sound time stays the clock's: a second heard, then 0.2 s of silence."""
    card = install(rates_hz=(48_000,))
    with listen(card) as microphone:
        for _ in range(100):
            card.now_s += 0.01
            card.inputs[0].deliver(np.full(480, 0.5))
        first = heard(microphone.blocks(math.inf))
        card.plugged = []
        card.inputs[0].active = False
        card.now_s += 0.2
        microphone.watch.check()
        samples = np.concatenate((first, heard(microphone.blocks(math.inf))))

    assert len(first) < 16_000
    assert len(samples) == 19_200
    np.testing.assert_allclose(samples[400:15_600], 0.5, atol=1e-2)
    assert samples[15_900] > 0.3
    assert not np.any(samples[16_000:])


def test_a_microphone_that_is_read_while_it_is_opened_again_sounds_as_fast_as_before(install):
    card = install(rates_hz=(48_000,))
    heard_blocks = []

    def hear(n_blocks):
        for _ in range(n_blocks):
            card.now_s += 0.01
            card.inputs[-1].deliver(np.full(480, 0.5))
            card.now_s += 0.004
            heard_blocks.extend(microphone.blocks(math.inf))
            card.now_s -= 0.004

    with listen(card) as microphone:
        hear(100)
        card.inputs[0].active = False
        card.now_s += 1.0
        card.while_starting = lambda: hear(100)  # it calls back before `start` returns
        microphone.watch.check()
        hear(100)

    assert len(heard_blocks) == pytest.approx(400, abs=3)


def test_another_microphone_without_the_chosen_channel_is_not_taken(install):
    card = install(devices=[device(0, "USB array", n_inputs=4)])
    microphone = MicrophoneSource("USB", channel="4", clock=card.clock, is_watched=False)
    with microphone:
        card.inputs[0].active = False
        card.plugged = [device(0, "USB mic", n_inputs=1)]
        card.now_s += 1.0
        microphone.watch.check()
        assert (microphone.is_lost, microphone.name, len(card.inputs)) == (True, "USB array", 1)
        card.plugged = [device(0, "USB array", n_inputs=4)]
        card.now_s += 1.0
        microphone.watch.check()
        card.inputs[1].deliver(np.tile([0.1, 0.2, 0.3, 0.4], (160, 1)))
        assert microphone.blocks(math.inf)[-1].samples[0] == np.float32(0.4)


def test_a_device_that_refuses_at_the_start_is_an_error_in_one_line(card):
    card.refuses_to_start = True
    with pytest.raises(SoundError, match=r"microphone 'USB mic.*' cannot be opened"):
        listen(card).__enter__()
    assert card.inputs[0].is_closed


@pytest.mark.parametrize(("age_s", "expected_s"), [(0.03, 0.03), (-5.0, 0.06), (9.0, 0.06)])
def test_when_sound_was_captured_is_told_by_the_clock_of_the_card_if_it_makes_sense(
    card, microphone, age_s, expected_s
):
    for now_s in (100.0, 100.01):
        card.now_s = now_s
        card.inputs[0].deliver(np.zeros(160), age_s=age_s)
    microphone.blocks(math.inf)

    assert microphone.captured == (pytest.approx(100.01 - expected_s), 0.01)
