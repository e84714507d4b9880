"""A run ends with figures whatever becomes of single robots."""

import pytest
from lipservo_lab.bench.calibration import every_robot
from lipservo_lab.bench.calibration.calibration_figures import OwnRobot
from lipservo_lab.bench.calibration.closing_figures import TriedMouth, closing_figures
from lipservo_lab.bench.calibration.elastic_figures import ElasticRobot
from lipservo_lab.bench.calibration.hard_captures import FaultCount

from calibration.grade import CONTACT, LIMITS, Closing
from calibration.simulated.robot_family import RobotFamily

NAMED, MISNAMED = FaultCount(1, 1, 0), FaultCount(1, 0, 1)


def outcome(task, seed):
    """Return a task's outcome: every robot is refused, one fault in four named wrongly."""
    if task is every_robot.own_robot:
        return OwnRobot(seed, None, "weak", {"slipped": NAMED, "slipped, measured": NAMED})
    if task is every_robot.elastic_robot:
        faults = {"slipped": NAMED, "slipped, measured": MISNAMED}
        return ElasticRobot(seed, None, "dead", {"15 markers": "dead"}, faults)
    return TriedMouth(seed, 2, 3.0, Closing(LIMITS, 3.2, "jaw", 4.0), "")


@pytest.fixture
def outcomes(monkeypatch):
    monkeypatch.setattr(
        every_robot,
        "_worked_off",
        lambda tasks, _: [outcome(task, seed) for task, seed in tasks],
    )


@pytest.mark.usefixtures("outcomes")
def test_refused_robots_of_both_families_are_counted_together():
    figures = every_robot.bench_figures([3, 4], list(RobotFamily))
    assert (figures["refused"], figures["elastic"]["refused"]) == (4, 2)
    assert (figures["faults_named"], figures["faults_misnamed"]) == (0.75, 0.25)
    assert figures["faults"]["slipped, measured"] == {"tried": 4, "named": 2, "misnamed": 2}
    assert figures["cannot_close_reported"] == 1.0
    assert len(figures["cannot_close"]) == 20


@pytest.mark.usefixtures("outcomes")
def test_one_family_has_its_figures_to_itself():
    figures = every_robot.bench_figures([3], [RobotFamily.ELASTIC])
    assert figures["refused_with"] == {"15 markers": {"3": "dead"}}
    assert figures["refused_why"] == {"3": "dead"}
    assert "elastic" not in figures


def test_a_limit_called_contact_and_a_gap_below_the_true_one_are_counted():
    mouths = [
        TriedMouth(0, 1, 3.0, Closing(CONTACT), ""),
        TriedMouth(1, 1, 3.0, Closing(LIMITS, 2.6, "jaw", 4.0), ""),
        TriedMouth(2, 1, 3.0, None, "the mouth does not close: ..."),
        TriedMouth(3, 1, 3.0, None, "the markers are mirrored"),
    ]
    figures = closing_figures(mouths)
    assert figures["cannot_close_reported"] == 0.5
    assert (figures["limits_called_contact"], figures["bound_broken"]) == (1, 1)
