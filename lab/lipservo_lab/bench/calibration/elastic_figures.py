"""`lipservo bench calibration --family elastic`: whole calibrations of elastic robots, scored.

What fits sees `move` and `measure` only, and what a face's YAML says. The score is taken on speech
that was left out, against the shapes of wanted_shapes.py, by the true lips and the force between
them; beside it the textbook's way from the same capture.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture import Capture, Robot
from calibration.fit.measured import fit_measured, split_frames
from calibration.fit.procedure import Procedure, take_grade
from calibration.grade import lips_off_mm
from calibration.mouth_servos import MouthServos
from calibration.simulated.elastic_robot import ElasticFace
from calibration.simulated.robot import SimulatedRobot
from lipservo_lab.bench.calibration.elastic_draws import draw_elastic_robot
from lipservo_lab.bench.calibration.hard_captures import (
    FaultCount,
    count_faults,
    count_measured_faults,
    fault_figures,
    refusals,
)
from lipservo_lab.bench.calibration.shown_motion import (
    Motion,
    WantedShapes,
    behind_play,
    played,
    rest_force_ratio,
    rival_poses_deg,
    shown,
    wanted_shapes,
)
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

N_POSES = 60
N_FRAMES = 400
_GOOD_GRADE = (0.8, 1.3)
#: How often what suffices is little force.
_ENOUGH_FORCE = 4.0
_NONE = np.eye(3)


@dataclass(frozen=True, slots=True)
class RobotScore:
    """The scores of one robot: mm rms over frames and lips; shares 0 to 1.

    true_mm: our lip error, rival_mm: that of the textbook's way; printed_mm: the grade, which
    calibration itself prints. force_over_needed, rest_force: force between closed lips, in closures
    and at rest, over the force that suffices. contact_called: the grade says that the lips close.
    """

    n_servos: int
    true_mm: float
    rival_mm: float
    printed_mm: float
    gap_r: float
    gap_slope: float
    closure_touch: float
    force_over_needed: float
    rest_force: float
    contact_called: bool


def score_robot(
    model: FaceWithAnimPhos, seed: int, n_servos: int | None = None, *, tracker_turn: Array = _NONE
) -> RobotScore:
    """Calibrate the elastic robot of a seed, from capture to grade; return its scores.

    n_servos: None: drawn by the seed, too; tracker_turn: (3, 3), how the tracker stands. Raises
    CalibrationError where the robot is refused.
    """
    draw, servos = draw_elastic_robot(model.markers_mm(model.rest[None])[0], seed, n_servos)
    face = ElasticFace(draw)
    simulated = SimulatedRobot(face, noise_seed=seed)
    robot = Robot(simulated.move, lambda: simulated.measure() @ tracker_turn.T)
    procedure = Procedure(model, servos.joints, N_POSES, seed=seed, positive=servos.positive)
    capture = procedure.capture(MARKERS_47.names, robot)
    fit = fit_measured(model, capture, servos)
    fit = take_grade(fit, servos, MARKERS_47.names, robot)
    assert fit.calibration.grade is not None
    closing = fit.calibration.closing
    frames = split_frames(model, 0)[1][:N_FRAMES]
    wanted = wanted_shapes(model, face, servos, frames)
    ours = shown(face, played(face, fit.calibration, frames), wanted)
    rival = _best_rival(face, servos, capture, wanted)
    return RobotScore(
        n_servos=len(servos.joints),
        true_mm=ours.off_mm,
        rival_mm=rival.off_mm,
        printed_mm=lips_off_mm(fit.calibration.grade, fit.calibration.learnt_lips),
        gap_r=ours.gap_r,
        gap_slope=ours.gap_slope,
        closure_touch=ours.touch,
        force_over_needed=ours.force_ratio,
        rest_force=rest_force_ratio(face, fit.calibration),
        contact_called=closing is not None and closing.closes,
    )


@dataclass(frozen=True, slots=True)
class ElasticRobot:
    """The result for one robot: its scores or why it was refused, and counts of faults.

    refused_with: for each worse tracker, why the healthy robot is refused; None: it is not.
    faults: by name of the fault that was put into it, whether that was named.
    """

    seed: int
    score: RobotScore | None
    refused: str
    refused_with: dict[str, str | None]
    faults: dict[str, FaultCount]


def elastic_robot(model: FaceWithAnimPhos, seed: int) -> ElasticRobot:
    """Calibrate the healthy robot of a seed, capture it by worse trackers, put faults into it."""
    score, refused = None, ""
    try:
        score = score_robot(model, seed)
    except CalibrationError as error:
        refused = str(error)
    draw, servos = draw_elastic_robot(model.markers_mm(model.rest[None])[0], seed)
    face = ElasticFace(draw)
    refused_with = refusals(model, face, servos, seed)
    faults = count_faults(model, face, servos, seed)
    faults |= count_measured_faults(model, face, servos, seed)
    return ElasticRobot(seed, score, refused, refused_with, faults)


def elastic_figures(robots: Sequence[ElasticRobot]) -> dict[str, object]:
    """Return the figures of all robots: `summary`, refusals with worse trackers, and faults."""
    refused_with: dict[str, dict[str, str]] = {}
    for robot in robots:
        for tracker, why in robot.refused_with.items():
            refused_with.setdefault(tracker, {}).update(
                {} if why is None else {str(robot.seed): why}
            )
    return {
        **summary(
            {robot.seed: robot.score for robot in robots if robot.score is not None},
            {robot.seed: robot.refused for robot in robots if robot.refused},
        ),
        "refused_with": refused_with,
        **fault_figures([robot.faults for robot in robots]),
    }


def summary(scores: Mapping[int, RobotScore], refused: Mapping[int, str]) -> dict[str, object]:
    """Return medians, worst values and shares over the scores, and the refusals.

    scores, refused: by seed, of calibrated robots and the refusals of others. grade_over_truth: the
    printed lip error over the true one; grade_share: share of robots in which that is right enough.
    """
    found = list(scores.values())

    def median_of(value: Callable[[RobotScore], float]) -> float:
        return float(np.median([value(score) for score in found])) if found else float("nan")

    grade_ratios = np.array([score.printed_mm / score.true_mm for score in found])
    good = (grade_ratios >= _GOOD_GRADE[0]) & (grade_ratios <= _GOOD_GRADE[1])
    n_little_force = sum(score.force_over_needed <= _ENOUGH_FORCE for score in found)
    return {
        "robots": len(scores) + len(refused),
        "true_rms_mm": median_of(lambda s: s.true_mm),
        "worst_rms_mm": max((s.true_mm for s in found), default=float("nan")),
        "gap_r": median_of(lambda s: s.gap_r),
        "gap_slope": median_of(lambda s: s.gap_slope),
        "closure_touch": median_of(lambda s: s.closure_touch),
        "closure_touch_worst": min((s.closure_touch for s in found), default=float("nan")),
        "force_over_needed": median_of(lambda s: s.force_over_needed),
        "force_share": n_little_force / max(len(found), 1),
        "rest_force": median_of(lambda s: s.rest_force),
        "contact_called": float(np.mean([s.contact_called for s in found])) if found else 0.0,
        "best_rival_ratio": median_of(lambda s: s.true_mm / s.rival_mm),
        "rival_rms_mm": median_of(lambda s: s.rival_mm),
        "grade_over_truth": float(np.median(grade_ratios)) if found else float("nan"),
        "grade_share": float(good.mean()) if found else 0.0,
        "refused": len(refused),
        "refused_why": {str(seed): reason for seed, reason in refused.items()},
        "each": {
            str(seed): {f.name: getattr(score, f.name) for f in fields(score)}
            for seed, score in scores.items()
        },
    }


def _best_rival(
    face: ElasticFace, servos: MouthServos, capture: Capture, wanted: WantedShapes
) -> Motion:
    """Return the motion of the textbook's way, by a linear or a quadratic fit of the same capture.

    The one with the smaller true lip error is taken, so that we are compared with no weak rival.
    """
    both = [
        shown(
            face,
            behind_play(face, rival_poses_deg(capture, servos, wanted.features, degree)),
            wanted,
        )
        for degree in (1, 2)
    ]
    return min(both, key=lambda motion: motion.off_mm)
