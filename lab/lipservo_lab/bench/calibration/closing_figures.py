"""Mouths that cannot close, and healthy ones whose dots lie beside the lips: which are reported.

A mouth that cannot close is an elastic robot of 1 to 8 servos whose jaw is mounted some degrees
open, and whose lips have little room: with all joints at their limits the lips stay apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture import Robot
from calibration.fit.measured import fit_measured
from calibration.fit.procedure import Procedure, take_grade
from calibration.grade import CONTACT, LIMITS, Closing
from calibration.mouth_servos import JointRange, MouthServos
from calibration.simulated.elastic_family import KINDS, robot_of_kinds
from calibration.simulated.elastic_robot import N_PAIRS, ElasticDraw, ElasticFace
from calibration.simulated.robot import SimulatedRobot
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

_N_POSES = 60
#: How many of them are tried.
N_OPEN_MOUTHS = 20
#: How far these mouths stay open, in millimetres, and how far their lips may turn to close.
_STAY_MM, _LIP_DEG = (1.2, 5.0), (4.0, 10.0)
_BELOW_MM = 0.3
_KINDS: Sequence[tuple[str, ...]] = (
    ("jaw",),
    ("jaw", "corners"),
    ("jaw", "upper", "lower"),
    ("jaw", "upper", "lower", "corners"),
    ("jaw", "upper_l", "upper_r", "lower", "pucker"),
    ("jaw", "upper", "lower", "out_l", "out_r", "pucker"),
    ("jaw", "upper_l", "upper_r", "lower_l", "lower_r", "corners", "pucker"),
    ("jaw", "upper_l", "upper_r", "lower_l", "lower_r", "out_l", "out_r", "pucker"),
)


@dataclass(frozen=True, slots=True)
class OpenMouth:
    """A robot whose mouth cannot close. stay_mm: the least gap between its lips."""

    draw: ElasticDraw
    servos: MouthServos
    stay_mm: float


def open_mouth(rest_mm: Array, seed: int) -> OpenMouth:
    """Return a simulated robot of 1 to 8 servos, drawn by a seed, whose mouth cannot close.

    Parameters
    ----------
    rest_mm : Array
        (47, 3), a closed mouth.
    seed : int
        Of the draw.

    Returns
    -------
    OpenMouth
        `stay_mm`: the least gap that it reaches, mm.
    """
    rng = np.random.default_rng([seed, 53])
    kinds = _KINDS[seed % len(_KINDS)]
    draw, limits_deg = robot_of_kinds(rest_mm, kinds, kinds, rng)
    for joint, kind in enumerate(kinds):
        if KINDS[kind].lip:
            limits_deg[joint, 0] = -round(rng.uniform(*_LIP_DEG))
    stay_mm = float(rng.uniform(*_STAY_MM))
    limits_deg[draw.jaw, 0] = 0.0
    # By bisection the jaw's horn is turned on its shaft until the least gap is `stay_mm`.
    low_deg, high_deg = -8.0, 24.0
    for _ in range(30):
        offset_deg = (low_deg + high_deg) / 2
        gap_mm = _least_gap_mm(_with_jaw_offset(draw, offset_deg), limits_deg)
        low_deg, high_deg = (offset_deg, high_deg) if gap_mm < stay_mm else (low_deg, offset_deg)
    draw = _with_jaw_offset(draw, high_deg)
    limits_deg[draw.jaw, 1] = max(8.0, limits_deg[draw.jaw, 1] - high_deg)
    joints = tuple(
        JointRange(name, float(min_deg), float(max_deg))
        for name, (min_deg, max_deg) in zip(kinds, limits_deg, strict=True)
    )
    words = tuple(KINDS[kind].word for kind in kinds)
    servos = MouthServos(joints, f"open-{seed}", (), words)
    return OpenMouth(draw, servos, _least_gap_mm(draw, limits_deg))


def _with_jaw_offset(draw: ElasticDraw, jaw_deg: float) -> ElasticDraw:
    """Return the robot with the jaw's horn turned by `jaw_deg` on its shaft."""
    zero_deg = draw.zero_deg.copy()
    zero_deg[draw.jaw] = jaw_deg
    return replace(draw, zero_deg=zero_deg)


def _least_gap_mm(draw: ElasticDraw, limits_deg: Array) -> float:
    """Return the least gap between the middles of the lips that the joints' limits allow, mm.

    Searched by moving each joint in turn to the better of its limits, all of them twice.
    limits_deg: (n_servos, 2).
    """
    face, n = ElasticFace(draw), len(limits_deg)
    pose_deg = np.zeros((1, n))
    for joint in (*range(n), *range(n)):
        tries = np.repeat(pose_deg, 2, axis=0)
        tries[:, joint] = limits_deg[joint]
        pose_deg = tries[face.state(tries).gaps_mm[:, N_PAIRS // 2].argmin()][None]
    return float(face.state(pose_deg).gaps_mm[0, N_PAIRS // 2])


@dataclass(frozen=True, slots=True)
class TriedMouth:
    """The result of calibrating a mouth that cannot close: evidence of closing, or the refusal.

    closing: None if refused. refused: the error's text, empty if not refused.
    """

    seed: int
    n_servos: int
    stay_mm: float
    closing: Closing | None
    refused: str


def tried_mouth(model: FaceWithAnimPhos, seed: int) -> TriedMouth:
    """Calibrate the mouth of a seed, which cannot close, from capture to grade."""
    mouth = open_mouth(model.markers_mm(model.rest[None])[0], seed)
    robot = SimulatedRobot(ElasticFace(mouth.draw), noise_seed=seed)
    servos = mouth.servos
    procedure = Procedure(model, servos.joints, _N_POSES, seed=seed, positive=servos.positive)
    closing, refused = None, ""
    try:
        capture = procedure.capture(MARKERS_47.names, Robot(robot.move, robot.measure))
        fit = fit_measured(model, capture, servos)
        graded_robot = Robot(robot.move, robot.measure)
        closing = take_grade(fit, servos, MARKERS_47.names, graded_robot).calibration.closing
    except CalibrationError as error:
        refused = str(error)
    return TriedMouth(seed, len(servos.joints), mouth.stay_mm, closing, refused)


def closing_figures(mouths: Sequence[TriedMouth]) -> dict[str, object]:
    """Return how well calibration reports that mouths cannot close.

    cannot_close_reported: share of mouths that were refused for it, or reported as kept open by the
    joints' limits; bound_broken: mouths whose reported gap is smaller than the true one by more
    than 0.3 mm; limits_called_contact: mouths wrongly reported to close. cannot_close: for each
    seed [number of servos, true least gap in mm, result].
    """
    kept_open = [m for m in mouths if m.closing is not None and m.closing.evidence == LIMITS]
    too_near = [m for m in kept_open if m.closing and m.closing.apart_mm < m.stay_mm - _BELOW_MM]
    reported = len(kept_open) + sum("not close" in mouth.refused for mouth in mouths)
    return {
        "cannot_close_reported": reported / max(len(mouths), 1),
        "bound_broken": len(too_near),
        "limits_called_contact": sum(
            mouth.closing is not None and mouth.closing.evidence == CONTACT for mouth in mouths
        ),
        "cannot_close": {
            str(mouth.seed): [
                mouth.n_servos,
                round(mouth.stay_mm, 2),
                mouth.refused or str(mouth.closing),
            ]
            for mouth in mouths
        },
    }
