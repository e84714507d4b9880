"""Closures counted by hand."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.evaluation.recognition.recognition_scores import HeardClosures


def flags(text):
    return np.array([character == "x" for character in text])


def counted(said, spoken):
    closures = HeardClosures()
    closures.add(flags(said), flags(spoken))
    return closures.figures("closure")


def test_one_found_20_ms_late_one_missed_one_too_many():
    figures = counted(
        said="..xxx..............xx....",
        spoken="xxx.......xxx............",
    )
    assert figures == {
        "closure_recall": 0.5,
        "closure_precision": 0.5,
        "closure_onset_error_ms_p50": 20.0,
        "closure_onset_error_ms_abs_p95": 20.0,
    }


def test_a_hit_may_lie_two_frames_beside_and_no_more():
    assert counted("...xx.", "xx....")["closure_recall"] == 1.0
    assert counted("....xx", "xx....")["closure_recall"] == 0.0


def test_of_two_heard_the_one_that_overlaps_tells_the_error():
    assert counted("xx.xxx....", "...xxxxx..")["closure_onset_error_ms_p50"] == 0.0


@given(st.lists(st.booleans(), min_size=1, max_size=60))
def test_who_hears_all_rightly_misses_and_invents_nothing(spoken):
    closures = HeardClosures()
    closures.add(np.array(spoken), np.array(spoken))
    figures = closures.figures("closure")
    assert figures["closure_recall"] == figures["closure_precision"] == float(any(spoken))
    assert figures["closure_onset_error_ms_abs_p95"] == 0.0
