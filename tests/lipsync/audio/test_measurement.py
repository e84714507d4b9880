"""A measurement on a virtual clock: a loudspeaker, a room, a microphone."""

import numpy as np
import pytest
from lipservo_lab.bench.sync.speaking_robot import SimulatedLoudspeaker

from lipsync.audio.delay import measure_delay
from lipsync.audio.source import SoundError
from lipsync.audio_block import AudioBlock

RATE_HZ = 16_000


class Room:
    """A microphone that hears a loudspeaker some time after its sound is said to leave it."""

    name, duration_s, is_live, lost_blocks = "room", None, True, 0

    def __init__(self, speaker, later_s, begins_s=0.0):
        self.speaker, self.later_s, self.begins_s = speaker, later_s, begins_s
        self.now_s, self.n_blocks = begins_s, 0

    def clock(self):
        return self.now_s

    def sleep(self, duration_s):
        self.now_s += duration_s
        self.speaker.advance(self.now_s)

    @property
    def captured(self):
        return (self.begins_s + self.n_blocks * 0.01, self.n_blocks * 0.01)

    def blocks(self, _until_s):
        """Return the blocks captured until 20 ms ago; some only every quarter of a second."""
        if self.now_s < self.begins_s + self.n_blocks * 0.01 + 0.27:
            return []
        samples, left_s = self.speaker.played()
        found = []
        while self.begins_s + (self.n_blocks + 1) * 0.01 <= self.now_s - 0.02:
            captured_s = self.begins_s + self.n_blocks * 0.01 + np.arange(160) / RATE_HZ
            heard = np.zeros(160)
            if len(left_s):
                heard = np.interp(captured_s - self.later_s, left_s, samples, 0.0, 0.0)
            heard = (0.2 * heard).astype(np.float32)
            found.append(AudioBlock(heard, self.n_blocks * 0.01))
            self.n_blocks += 1
        return found


def measured(speaker, later_s=0.0, begins_s=0.0):
    room = Room(speaker, later_s, begins_s)
    return measure_delay(speaker, room, room.clock, room.sleep)


@pytest.mark.parametrize("later_s", [0.0, 0.25, -0.04, 1.2])
def test_what_the_loudspeaker_does_not_say_of_its_delay_is_found(later_s):
    speaker = SimulatedLoudspeaker(RATE_HZ, 0.1, 100e-6, 0.003, np.random.default_rng(2))
    found = measured(speaker, later_s, begins_s=50.0)
    assert found.median_s == pytest.approx(later_s, abs=1e-3)
    assert found.n_found == 7


def test_a_loudspeaker_that_stalls_for_a_moment_is_measured_all_the_same():
    speaker = SimulatedLoudspeaker(RATE_HZ)
    speaker.stall(51.6, 51.9)
    found = measured(speaker, 0.2, begins_s=50.0)
    assert found.median_s == pytest.approx(0.2, abs=2e-3)


def test_a_loudspeaker_that_does_not_play_is_told_after_a_while():
    speaker = SimulatedLoudspeaker(RATE_HZ)
    speaker.stall(0.0, 1e6)
    with pytest.raises(SoundError, match="the loudspeaker has not started to play"):
        measured(speaker)
