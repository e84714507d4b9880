"""A mouth whose sound is cut off: closed in its time, back without a jump."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lipservo.runtime.speech.speech import CLOSING_S, JOINING_S, CutOff

PERIOD_S = 0.01
REST_DEG = np.zeros(2)
OPEN_DEG = np.array([20.0, -8.0])
#: Of a way of 3 u^2 - 2 u^3, in one period.
STEEPEST_SHARE = 1.5 * PERIOD_S / min(CLOSING_S, JOINING_S)


def begun(shown_deg=OPEN_DEG, until_s=1.0):
    cut_off = CutOff(2, PERIOD_S)
    cut_off.begin(shown_deg, REST_DEG, until_s)
    return cut_off


def test_it_is_at_rest_after_its_time_and_stays_there():
    cut_off = begun()
    poses_deg = [cut_off.close() for _ in range(20)]
    gaps_deg = np.array([pose_deg[0] for pose_deg in poses_deg])
    assert np.all(np.diff(gaps_deg) <= 0.0)
    assert gaps_deg[round(CLOSING_S / PERIOD_S) - 2] > 0.0
    np.testing.assert_array_equal(poses_deg[round(CLOSING_S / PERIOD_S) - 1 :], 11 * [REST_DEG])


def test_it_joins_speech_from_rest_and_then_is_speech():
    cut_off = begun()
    for _ in range(20):
        cut_off.close()
    n_joining = round(JOINING_S / PERIOD_S)
    joined_deg = [cut_off.join(OPEN_DEG)[0] for _ in range(n_joining + 3)]
    assert 0.0 < joined_deg[0] < 2.0
    assert np.all(np.diff(joined_deg) >= 0.0)
    assert joined_deg[n_joining - 1 :] == 4 * [OPEN_DEG[0]]


def test_a_mouth_that_begins_comes_from_neutral_and_then_passes_speech_as_it_is():
    cut_off = CutOff(2, PERIOD_S)
    poses_deg = np.array([cut_off.join(OPEN_DEG) for _ in range(10)])

    assert np.abs(poses_deg[0]).max() < 1.0
    np.testing.assert_array_equal(poses_deg[round(JOINING_S / PERIOD_S) :], 2 * [OPEN_DEG])


def test_a_second_cut_while_it_closes_lengthens_the_silence_and_moves_nothing():
    cut_off, other = begun(until_s=1.0), begun(until_s=1.0)
    for _ in range(4):
        np.testing.assert_array_equal(cut_off.close(), other.close())
    cut_off.begin(np.array([99.0, 99.0]), REST_DEG, 2.0)
    np.testing.assert_array_equal(cut_off.close(), other.close())
    assert cut_off.until_s == 2.0
    cut_off.begin(OPEN_DEG, REST_DEG, 0.5)
    assert cut_off.until_s == 2.0


@given(
    st.lists(
        st.tuples(st.sampled_from(["live", "close", "begin"]), st.integers(1, 15)),
        min_size=1,
        max_size=20,
    ),
    st.floats(0.0, 6.3),
)
def test_whatever_happens_when_the_mouth_never_jumps(actions, phase):
    """Speech itself moves by at most 0.5 degrees a period here."""
    cut_off, shown_deg, n = CutOff(2, PERIOD_S), None, 0
    for action, times in actions:
        for _ in range(times):
            n += 1
            live_deg = 10.0 + 10.0 * np.sin(phase + 0.05 * np.array([n, n + 7.0]))
            if action == "begin" and shown_deg is not None:
                cut_off.begin(shown_deg, REST_DEG, 0.0)
            was_deg = shown_deg
            shown_deg = (
                cut_off.close()
                if cut_off.is_closing and action != "live"
                else (cut_off.join(live_deg))
            )
            assert np.all((shown_deg >= -1e-9) & (shown_deg <= 20.0 + 1e-9))
            if was_deg is not None:
                assert np.abs(shown_deg - was_deg).max() <= 0.5 + 20.0 * STEEPEST_SHARE
