"""A robot that speaks, on a virtual clock: its loudspeaker is simulated, its servos left out."""

import numpy as np
import pytest
from lipservo_lab.bench.sync.speaking_robot import SimulatedLoudspeaker
from lipservo_lab.bench.sync.speech_timing import matched_errors_s, seen_closures
from speaking_side import ZERO_S, SpeakingSide
from spoken_phonemes import spoken

from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.markers import CLOSED_GAP_MM

RATE_HZ = 24_000
READY_S = 0.6
#: Slower than this nobody notices that lips and sound part (ITU-R BT.1359).
NOTICED_S = 0.045
#: Goals of speech itself go up to 14 degrees in 10 ms where a closure begins.
MOST_STEP_DEG = 6.0


def said(robot, *phones, name="a", ends=True):
    """A stream whose phonemes are known; every phoneme but SIL sounds."""
    known = spoken(*phones)
    samples = np.zeros(round(known[-1].end_s * RATE_HZ), np.float32)
    for event in known:
        if event.phoneme != "SIL":
            samples[round(event.start_s * RATE_HZ) : round(event.end_s * RATE_HZ)] = 0.3
    stream = PlayoutStream(name, RATE_HZ, robot.playout.output_rate_hz, known)
    stream.push(samples)
    if ends:
        stream.end()
    robot.playout.requests.append(PlayoutRequest("say", stream))
    return stream


class At:
    """Does things, each once, at their seconds after the timeline began."""

    def __init__(self, *acts):
        self._acts = list(acts)

    def __call__(self, now_s):
        while self._acts and now_s >= self._acts[0][0]:
            self._acts.pop(0)[1]()


def interrupt(robot):
    robot.playout.requests.append(PlayoutRequest("interrupt"))


def gap_mm(watched, from_s, until_s):
    times_s = watched.times_s - watched.zero_s
    return watched.gap_mm[(times_s >= from_s) & (times_s < until_s)]


def first_closed_s(watched, from_s):
    times_s = watched.times_s - watched.zero_s
    return times_s[(times_s >= from_s) & (watched.gap_mm <= CLOSED_GAP_MM)][0]


def sounding_s(robot, watched):
    """When each sample that is no silence left the loudspeaker, since the timeline began."""
    samples, left_s = robot.loudspeaker.played()
    return left_s[np.abs(samples) > 0.1] - watched.zero_s


def check_closures(watched, asked_s):
    """Lips close where the sound does."""
    seen = seen_closures(watched.times_s - watched.zero_s, watched.gap_mm)
    late_s, n_missing = matched_errors_s(asked_s, seen.closing_s)
    assert n_missing == 0
    assert np.abs(late_s).max() <= NOTICED_S


def check_smooth(watched, from_s, until_s):
    """Nothing jumps there."""
    times_s = watched.times_s - watched.zero_s
    goals_deg = watched.encoders_deg[(times_s >= from_s - 0.02) & (times_s < until_s)]
    assert np.abs(np.diff(goals_deg, axis=0)).max() <= MOST_STEP_DEG


VOWEL = ("SIL", 0.1), ("AA", 1.5)
#: As fast as speech; M closes after 0.15, 0.39 and 0.63 s.
SYLLABLES = (("EH", 0.15), ("M", 0.09)) * 3
SYLLABLES_CLOSE_S = np.array([0.15, 0.39, 0.63])
SYLLABLES_S = 0.72


def test_a_barge_in_closes_the_lips_within_200_ms_and_what_is_said_next_is_shown():
    robot = SpeakingSide()
    delay_s = robot.delay.total_s
    cut_s = READY_S + delay_s + 0.8
    watched = robot.run(
        3.6,
        At(
            (READY_S, lambda: said(robot, *VOWEL)),
            (cut_s, lambda: interrupt(robot)),
            (cut_s + 0.6, lambda: said(robot, ("SIL", 0.1), ("AA", 0.4), ("M", 0.1), name="b")),
        ),
    )
    assert gap_mm(watched, cut_s - 0.1, cut_s).min() > 3.0 * CLOSED_GAP_MM
    assert first_closed_s(watched, cut_s) - cut_s <= 0.200
    assert gap_mm(watched, cut_s + 0.2, cut_s + 0.6).max() <= 2.0 * CLOSED_GAP_MM
    again_s = sounding_s(robot, watched)
    again_s = again_s[again_s > cut_s + 0.5]
    assert gap_mm(watched, again_s[0] + 0.1, again_s[0] + 0.4).max() > 3.0 * CLOSED_GAP_MM
    assert gap_mm(watched, again_s[-1] - 0.15, again_s[-1]).min() <= CLOSED_GAP_MM
    check_smooth(watched, cut_s, cut_s + 0.6)


def test_what_is_said_at_once_after_a_barge_in_is_shown_with_its_sound():
    """As an agent does that answers: the new stream is there in the tick of the interruption."""
    robot = SpeakingSide()
    cut_s = READY_S + robot.delay.total_s + 0.8

    def answer():
        interrupt(robot)
        said(robot, *SYLLABLES, name="b")

    watched = robot.run(3.2, At((READY_S, lambda: said(robot, *VOWEL)), (cut_s, answer)))
    left_s = sounding_s(robot, watched)
    began_s = left_s[left_s > cut_s + 0.1][0]
    check_closures(watched, began_s + SYLLABLES_CLOSE_S)
    check_smooth(watched, cut_s, cut_s + 0.3)


@pytest.mark.parametrize("stalled_s", [0.6, 1.5])
def test_a_loudspeaker_that_stands_still_closes_the_mouth_which_goes_on_with_the_sound(stalled_s):
    robot = SpeakingSide()
    stall_s = READY_S + robot.delay.total_s + 0.5
    # A long vowel; then closures, by which one sees whether lips and sound have met again.
    robot.loudspeaker.stall(ZERO_S + stall_s, ZERO_S + stall_s + stalled_s)
    began = At((READY_S, lambda: said(robot, ("AA", 1.0), *SYLLABLES)))
    watched = robot.run(stall_s + stalled_s + 2.0, began)
    assert gap_mm(watched, stall_s - 0.1, stall_s).min() > 3.0 * CLOSED_GAP_MM
    # What the device holds is still heard when it takes no more.
    left_s = sounding_s(robot, watched)
    stood_s = left_s[:-1][np.diff(left_s) > 0.9 * stalled_s][0]
    assert gap_mm(watched, stood_s + 0.4, stood_s + stalled_s).max() <= CLOSED_GAP_MM
    # Each M, where its sound truly was.
    n_from = (1.0 + SYLLABLES_CLOSE_S) * robot.loudspeaker.rate_hz
    samples, all_left_s = robot.loudspeaker.played()
    first = np.flatnonzero(np.abs(samples) > 0.1)[0]
    asked_s = all_left_s[first + n_from.astype(int)] - watched.zero_s
    check_closures(watched, asked_s)
    check_smooth(watched, stood_s, stood_s + stalled_s + 0.2)


def test_a_stopped_face_has_no_sound_left_to_play():
    robot = SpeakingSide()
    said(robot, *VOWEL)
    watched = robot.run(1.2)
    assert len(sounding_s(robot, watched)) > 0
    stopped_s = watched.times_s[-1] - watched.zero_s
    n_written = robot.playout.committed_s
    robot.stop()
    assert sounding_s(robot, watched).max() <= stopped_s + robot.loudspeaker.latency_s + 0.02
    assert robot.playout.committed_s == n_written
    assert robot.playout.is_over
    (event,) = [each for each in robot.playout.events if each.kind == "interrupted"]
    assert event.n_dropped > 0


def test_a_stopped_face_takes_up_nothing_that_comes_later():
    robot = SpeakingSide()
    watched = robot.run(0.5)
    said(robot, *VOWEL)
    robot.stop()
    assert robot.playout.is_over
    assert len(sounding_s(robot, watched)) == 0


def test_the_face_waits_for_a_late_loudspeaker_and_meets_its_sound():
    robot = SpeakingSide(SimulatedLoudspeaker(latency_s=0.35))
    assert robot.delay.loudspeaker_s > 0.0
    assert robot.delay.total_s >= robot.loudspeaker.latency_s
    watched = robot.run(2.5, At((READY_S, lambda: said(robot, *SYLLABLES))))
    began_s = sounding_s(robot, watched)[0]
    check_closures(watched, began_s + SYLLABLES_CLOSE_S)


def test_two_streams_in_a_row_are_both_shown_with_their_sound():
    robot = SpeakingSide()

    def both():
        said(robot, *SYLLABLES)
        said(robot, *SYLLABLES, name="b")

    watched = robot.run(3.2, At((READY_S, both)))
    began_s = sounding_s(robot, watched)[0]
    check_closures(watched, began_s + SYLLABLES_CLOSE_S)
    check_closures(watched, began_s + SYLLABLES_S + SYLLABLES_CLOSE_S)
    ends = [(each.stream, each.kind) for each in robot.playout.events if each.kind == "finished"]
    assert ends == [("a", "finished"), ("b", "finished")]


@pytest.mark.parametrize("how", ["ends", "dries up", "is cleared"])
def test_a_stream_that_is_over_in_the_middle_of_a_vowel_leaves_a_closed_mouth(how):
    robot = SpeakingSide()
    acts = [(READY_S, lambda: said(robot, ("SIL", 0.1), ("AA", 0.8), ends=how == "ends"))]
    if how == "is cleared":
        acts.append((READY_S + 0.4, lambda: robot.playout.requests.append(PlayoutRequest("clear"))))
    watched = robot.run(2.5, At(*acts))
    left_s = sounding_s(robot, watched)
    assert gap_mm(watched, left_s[-1] - 0.2, left_s[-1]).max() > 3.0 * CLOSED_GAP_MM
    assert gap_mm(watched, left_s[-1] + 0.4, 2.5).max() <= CLOSED_GAP_MM
    check_smooth(watched, left_s[-1], 2.5)
