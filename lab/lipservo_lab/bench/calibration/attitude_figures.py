"""Calibrations by trackers that stand askew, of elastic robots: their error over a straight one's.

Every robot is calibrated with the tracker turned by 40 degrees about each axis; to which side
alternates from seed to seed and from axis to axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.calibration import CalibrationError
from lipservo_lab.bench.calibration.elastic_figures import ElasticRobot, score_robot
from lipsync.animpho.units import FaceWithAnimPhos

ASKEW_DEG = 40.0
#: Axes of the turns, as SciPy calls them.
_AXES = {"pitch": "x", "yaw": "y", "roll": "z"}


@dataclass(frozen=True, slots=True)
class AskewRobot:
    """True lip errors, mm rms, of a robot by name of the turn; None where calibration refused."""

    seed: int
    true_mm: dict[str, float | None]


def askew_robot(model: FaceWithAnimPhos, seed: int) -> AskewRobot:
    """Calibrate the elastic robot of a seed with the tracker turned about each axis in turn."""
    errors_mm: dict[str, float | None] = {}
    for number, (name, axis) in enumerate(_AXES.items()):
        turn_deg = ASKEW_DEG * (-1.0) ** (seed + number)
        turn = Rotation.from_euler(axis, turn_deg, degrees=True).as_matrix()
        try:
            errors_mm[name] = score_robot(model, seed, tracker_turn=turn).true_mm
        except CalibrationError:
            errors_mm[name] = None
    return AskewRobot(seed, errors_mm)


def attitude_figures(
    askew: Sequence[AskewRobot], straight: Sequence[ElasticRobot]
) -> dict[str, object]:
    """Return the errors over those by a straight tracker, the median of each axis and the worst.

    attitude_ratio: the largest of the medians. Refusals count in attitude_refused alone; robots
    that a straight tracker's calibration refuses do not count.
    """
    straight_mm = {robot.seed: robot.score.true_mm for robot in straight if robot.score}
    counted = [robot for robot in askew if robot.seed in straight_mm]
    ratios = {
        axis: [
            error_mm / straight_mm[robot.seed]
            for robot in counted
            if (error_mm := robot.true_mm[axis]) is not None
        ]
        for axis in _AXES
    }
    medians = {axis: float(np.median(found)) for axis, found in ratios.items() if found}
    return {
        "attitude_ratio": max(medians.values(), default=np.nan),
        "attitude_ratios": medians,
        "attitude_worst": max((max(found) for found in ratios.values() if found), default=np.nan),
        "attitude_refused": sum(None in robot.true_mm.values() for robot in counted),
    }
