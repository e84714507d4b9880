"""What `doctor` says of the computer: what a face costs by a fake clock, and the words for it."""

import pytest

from firmware_bridge.bus_kinds import Severity
from lipservo.commands.build.within_reach import FaceCost, face_cost, within_reach
from lipsync.recognition.network_recognizer import NetworkRecognizer

GOOD, WARNING = Severity.GOOD, Severity.WARNING


class Clock:
    """Seconds that pass where a test says so."""

    now_s = 0.0

    def __call__(self):
        return self.now_s


def test_hearing_costs_what_the_recogniser_takes_for_each_block_as_it_comes(monkeypatch):
    """Of a sound that is known ahead it takes many blocks at once, at a third of the cost."""
    clock = Clock()
    prepare = NetworkRecognizer.prepare

    def slow(self, blocks):
        clock.now_s += 0.004
        prepare(self, blocks)

    monkeypatch.setattr(NetworkRecognizer, "prepare", slow)

    cost = face_cost("face_four", clock)

    assert cost.speech_s == pytest.approx(0.4, abs=0.02)  # 100 blocks a second
    assert cost.tick_s == 0.0


def test_the_first_steps_are_not_counted():
    n_calls = 0

    def timer_s():
        nonlocal n_calls
        n_calls += 1
        n_counted = max(0, n_calls - 45)  # three a tick, for half a second at 30 Hz
        return 9.0 * (n_calls - n_counted) + 0.002 * n_counted

    cost = face_cost("face_four", timer_s)

    assert cost.tick_s == pytest.approx(0.002)
    assert cost.speech_s == pytest.approx(0.06, abs=1e-6)


@pytest.mark.parametrize(
    ("cost", "rate_hz", "n_cores", "said"),
    [
        (FaceCost(0.2, 0.002), 100.0, 4, [
            (GOOD, "takes 0.20 s a second, measured now: within reach"),
            (GOOD, "takes 0.20 s a second at 100 Hz: up to 200 Hz are within reach"),
            (GOOD, "a page with one viewer takes about"),
        ]),
        (FaceCost(0.9, 0.01), 100.0, 4, [
            (WARNING, "takes 0.90 s a second, measured now: little is left"),
            (WARNING, "takes 1.00 s a second at 100 Hz: too much"),
            (GOOD, "within reach"),
        ]),
        (FaceCost(1.6, 0.01), 30.0, 2, [
            (WARNING, "takes 1.60 s a second, measured now: too much; where the recogniser"),
            (GOOD, "takes 0.30 s a second at 30 Hz: up to 70 Hz are within reach"),
            (WARNING, "too much beside them"),
        ]),
        (FaceCost(0.5, 0.004), 50.0, None, [
            (GOOD, "within reach"), (GOOD, "within reach"), (WARNING, "too much beside them"),
        ]),
    ],
)  # fmt: skip
def test_what_is_within_reach_is_said_of_each_process_and_of_all(cost, rate_hz, n_cores, said):
    found = list(within_reach(cost, rate_hz, n_cores))

    assert [each.severity for each in found] == [severity for severity, _ in said]
    for each, (_, words) in zip(found, said, strict=True):
        assert words in each.what
    assert all(bool(each.remedy) == (each.severity is WARNING) for each in found)


def test_a_rate_that_is_too_high_is_told_with_one_that_is_not():
    [_, loop, _] = within_reach(FaceCost(0.1, 0.01), 100.0, 4)

    assert loop.remedy == "`rate_hz: 70` in the YAML"
    [_, loop, _] = within_reach(FaceCost(0.1, 0.03), 100.0, 4)
    assert loop.remedy == "let less run beside it"  # 23 Hz would be refused
