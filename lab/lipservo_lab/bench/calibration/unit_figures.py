"""A design's calibration on sister units of an elastic robot: its error over the unit's own map.

A sister has the design's skin and joints, but horns, rods, play, warmth, dots and the contact of
its lips are drawn anew. Its poses are taken and fitted as `lipservo calibrate unit` does it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.calibration import Calibration, CalibrationError
from calibration.capture.capture import Capture, Robot
from calibration.fit.guided import landmark_poses
from calibration.fit.measured import fit_measured, split_frames
from calibration.fit.procedure import Procedure
from calibration.fit.retargeting import RobotMouth
from calibration.mouth_servos import MouthServos
from calibration.simulated.elastic_robot import N_PAIRS, ElasticDraw, ElasticFace
from calibration.simulated.robot import SimulatedRobot
from calibration.unit import unit_by_eye
from lipservo.calibrating.unit_calibration import Design, capture_unit
from lipservo_lab.bench.calibration.elastic_draws import draw_elastic_robot
from lipservo_lab.bench.calibration.elastic_figures import N_FRAMES, N_POSES
from lipservo_lab.bench.calibration.shown_motion import NAMES, played, shown, wanted_shapes
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.markers import MARKERS_47

#: Seeds of designs and sisters are these beyond the run's, so that no other figure has them.
_FIRST_SEED = 31_000
#: How far sisters are apart: horns (a jaw's half as much), arms, rods, contact and dots.
_ZERO_DEG, _ARM, _ROD, _CONTACT_MM, _DOT_MM = 5.0, 0.04, 0.1, 0.5, 0.5
#: Upper and lower dots of the inner lips.
_INNER = [MARKERS_47.landmarks.index(n) for n in (82, 13, 312, 87, 14, 317)]
_SIZES = (4, 6, 8, 10, 12)
#: What a person's eye is off in a pose, the jaw and other joints (as `guided`'s figures have it).
_PERSON_DEG = (1.0, 3.0)
#: A horn of 25 teeth that is put on a tooth off.
TOOTH_DEG = 360.0 / 25.0


def sister_of(draw: ElasticDraw, seed: int, tooth_off: int | None = None) -> ElasticDraw:
    """Return another unit of a robot, drawn by a seed; `tooth_off`: a joint mounted a tooth off."""
    rng = np.random.default_rng([seed, 53])
    n_servos = len(draw.servo_names)
    reach_deg = np.where(np.arange(n_servos) == draw.jaw, _ZERO_DEG / 2, _ZERO_DEG)
    zero_deg = draw.zero_deg + rng.uniform(-reach_deg, reach_deg)
    if tooth_off is not None:
        zero_deg[tooth_off] += TOOTH_DEG * (-1.0) ** seed
    arms, stiff = 1.0 + _ARM * rng.normal(size=n_servos), 1.0 + _ROD * rng.normal(size=n_servos)
    rods = [
        replace(r, arm_mm=r.arm_mm * arms[r.joint], n_per_mm=r.n_per_mm * max(stiff[r.joint], 0.5))
        for r in draw.rods
    ]
    half_mm = rng.normal(0.0, _CONTACT_MM) / 2 * np.sin(np.linspace(0.0, np.pi, N_PAIRS + 2)[1:-1])
    places_mm = draw.skin.places_mm.copy()
    places_mm[:N_PAIRS, 1] += half_mm
    places_mm[N_PAIRS : 2 * N_PAIRS, 1] -= half_mm
    # Dots go with the edges, and are put on again a little beside their places.
    beside_mm = rng.normal(0.0, _DOT_MM, draw.skin.dots_mm.shape)
    dots_mm = draw.skin.dots_mm + draw.skin.dots @ (places_mm - draw.skin.places_mm) + beside_mm
    off_edge_mm = draw.skin.off_edge_mm + np.repeat([1.0, -1.0], 3) * beside_mm[_INNER, 1]
    return replace(
        draw,
        skin=replace(draw.skin, places_mm=places_mm, dots_mm=dots_mm, off_edge_mm=off_edge_mm),
        rods=tuple(rods),
        zero_deg=zero_deg,
        play_deg=rng.uniform(0.8, 1.2, n_servos),
        drift_deg=rng.permutation(draw.drift_deg),
    )


@dataclass(frozen=True, slots=True)
class UnitErrors:
    """True lip errors on a sister, mm, by its own map and by the design's taken over to it.

    own_mm: by a whole measurement, NaN where that is refused; unit_mm: by 15 poses; eye_mm: by a
    person's 14 poses. refused: why `unit` refused it, or empty. tooth_named: whether a joint a
    tooth off was named, and no other.
    """

    own_mm: float
    unit_mm: float
    eye_mm: float
    refused: str
    tooth_named: bool


def unit_errors(model: FaceWithAnimPhos, seed: int) -> UnitErrors:
    """Measure a design and its sister, take the design's map over to it; return the errors."""
    rest_mm = model.markers_mm(model.rest[None])[0]
    n_servos = _SIZES[seed % len(_SIZES)]
    draw, servos = draw_elastic_robot(rest_mm, _FIRST_SEED + seed, n_servos)
    sister = ElasticFace(sister_of(draw, seed))
    try:
        design = Design.learnt(*_measured(model, servos, draw, seed))
        own = _measured(model, servos, sister.draw, seed + 2)[0]
    except CalibrationError:  # what is refused by `measure` counts there
        return UnitErrors(np.nan, np.nan, np.nan, "", tooth_named=False)
    frames = split_frames(model, 0)[1][:N_FRAMES]
    wanted = wanted_shapes(model, sister, servos, frames)

    def off_mm(calibration: Calibration) -> float:
        return shown(sister, played(sister, calibration, frames), wanted).off_mm

    def tried(make: Callable[[], Calibration]) -> tuple[float, str]:
        try:
            return off_mm(make()), ""
        except CalibrationError as error:
            return np.inf, str(error)

    def on(face: ElasticFace) -> Calibration:
        robot = SimulatedRobot(face, noise_seed=seed + 1)
        by = Robot(robot.move, robot.measure)
        capture = capture_unit(design, model, servos, MARKERS_47.names, by)
        return fit_measured(model, capture, servos).calibration

    unit_mm, refused = tried(lambda: on(sister))
    tooth = seed % n_servos
    _, named = tried(lambda: on(ElasticFace(sister_of(draw, seed, tooth))))
    return UnitErrors(
        own_mm=off_mm(own),
        unit_mm=unit_mm,
        eye_mm=tried(lambda: _by_eye(model, servos, design.calibration, sister, seed))[0],
        refused=refused,
        tooth_named=[n for n in servos.names if f"{n} " in named] == [servos.names[tooth]],
    )


def unit_figures(sisters: Sequence[UnitErrors]) -> dict[str, object]:
    """Return the median and worst error over the sister's own map, and what was refused."""
    sisters = [each for each in sisters if not np.isnan(each.own_mm)]
    if not sisters:
        return {"unit_ratio": np.nan}
    ratios = [each.unit_mm / each.own_mm for each in sisters]
    return {
        "unit_ratio": float(np.median(ratios)),
        "unit_ratio_worst": max(ratios),
        "unit_eye_ratio": float(np.median([each.eye_mm / each.own_mm for each in sisters])),
        "unit_refused": [each.refused for each in sisters if each.refused],
        "unit_tooth_named": float(np.mean([each.tooth_named for each in sisters])),
    }


def _measured(
    model: FaceWithAnimPhos, servos: MouthServos, draw: ElasticDraw, seed: int
) -> tuple[Calibration, Capture]:
    """Return a robot's own map and the capture that it was fitted to."""
    robot = SimulatedRobot(ElasticFace(draw), noise_seed=seed)
    procedure = Procedure(model, servos.joints, N_POSES, seed=seed, positive=servos.positive)
    capture = procedure.capture(MARKERS_47.names, Robot(robot.move, robot.measure))
    return fit_measured(model, capture, servos).calibration, capture


def _by_eye(
    model: FaceWithAnimPhos,
    servos: MouthServos,
    design: Calibration,
    sister: ElasticFace,
    seed: int,
) -> Calibration:
    """Return the map that a person's 14 poses make of the design's."""
    faces = np.array([pose.coefficients for pose in landmark_poses(model)])
    wanted, limits_deg = wanted_shapes(model, sister, servos, faces), servos.limits_deg
    made_deg = RobotMouth(sister.markers_mm, NAMES, limits_deg).nearest_deg(wanted.features)
    error_deg = np.where(np.arange(len(servos.joints)) == sister.draw.jaw, *_PERSON_DEG)
    # The closed mouth is seen best, as in every figure by eye.
    noise = np.random.default_rng([seed, 2]).normal(size=made_deg.shape)
    noise[0] = 0.0
    made_deg = np.clip(np.rint(made_deg + error_deg * noise), *limits_deg)
    return unit_by_eye(design, design.poses_deg(faces), made_deg).calibration(design, limits_deg)
