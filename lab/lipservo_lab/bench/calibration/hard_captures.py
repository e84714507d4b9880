"""Healthy elastic robots before trackers that are worse: who is refused all the same.

Fifteen markers in place of 47; a millimetre of noise in each axis in place of half of one; one
reading in a hundred that is anywhere within three centimetres.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.sanity import check_capture
from calibration.fit.procedure import Procedure
from calibration.mouth_servos import MouthServos
from calibration.simulated.elastic_robot import SENSOR_NOISE_MM, ElasticFace, ElasticRobot
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

_N_POSES = 60
_FEW = (
    "inner_lip_13", "inner_lip_14", "inner_lip_82", "inner_lip_87", "inner_lip_312",
    "inner_lip_317", "outer_lip_61", "outer_lip_291", "outer_lip_0", "outer_lip_17", "outer_lip_39",
    "outer_lip_269", "outer_lip_181", "outer_lip_405", "chin_199",
)  # fmt: skip
_OUTLIERS, _ANYWHERE_MM = 0.01, 30.0


@dataclass(frozen=True, slots=True)
class _Tracker:
    """marker_names: of those that it sees; disturbed: what it makes of (n_markers, 3)."""

    marker_names: tuple[str, ...] = MARKERS_47.names
    noise_mm: float = SENSOR_NOISE_MM
    disturbed: Callable[[Array, np.random.Generator], Array] = lambda seen_mm, _: seen_mm


def _with_outliers(seen_mm: Array, rng: np.random.Generator) -> Array:
    wild = rng.random((len(seen_mm), 1)) < _OUTLIERS
    return np.where(
        wild, seen_mm + rng.uniform(-_ANYWHERE_MM, _ANYWHERE_MM, seen_mm.shape), seen_mm
    )


_TRACKERS: Mapping[str, _Tracker] = {
    "15 markers": _Tracker(marker_names=_FEW),
    "1 mm of noise": _Tracker(noise_mm=1.0),
    "1 % of outliers": _Tracker(disturbed=_with_outliers),
}


def refusals(
    model: FaceWithAnimPhos, face: ElasticFace, servos: MouthServos, seed: int
) -> dict[str, str | None]:
    """For each tracker why the robot is refused, if it is: from the first pose to the last."""
    return {
        name: _refusal(model, face, servos, tracker, seed) for name, tracker in _TRACKERS.items()
    }


def _refusal(
    model: FaceWithAnimPhos, face: ElasticFace, servos: MouthServos, tracker: _Tracker, seed: int
) -> str | None:
    robot = ElasticRobot(face, noise_seed=seed, noise_mm=tracker.noise_mm)
    rng = np.random.default_rng([seed, 41])
    seen = [MARKERS_47.names.index(name) for name in tracker.marker_names]
    procedure = Procedure(model, servos.joints, _N_POSES, seed=seed, positive=servos.positive)
    try:
        capture = procedure.capture(
            tracker.marker_names,
            robot.move,
            lambda: tracker.disturbed(robot.measure()[seen], rng),
        )
        check_capture(capture, model, servos.positive)
    except CalibrationError as error:
        return str(error)
    return None
