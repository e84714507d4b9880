"""A robot with a microphone that speaks: it listens to nobody, itself included, while it does."""

import numpy as np
import pytest

from lipsync.audio.playout import ListenedMicrophone, Playout
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.audio_block import AudioBlock

RATE_HZ = 16_000
#: The microphone hears this all the time, the robot says the other.
HEARD, SAID = 0.25, 0.5


class Microphone:
    """Somebody speaks all the time; `now_s` is when. It hands over pieces of several blocks."""

    name, duration_s, is_live, lost_blocks = "microphone", None, True, 3

    def __init__(self, level=lambda _time_s: HEARD, n_at_once=1):
        self.now_s = 0.0
        self._level, self._n_at_once = level, n_at_once
        self._n_given = 0

    def blocks(self, until_s):
        """Return the blocks that were captured since the last call, of constant level."""
        assert until_s == float("inf"), "a device gives what it has"
        n_ready = round(self.now_s * 100) // self._n_at_once * self._n_at_once
        first, self._n_given = self._n_given, n_ready
        return [
            AudioBlock(np.full(160, self._level(n * 0.01), np.float32), n * 0.01)
            for n in range(first, n_ready)
        ]

    def __enter__(self):
        return self

    def __exit__(self, *exc): ...


class Robot:
    """The sound is heard as soon as it is committed, as nobody plays it late."""

    def __init__(self, microphone):
        self.microphone = microphone
        self.playout = Playout(None, ListenedMicrophone(microphone))
        self.heard = []

    def run(self, until_s):
        """Run until `until_s`; return the recogniser's level in each 10 ms since the beginning."""
        while len(self.heard) < round(until_s * 100):
            now_s = (len(self.heard) + 1) / 100
            self.microphone.now_s = now_s
            self.playout.advance(now_s - 0.01)
            self.heard += [float(each.samples[0]) for each in self.playout.blocks(now_s)]
        return np.array(self.heard)

    def say(self, duration_s):
        """Begin to say so much, and return the stream, which has not ended."""
        stream = PlayoutStream("a", RATE_HZ, RATE_HZ)
        stream.push(np.full(round(duration_s * RATE_HZ), SAID, np.float32))
        self.playout.requests.append(PlayoutRequest("say", stream))
        return stream


@pytest.fixture
def robot():
    """One that has listened for half a second."""
    made = Robot(Microphone())
    made.run(0.5)
    return made


def test_a_silent_robot_hears_its_microphone(robot):
    assert set(robot.run(1.0)[10:]) == {np.float32(HEARD)}
    assert (robot.playout.name, robot.playout.lost_blocks) == ("microphone", 3)


def test_sound_that_comes_in_pieces_of_40_ms_is_heard_without_holes():
    heard = Robot(Microphone(n_at_once=4)).run(3.0)
    assert set(heard[15:]) == {np.float32(HEARD)}


def test_while_it_speaks_it_hears_itself_alone_and_the_others_once_the_echo_is_over(robot):
    robot.say(0.4).end()
    heard = robot.run(2.0)
    assert set(heard[50:90]) == {np.float32(SAID)}
    assert not heard[91:120].any(), "0.3 s of echo"
    assert set(heard[130:]) == {np.float32(HEARD)}


def test_pauses_of_its_own_speech_belong_to_nobody_else(robot):
    stream = robot.say(0.2)
    heard = robot.run(1.5)  # the stream has dried up
    assert set(heard[50:70]) == {np.float32(SAID)}
    assert not heard[70:].any()
    stream.end()
    assert set(robot.run(2.5)[200:]) == {np.float32(HEARD)}


def test_after_an_interruption_the_others_are_heard_once_the_echo_is_over(robot):
    robot.say(5.0)
    robot.run(1.0)
    robot.playout.requests.append(PlayoutRequest("interrupt"))
    heard = robot.run(2.0)
    assert not heard[101:129].any()
    assert set(heard[140:]) == {np.float32(HEARD)}


def test_what_the_microphone_heard_while_the_robot_spoke_is_never_heard_later():
    """It held what was said to it then; that may have been the robot itself."""
    robot = Robot(Microphone(lambda time_s: SAID if 0.5 <= time_s < 1.0 else HEARD))
    robot.run(0.5)
    robot.say(0.5).end()
    assert not np.any(robot.run(3.0)[101:] == np.float32(SAID))


def test_what_is_said_while_the_loop_stalls_is_heard_and_what_is_too_much_is_counted():
    robot = Robot(Microphone(lambda time_s: 0.1 + 0.01 * time_s))
    robot.run(0.5)
    robot.microphone.now_s = 1.5
    robot.playout.advance(1.4)
    heard = [float(each.samples[0]) for each in robot.playout.blocks(1.5)]
    assert heard[0] == pytest.approx(robot.heard[-1] + 1e-4)
    np.testing.assert_allclose(np.diff(heard), 1e-4, atol=1e-6)
    assert robot.playout.lost_blocks == 3
    robot.microphone.now_s = 2.0  # half a second of it the timeline stood still
    robot.playout.blocks(1.51)
    assert robot.playout.lost_blocks == 3 + 43
