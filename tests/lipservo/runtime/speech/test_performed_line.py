"""A performance on a face that runs, beside what it says live: a virtual clock, no servos."""

import numpy as np
import pytest
from speaking_side import SpeakingSide
from spoken_phonemes import spoken

from lipservo.runtime.speech.performed_line import line_of
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.markers import CLOSED_GAP_MM
from lipsync.offline.performance import RATE_HZ, Performance, PerformedSound
from lipsync.offline.performed_motion import EASING_S

SOUND_RATE_HZ = 24_000
READY_S = 0.6
DURATION_S = 0.8
#: Speech asks for up to 14 degrees in 10 ms where a closure begins; a jump is more.
MOST_STEP_DEG = 6.0
JAW = "jaw"


def performance_of(face):
    """A mouth that opens wide and closes."""
    times_s = np.arange(round(DURATION_S * RATE_HZ) + 1) / RATE_HZ
    faces = np.tile(face.model.rest, (len(times_s), 1))
    faces[:, 0] += 12.0 * np.sin(2 * np.pi * 2.1 * times_s)
    known = spoken(("AA", DURATION_S))
    sound = PerformedSound("line.wav", "", None)
    return Performance(face.model.checksum, faces.astype(np.float32), known, sound, "heard")


def request(robot, stream, samples):
    stream.push(samples)
    stream.end()
    robot.playout.requests.append(PlayoutRequest("say", stream))


def perform(robot):
    performance = performance_of(robot.face)
    tone = np.full(round(DURATION_S * SOUND_RATE_HZ), 0.3, np.float32)
    line = line_of(performance, "line.perf", tone, SOUND_RATE_HZ)
    request(robot, line.stream(robot.playout), np.concatenate(list(line.chunks())))
    return performance


def speak(robot, *phones):
    known = spoken(*phones)
    stream = PlayoutStream("text", SOUND_RATE_HZ, robot.playout.output_rate_hz, known)
    request(robot, stream, np.full(round(known[-1].end_s * SOUND_RATE_HZ), 0.3, np.float32))


class At:
    """Does things, each once, at their seconds after the timeline began."""

    def __init__(self, *acts):
        self._acts = list(acts)

    def __call__(self, now_s):
        while self._acts and now_s >= self._acts[0][0]:
            self._acts.pop(0)[1]()


def began_s(robot, watched, after_s=0.0):
    """When the first sample that is no silence left the loudspeaker."""
    samples, left_s = robot.loudspeaker.played()
    found_s = left_s[np.abs(samples) > 0.1] - watched.zero_s
    return found_s[found_s > after_s][0]


def jaw_deg(robot, watched):
    """Times since the timeline began, and the jaw's goals."""
    number = list(robot.face.settings.servos).index(JAW)
    return watched.times_s - watched.zero_s, watched.encoders_deg[:, number]


def asked_deg(robot, performance):
    """The jaw of every stored face."""
    number = robot.face.calibration.servo_names.index(JAW)
    rows = [robot.face.calibration.positions_deg(face) for face in performance.coefficients]
    return np.array(rows)[:, number]


def check_performed(robot, watched, sound_s, performance):
    """The jaw goes where it is stored, with the sound, and nothing jumps."""
    times_s, seen_deg = jaw_deg(robot, watched)
    stored_deg = asked_deg(robot, performance)
    advance_s = robot.delay.actuation_s  # servos are asked sooner, by as much as they are late
    at_s = np.arange(len(stored_deg)) / RATE_HZ
    shown_deg = np.interp(sound_s + at_s - advance_s, times_s, seen_deg)

    assert np.ptp(stored_deg) > 3.0
    # What servos lag by is made up for by a filter too: close, and not the same.
    assert np.corrcoef(stored_deg, shown_deg)[0, 1] > 0.98
    inside = (times_s > sound_s - EASING_S) & (times_s < sound_s + DURATION_S + EASING_S)
    assert np.abs(np.diff(watched.encoders_deg[inside], axis=0)).max() <= MOST_STEP_DEG


def test_a_performance_is_shown_with_its_sound_on_a_face_that_speaks_otherwise():
    """Live speech, the performance twice, live speech: each where its sound is."""
    robot = SpeakingSide()
    made = []

    def all_of_it():
        speak(robot, ("AA", 0.3), ("M", 0.1))
        made.append(perform(robot))
        perform(robot)
        speak(robot, ("AA", 0.3), ("M", 0.1), ("AA", 0.2))

    watched = robot.run(READY_S + 4.6, At((READY_S, all_of_it)))
    first_s = began_s(robot, watched) + 0.4 + EASING_S
    line_s = 2 * EASING_S + DURATION_S

    check_performed(robot, watched, first_s, made[0])
    check_performed(robot, watched, first_s + line_s, made[0])
    gaps_mm, times_s = watched.gap_mm, watched.times_s - watched.zero_s
    live_s = first_s - EASING_S + 2 * line_s
    closing = (times_s > live_s + 0.3) & (times_s < live_s + 0.4)
    assert gaps_mm[closing].min() <= CLOSED_GAP_MM
    finished = [each.stream for each in robot.playout.events if each.kind == "finished"]
    assert finished == ["text", "line.perf", "line.perf", "text"]


@pytest.mark.parametrize("how", ["interrupt", "clear"])
def test_a_performance_that_is_cut_off_in_the_middle_leaves_a_closed_mouth(how):
    robot = SpeakingSide()
    cut_s = READY_S + robot.delay.total_s + EASING_S + 0.4
    watched = robot.run(
        4.5,
        At(
            (READY_S, lambda: perform(robot)),
            (cut_s, lambda: robot.playout.requests.append(PlayoutRequest(how))),
            (cut_s + 1.2, lambda: speak(robot, ("AA", 0.4), ("M", 0.1))),
        ),
    )
    times_s = watched.times_s - watched.zero_s
    silent_s = cut_s + (0.2 if how == "interrupt" else robot.delay.total_s + 0.4)

    def gap_mm(from_s, until_s):
        return watched.gap_mm[(times_s >= from_s) & (times_s < until_s)]

    assert gap_mm(cut_s - 0.3, cut_s).max() > 3.0 * CLOSED_GAP_MM
    assert gap_mm(silent_s, cut_s + 1.2).max() <= 2.0 * CLOSED_GAP_MM
    inside = (times_s > cut_s - 0.1) & (times_s < silent_s + 0.3)
    assert np.abs(np.diff(watched.encoders_deg[inside], axis=0)).max() <= MOST_STEP_DEG
    # What is said next is live.
    again_s = began_s(robot, watched, cut_s + 1.0)
    assert gap_mm(again_s + 0.1, again_s + 0.4).max() > 3.0 * CLOSED_GAP_MM
