import time

import numpy as np
import pytest
from fake_sound_card import DEVICES, device, install_sound_card

from lipsync.audio.loudspeaker import LoudspeakerOutput
from lipsync.audio.source import SoundError


def speaker_of(card, device=None, offsets_ms=None):
    """A loudspeaker of that card, by its clock, looked after by the test."""
    return LoudspeakerOutput(device, offsets_ms, clock=card.clock, is_watched=False)


@pytest.fixture
def speaker(card):
    with speaker_of(card) as made:
        yield made


def ramp(n_samples, first=0):
    return np.arange(first + 1, first + n_samples + 1, dtype=np.float32) / 100_000


def play(card, n_blocks):
    """The card asks for so many blocks of 10 ms, each when the last is over."""
    frames = []
    for _ in range(n_blocks):
        frames.append(card.outputs[-1].ask())
        card.now_s += 0.01
    return np.concatenate(frames)


def test_what_is_written_is_played_in_order_on_every_channel(monkeypatch):
    card = install_sound_card(monkeypatch, channels=(2,))
    with speaker_of(card) as speaker:
        speaker.write(ramp(480))
        speaker.write(ramp(720, first=480))
        played = play(card, 3)

    assert speaker.rate_hz == 48_000
    assert card.outputs[0].settings["blocksize"] == 480
    np.testing.assert_array_equal(played[:1200], np.repeat(ramp(1200)[:, None], 2, axis=1))
    assert not np.any(played[1200:])
    assert card.outputs[0].is_closed


@pytest.mark.parametrize(
    ("rates_hz", "expected_hz"), [((16_000, 44_100), 44_100), ((16_000,), 16_000)]
)
def test_the_best_rate_that_the_device_can_is_taken(monkeypatch, rates_hz, expected_hz):
    card = install_sound_card(monkeypatch, rates_hz=rates_hz)
    with speaker_of(card) as speaker:
        assert speaker.rate_hz == card.outputs[0].rate_hz == expected_hz


def test_a_device_that_insists_on_all_its_channels_gets_them(monkeypatch):
    card = install_sound_card(monkeypatch, channels=(8,))
    with speaker_of(card, "HDMI"):
        assert card.outputs[0].n_channels == 8


def test_a_device_without_a_rate_of_ours_is_refused_in_one_line(monkeypatch):
    card = install_sound_card(monkeypatch, rates_hz=(8_000,))
    with pytest.raises(SoundError, match=r"'USB speaker.*' cannot be opened \(Invalid sample rate"):
        speaker_of(card)


def test_the_position_is_what_leaves_the_device_by_its_own_time_stamp(card, speaker):
    """The stream's clock is a thousand seconds ahead of the monotonic one."""
    assert speaker.position() is None
    speaker.write(ramp(960))
    card.outputs[0].ask(ahead_s=0.07)
    assert speaker.position() == (pytest.approx(100.07), 0.0)
    card.now_s += 0.01
    card.outputs[0].ask(ahead_s=0.068)
    assert speaker.position() == (pytest.approx(100.078), 0.01)
    assert speaker.latency_s == pytest.approx(0.08)


@pytest.mark.parametrize("dac_s", [0.0, 1_099.9, 1_200.0], ids=["zero", "past", "far"])
def test_a_time_stamp_that_makes_no_sense_is_replaced_by_the_claimed_latency(card, speaker, dac_s):
    card.outputs[0].ask(dac_s=dac_s)
    assert speaker.position() == (pytest.approx(100.06), 0.0)


def test_a_time_stamp_that_does_not_move_is_not_believed_twice(card, speaker):
    card.outputs[0].ask(dac_s=1_100.2)
    assert speaker.position()[0] == pytest.approx(100.2)
    card.now_s += 0.01
    card.outputs[0].ask(dac_s=1_100.2)
    assert speaker.position()[0] == pytest.approx(100.07)


def test_the_offset_of_the_device_is_added_and_that_of_another_is_not(card):
    with speaker_of(card, None, {"USB speaker": 250.0, "HDMI": 40.0}) as speaker:
        card.outputs[0].ask(ahead_s=0.05)
        assert speaker.position() == (pytest.approx(100.3), 0.0)
        assert speaker.latency_s == pytest.approx(0.32)


def test_where_nothing_is_ready_zeros_are_played_and_the_timeline_stands_still(card, speaker):
    speaker.write(ramp(720))
    play(card, 5)
    assert speaker.position()[1] == 720 / 48_000
    assert speaker.n_underruns == 0, "as at the end: nothing more may come"
    speaker.write(ramp(480, first=720))
    np.testing.assert_array_equal(play(card, 1)[:, 0], ramp(480, first=720))
    assert speaker.n_underruns == 1


def test_a_cut_is_heard_a_block_and_a_fade_after_what_the_device_has_taken(card):
    with speaker_of(card) as speaker:
        speaker.write(np.ones(9_600, np.float32))
        play(card, 4)
        silent_s = speaker.silence_rest()
        rest = play(card, 16)[:, 0]

    assert silent_s == pytest.approx(0.04 + 0.015)
    assert np.all(rest[:480] == 1.0)
    assert np.all(np.diff(rest) <= 0.0)
    assert not np.any(rest[720:])


def test_a_device_that_asks_for_no_more_stands_still_when_all_that_it_has_was_heard(card):
    with speaker_of(card, None, {"USB": 100.0}) as speaker:
        speaker.write(ramp(960))
        card.outputs[0].ask(ahead_s=0.05)
        card.now_s += 0.159
        assert speaker.position() == (pytest.approx(100.15), 0.0)
        card.now_s += 0.341
        assert speaker.position() == (pytest.approx(100.5), 0.01)


def test_late_blocks_of_the_device_itself_are_counted(card, speaker):
    card.outputs[0].ask(underflow=True)
    card.outputs[0].ask()
    assert speaker.n_underruns == 1


def test_a_device_that_is_lost_is_found_again_and_the_timeline_goes_on(card):
    """It has another number by then."""
    with speaker_of(card, "USB speaker") as speaker:
        speaker.write(ramp(1440))
        before = play(card, 1)
        card.outputs[0].active = False
        card.now_s += 1.0
        card.plugged = [DEVICES[3], device(1, "USB speaker: - (hw:5,0)", n_outputs=2)]
        speaker.watch.check()
        assert not speaker.is_lost
        assert speaker.position() == (card.now_s, 0.01)
        assert card.outputs[1].settings["device"] == 1
        after = play(card, 2)

    np.testing.assert_array_equal(np.concatenate((before, after))[:, 0], ramp(1440))
    assert speaker.watch.n_losses == 1


def test_while_it_is_lost_the_position_stays_and_nothing_waits(card, speaker):
    speaker.write(ramp(1440))
    play(card, 1)
    card.plugged = [DEVICES[1]]
    card.outputs[0].active = False
    for _ in range(50):
        card.now_s += 0.1
        speaker.watch.check()
        speaker.write(ramp(480))
    assert speaker.is_lost
    assert speaker.position() == (card.now_s, 0.01)
    speaker.silence_rest()
    assert 4 <= card.n_looks <= 5


def test_a_device_chosen_by_number_is_found_again_by_its_name(card):
    with speaker_of(card, 0) as speaker:
        card.plugged = [DEVICES[3], device(1, "USB speaker: - (hw:0,0)", n_outputs=2)]
        card.outputs[0].active = False
        card.now_s += 1.0
        speaker.watch.check()
        assert speaker.name == "USB speaker: - (hw:0,0)"


def test_a_device_that_begins_late_is_not_taken_for_lost(card, speaker):
    """A PulseAudio sink that slept calls three times and then not for a second."""
    play(card, 1)
    card.now_s += 1.2
    speaker.watch.check()
    assert not speaker.is_lost


def test_a_watched_device_is_found_again_by_the_thread(card):
    """No clock is asked: the thread is waited for."""
    with LoudspeakerOutput(clock=card.clock) as speaker:
        card.outputs[0].active = False
        card.now_s += 1.0
        while len(card.outputs) < 2:
            time.sleep(0.01)
    assert speaker.watch.n_losses == 1
    assert all(stream.is_closed for stream in card.outputs)


def test_the_volume_is_of_what_the_device_gets(monkeypatch):
    card = install_sound_card(monkeypatch, channels=(1,))
    with LoudspeakerOutput(volume=0.25, clock=card.clock, is_watched=False) as speaker:
        speaker.write(ramp(480))
        played = play(card, 1)

    np.testing.assert_allclose(played[:, 0], 0.25 * ramp(480), rtol=1e-6)
