"""The mouth wakes when it is told of speech, and the time is counted from the onset."""

import numpy as np
import pytest
from lipservo_lab.evaluation.recognition.closing_times import Mouth, waking_figures

PHONES = [("SIL", 0, 30), ("AA", 30, 90), ("SIL", 90, 120)]


class Watched:
    """A mouth that leaves rest so long after the onset at 0.6 + 0.3 s."""

    def __init__(self, late_s):
        self._late_s = late_s
        self.heard = []

    def watch(self, samples, from_s):
        assert from_s == 0.0
        self.heard.append(samples)
        n = len(samples) // 160
        times_s = np.arange(n) * 0.01
        return Mouth(np.zeros(n), times_s < 0.9 + self._late_s - 1e-6)


@pytest.mark.parametrize("late_s", [-0.07, 0.0, 0.03])
def test_the_time_is_counted_from_the_first_phone_that_is_spoken(late_s):
    bench = Watched(late_s)
    speech = np.random.default_rng(0).uniform(-0.3, 0.3, 19_200).astype(np.float32)
    figures = waking_figures(bench, [(speech, PHONES)] * 3, np.random.default_rng(0))
    assert figures["waking_ms_p50"] == pytest.approx(1e3 * late_s, abs=1e-6)
    assert figures["waking_onsets"] == 6
    quiet, noisy = bench.heard[:2]
    assert not quiet[:9_600].any()
    level_db = 10 * np.log10(np.mean(noisy[:9_600] ** 2) / np.mean(speech**2))
    assert level_db == pytest.approx(-40.0, abs=0.3)


def test_a_mouth_that_never_wakes_is_infinitely_late():
    figures = waking_figures(
        Watched(9.0), [(np.ones(19_200, np.float32), PHONES)], np.random.default_rng(0)
    )
    assert figures["waking_ms_p50"] == np.inf


def test_a_recording_without_speech_is_passed_over():
    silent = [(np.zeros(16_000, np.float32), [("SIL", 0, 100)])]
    assert waking_figures(Watched(0.0), silent, np.random.default_rng(0))["waking_onsets"] == 0
