"""Closures by what is heard: a worked example, and the bundled clip through its command."""

import json

import numpy as np
import pytest
from lipservo_lab.evaluation.motion.measures import closes
from lipservo_lab.evaluation.recognition.heard_motion import Closure, closure_figures, is_heard
from lipservo_lab.evaluation.recognition.recognition_scores import HeardClosures
from speech import CLIP_LABELS_PATH
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.phoneme_files.reader import read_phonemes
from lipsync.phonemes import PhonemeEvent


def test_a_phone_is_met_where_the_lips_come_near_enough_within_40_ms_of_it():
    times_s = np.arange(100) / 100
    gaps_mm = np.where(np.arange(100) == 46, 0.9, 8.0)
    assert closes(PhonemeEvent("M", 0.50, 0.60), times_s, gaps_mm)
    assert not closes(PhonemeEvent("M", 0.51, 0.60), times_s, gaps_mm)
    assert closes(PhonemeEvent("F", 0.50, 0.60), times_s, gaps_mm + 3.6)
    assert not closes(PhonemeEvent("P", 0.50, 0.60), times_s, gaps_mm + 3.6)


def test_lips_alone_and_lip_with_teeth_are_counted_apart():
    found = [("P", True, True), ("M", False, False), ("B", True, False), ("V", True, False)]
    closures = [Closure(PhonemeEvent(p, 0.0, 0.1), met, heard) for p, met, heard in found]
    assert closure_figures(closures) == {
        "closures": 3, "closures_met": 2, "closure_hits": 2 / 3,
        "heard_closures": 1, "heard_closures_met": 1, "heard_closure_hits": 1.0,
        "labiodentals": 1, "labiodentals_met": 1, "labiodental_hits": 1.0,
        "heard_labiodentals": 0, "heard_labiodentals_met": 0, "heard_labiodental_hits": None,
    }  # fmt: skip


def test_a_closure_is_heard_where_the_recall_of_the_recogniser_counts_it():
    """Any phone of its class, 20 ms beside it at most: as `HeardClosures` finds it in frames."""
    for n_beside in range(-12, 13):
        start_s = 0.50 + n_beside / 100
        for phoneme in ("B", "V"):
            events = [
                PhonemeEvent("AA", 0.0, start_s),
                PhonemeEvent(phoneme, start_s, start_s + 0.05),
            ]
            flags = np.zeros((2, 100), bool)
            flags[0, 50:60] = True
            flags[1, 50 + n_beside : 55 + n_beside] = phoneme == "B"
            recall = HeardClosures()
            recall.add(flags[1], flags[0])
            assert is_heard(PhonemeEvent("P", 0.50, 0.60), events) == bool(recall.n_found)


@pytest.mark.slow
def test_the_closures_of_the_bundled_clip_are_those_that_were_spoken():
    done = CliRunner().invoke(app, ["bench", "closures", "--json", "-q"])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    spoken = [e.phoneme for e in read_phonemes(CLIP_LABELS_PATH)]
    assert figures["closures"] == sum(p in ("P", "B", "M") for p in spoken)
    assert figures["labiodentals"] == sum(p in ("F", "V") for p in spoken)
    assert len(figures["missed"]) == (
        figures["closures"] + figures["labiodentals"]
        - figures["closures_met"] - figures["labiodentals_met"]
    )  # fmt: skip
    assert figures["closure_hits"] == pytest.approx(figures["closures_met"] / figures["closures"])
    assert figures["closure_hits"] > 0.6
    assert figures["heard_closures_met"] <= figures["heard_closures"] <= figures["closures"]
    assert figures["heard_closure_hits"] > 0.9
    assert 100.0 < figures["fastest_lip_mm_s"] < 500.0
    assert figures["fast_steps_per_s"] < 0.2  # one in 8 s; there were four in ten
