"""Performances on a mouth that does something else: the stored faces, and the ways between."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lipsync.face.frame import NO_EXPRESSION, Expression, Frame
from lipsync.motion.finishing import LipGap
from lipsync.motion.still_motion import StillMotion
from lipsync.offline.performance import RATE_HZ, Performance, PerformedSound
from lipsync.offline.performed_motion import EASING_S, PerformedMotion, StoredMotion
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate

REST = np.array([1.0, -2.0, 0.5])
EVENTS = (PhonemeEvent("SIL", 0.0, 0.02), PhonemeEvent("M", 0.02, 0.08))
FACES = arrays(
    np.float32,
    st.tuples(st.integers(1, 9), st.just(3)),
    elements=st.floats(-30, 30, width=32),
)


#: The gap is the first coefficient in millimetres.
GAP = LipGap(np.zeros(3), np.diag([1.0, 0.0, 0.0]), np.diag([1.0, 0.0, 0.0]))


class Swaying(StillMotion):
    """Another mouth, that moves by itself."""

    def frame_at(self, time_s):
        return Frame(time_s, self._rest + 4.0 * np.sin(9.0 * time_s))


def stored(faces, **expression):
    columns = {name: np.asarray(each, np.float32) for name, each in expression.items()}
    sound = PerformedSound("line.wav", "", b"")
    return StoredMotion(Performance("x", faces, EVENTS, sound, "heard", columns))


def motion_of(faces, place_s=lambda time_s: time_s, inner=None, **expression):
    """Return the synthesiser of one performance of these faces.

    place_s: returns, for a sound time in s, the time since the performance's first face, or None.
    """
    performed = stored(faces, **expression)

    def performed_at(time_s):
        at_s = place_s(time_s)
        return None if at_s is None else (performed, at_s)

    return PerformedMotion(inner or StillMotion(REST), performed_at, GAP)


@given(FACES)
def test_at_the_times_of_the_file_its_faces_are_shown(faces):
    motion = motion_of(faces)

    shown = [motion.frame_at(n / RATE_HZ).coefficients for n in range(len(faces))]

    np.testing.assert_allclose(shown, faces, atol=1e-9)


@given(FACES, st.floats(0.0, 1.0))
def test_between_them_nothing_is_beyond_the_two_neighbours(faces, share):
    motion = motion_of(faces)
    for n, (one, other) in enumerate(pairwise(faces)):
        shown = motion.frame_at((n + share) / RATE_HZ).coefficients
        assert (shown >= np.minimum(one, other) - 1e-6).all()
        assert (shown <= np.maximum(one, other) + 1e-6).all()


@given(FACES, st.floats(-1.2 * EASING_S, 0.1 + 1.2 * EASING_S))
def test_the_mouth_never_jumps_also_where_the_performance_begins_and_ends(faces, time_s):
    motion, step_s = stored(faces), 1e-4
    rows = np.vstack([REST, faces, REST])
    between = np.abs(np.diff(faces, axis=0)).max(initial=0.0) * RATE_HZ
    easing = 1.5 * np.abs(rows[[1, -2]] - REST).max() / EASING_S  # a cubic's steepest

    moved = motion.face_at(time_s + step_s, REST) - motion.face_at(time_s, REST)

    assert np.abs(moved).max() <= (between + easing) * step_s + 1e-9


def test_where_nothing_of_it_is_said_the_mouth_is_where_it_would_be_without():
    faces = np.full((5, 3), 9.0, np.float32)
    silent = motion_of(faces, place_s=lambda _time_s: None)
    spoken = motion_of(faces, place_s=lambda time_s: time_s - 3.0)

    assert silent.frame_at(0.02).coefficients == pytest.approx(REST)
    assert spoken.frame_at(3.02).coefficients == pytest.approx(faces[0])
    assert spoken.frame_at(3.0 - EASING_S).coefficients == pytest.approx(REST)
    assert spoken.frame_at(3.04 + EASING_S).coefficients == pytest.approx(REST)


@settings(max_examples=25)
@given(FACES, st.floats(0.0, 0.3))
def test_one_that_is_dropped_anywhere_leaves_the_mouth_without_a_jump(faces, until_s):
    """On a mouth that moves meanwhile, and is where it would be EASING_S later."""
    inner, step_s = Swaying(REST), 2e-3
    motion = motion_of(faces, lambda time_s: time_s - EASING_S if time_s < until_s else None, inner)
    times_s = np.arange(0.0, 0.8, step_s)
    shown = np.array([motion.frame_at(time_s).coefficients for time_s in times_s])
    rows = np.vstack([REST, faces, REST])
    between = np.abs(np.diff(faces, axis=0)).max(initial=0.0) * RATE_HZ
    easing = 1.5 * (np.abs(rows - REST).max() + 8.0) / EASING_S + 2 * 36.0

    assert np.abs(np.diff(shown, axis=0)).max() <= (between + easing) * step_s + 1e-9
    np.testing.assert_allclose(shown[-1], inner.frame_at(times_s[-1]).coefficients)


def test_speech_right_behind_a_performance_moves_the_mouth_as_much_as_any():
    """It was eased in while the last face was shown, and is not once more."""
    inner, over_s = Swaying(REST), 0.04 + EASING_S
    motion = motion_of(
        np.zeros((5, 3), np.float32), lambda time_s: time_s if time_s <= over_s else None, inner
    )
    times_s = np.arange(0, 60) / RATE_HZ
    shown = [motion.frame_at(time_s).coefficients for time_s in times_s]
    behind = times_s > over_s
    alone = [inner.frame_at(time_s).coefficients for time_s in times_s[behind]]
    np.testing.assert_array_equal(np.array(shown)[behind], alone)


def test_where_nothing_is_performed_the_lower_lip_is_tucked_as_without():
    class Tucking(StillMotion):
        def frame_at(self, time_s):
            return Frame(time_s, self._rest, Expression(lip_tuck=0.7))

    dropped = motion_of(
        np.zeros((5, 3), np.float32), lambda time_s: 0.0 if time_s < 0.1 else None, Tucking(REST)
    )
    tucks = [dropped.frame_at(time_s).expression.lip_tuck for time_s in (0.0, 0.15, 0.5)]
    assert tucks == [None, 0.7, 0.7]


def test_head_and_eyes_are_shown_between_the_stored_ones_and_only_what_is_stored():
    faces = np.zeros((3, 3), np.float32)
    motion = motion_of(faces, neck_yaw_deg=[0.0, 10.0, 20.0], lid_left=[0.0, 1.0, 0.0])

    shown = motion.frame_at(0.005).expression
    assert (shown.neck_yaw_deg, shown.lid_left) == (pytest.approx(5.0), pytest.approx(0.5))
    assert (shown.neck_pitch_deg, shown.smile) == (None, None)
    assert motion.frame_at(0.1).expression.neck_yaw_deg == 20.0  # in the silence behind it
    assert motion.frame_at(-0.1).expression.neck_yaw_deg == 0.0
    assert motion_of(faces).frame_at(0.01).expression is NO_EXPRESSION


def test_phonemes_are_shown_as_they_are_told_and_counted_as_they_come():
    events = (PhonemeEvent("M", 0.02, 0.04), PhonemeEvent("AA", 0.04, 0.08))
    motion = motion_of(np.zeros((9, 3), np.float32))
    motion.push(PhonemeUpdate(0.0, 0.08, 0.08, (PhonemeEvent("SIL", 0.0, 0.02), *events)))
    counts = []
    for time_s in (0.01, 0.03, 0.05, 0.03):
        motion.frame_at(time_s)
        counts.append(motion.phonemes_planned)

    assert counts == [0, 1, 2, 2]
    assert motion.event_at(0.03).phoneme == "M"
    motion.reset()
    assert (motion.phonemes_planned, motion.event_at(0.03)) == (0, None)


def test_the_window_shows_the_next_faces_and_where_their_lips_touch():
    opening = np.zeros((31, 3), np.float32)
    opening[:, 0] = np.abs(np.arange(31) - 10) * 2.0  # closed at 0.1 s
    motion = motion_of(opening)
    window = motion.window_after(motion.frame_at(0.0))

    assert window.times_s[window.closed] == pytest.approx([0.1])
    assert window.faces[:, 0] == pytest.approx(np.abs(window.times_s - 0.1) * 200.0, abs=1e-4)
    assert window.shut[0] < 1.0
