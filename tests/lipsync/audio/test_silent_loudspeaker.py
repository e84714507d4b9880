"""A loudspeaker that is none: its time passes as a device's does."""

import numpy as np
import pytest

from lipsync.audio.silent_loudspeaker import SilentLoudspeaker


@pytest.fixture
def clock():
    return [100.0]


@pytest.fixture
def speaker(clock):
    return SilentLoudspeaker(lambda: clock[0])


def second(speaker, duration_s=1.0):
    return np.ones(round(duration_s * speaker.rate_hz), dtype=np.float32)


def test_before_anything_is_written_it_has_nothing_to_report(speaker):
    assert speaker.position() is None


def test_sound_passes_from_when_it_is_written(speaker, clock):
    speaker.write(second(speaker))
    clock[0] += 0.25

    assert speaker.position() == (100.25, pytest.approx(0.25))


def test_where_nothing_was_written_its_time_stands_still_and_then_goes_on(speaker, clock):
    speaker.write(second(speaker))
    clock[0] += 60.0
    assert speaker.position()[1] == 1.0

    speaker.write(second(speaker))
    clock[0] += 0.5
    assert speaker.position()[1] == pytest.approx(1.5)


def test_more_that_is_written_in_time_does_not_hasten_it(speaker, clock):
    for _ in range(10):
        speaker.write(second(speaker, 0.1))
        clock[0] += 0.05

    assert speaker.position()[1] == pytest.approx(0.5)


def test_what_is_silenced_is_silent_from_now_on(speaker, clock):
    speaker.write(second(speaker))
    clock[0] += 0.3

    assert speaker.silence_rest() == pytest.approx(0.3)
