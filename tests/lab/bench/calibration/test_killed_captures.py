"""A calibration that is killed goes on by the same command; figure `resumed` of the bench."""

import pytest
from lipservo_lab.bench.calibration.killed_captures import (
    KilledCapture,
    killed_captures,
    resumed_figures,
)

from lipsync.animpho.units import load_face_with_animphos


@pytest.mark.campaign
@pytest.mark.parametrize("tracker", ["computed", "csv"])
def test_a_capture_that_is_killed_at_a_random_moment_goes_on_by_the_same_command(tracker):
    (found,) = killed_captures(load_face_with_animphos(), 5, 1, [tracker])

    assert found.why == ""


def test_a_capture_that_was_lost_counts_against_the_share_and_says_why():
    captures = [KilledCapture("csv", 3.0, ""), KilledCapture("json", 4.0, "no such calibration")]

    assert resumed_figures(captures) == {
        "resumed": 0.5,
        "resumed_of": 2,
        "not_resumed": ["json, 4.0 s: no such calibration"],
    }
