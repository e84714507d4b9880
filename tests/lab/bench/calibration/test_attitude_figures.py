"""What trackers that stand askew cost, counted over robots."""

from types import SimpleNamespace

from lipservo_lab.bench.calibration.attitude_figures import AskewRobot, attitude_figures


def test_ratios_are_over_the_same_robots_straight_calibration_and_refusals_stand_apart():
    """A worked example; robot 3 is refused by a straight tracker, too, and does not count."""
    straight = [
        SimpleNamespace(seed=seed, score=None if mm is None else SimpleNamespace(true_mm=mm))
        for seed, mm in ((1, 0.5), (2, 0.8), (3, None))
    ]
    askew = [
        AskewRobot(1, {"pitch": None, "yaw": 0.55, "roll": 0.5}),
        AskewRobot(2, {"pitch": None, "yaw": 1.2, "roll": 0.88}),
        AskewRobot(3, {"pitch": None, "yaw": 9.0, "roll": 9.0}),
    ]
    figures = attitude_figures(askew, straight)
    assert figures["attitude_refused"] == 2
    assert {axis: round(r, 6) for axis, r in figures["attitude_ratios"].items()} == {
        "yaw": 1.3,
        "roll": 1.05,
    }
    assert round(figures["attitude_ratio"], 6) == 1.3
    assert round(figures["attitude_worst"], 6) == 1.5
