"""What a robot's face does: markers as a function of servo angles, learnt from captured poses.

Loads scikit-learn; the live path never does.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.model_selection import KFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer

from calibration.capture.capture import Capture
from calibration.fit.skin_process import (
    Hyperparameters,
    Poses,
    fit_hyperparameters,
    fit_process,
    squared_distances_mm2,
)
from lipsync.arrays import Array

_FOLDS = 6
#: Rounds between the fit of the hyperparameters and the points that the tracker lost.
_ROUNDS = 2


class Learnt(Protocol):
    """A fitted regression of either kind."""

    def predict(self, inputs: Array) -> Array:
        """(n, n_servos) -> (n, n_markers, 3) off the centre."""


class Learner(Protocol):
    """Something that learns from poses, as the baselines below do."""

    def fit(self, inputs: Array, from_centre_mm: Array) -> Learnt:
        """Learn (n, n_servos) -> (n, n_markers, 3)."""


@dataclass(frozen=True, slots=True)
class RobotFace:
    """A learnt face. backlash_deg: (n_servos,), the whole width of the backlash.

    kind: which regression cross-validation chose; left_out_rms_mm: its error on poses left out, in
    each axis, the tracker's noise included; noise_mm: what the fit leaves unexplained.
    """

    servo_names: tuple[str, ...]
    marker_names: tuple[str, ...]
    kind: str
    learnt: Learnt
    centre_mm: Array
    middle_deg: Array
    half_range_deg: Array
    backlash_deg: Array
    left_out_rms_mm: float
    noise_mm: float

    def markers_mm(self, output_deg: Array) -> Array:
        """(n, n_servos), degrees in the middle of the backlash -> (n, n_markers, 3)."""
        inputs = (output_deg - self.middle_deg) / self.half_range_deg
        return np.asarray(self.centre_mm + self.learnt.predict(inputs))


def fit_robot_face(capture: Capture) -> RobotFace:
    """Learn the face from a capture; points that the tracker lost are left out of the fit.

    Backlash is found from the side that each pose was reached from, together with the face. The
    kind of regression is chosen by cross-validation over poses.
    """
    low, high = capture.goals_deg.min(axis=0), capture.goals_deg.max(axis=0)
    half_range_deg = np.maximum((high - low) / 2, 1e-6)
    poses = Poses(capture.goals_deg, capture.from_below, (high + low) / 2, half_range_deg)
    centre_mm = np.nanmean(capture.markers_mm, axis=0)
    seen = np.isfinite(capture.markers_mm)
    from_centre_mm = np.where(seen, capture.markers_mm - centre_mm, 0.0)
    apart_mm2 = squared_distances_mm2(capture.marker_names, centre_mm)
    for _ in range(1 if seen.all() else _ROUNDS):
        hyperparameters = fit_hyperparameters(poses, from_centre_mm, apart_mm2)
        inputs = poses.inputs(hyperparameters.backlash_deg)
        process = fit_process(hyperparameters, inputs, from_centre_mm, apart_mm2)
        from_centre_mm = np.where(seen, from_centre_mm, process.predict(inputs))
    learners = _learners(hyperparameters, apart_mm2)
    left_out_mm = {
        kind: _left_out_rms_mm(learner, inputs, from_centre_mm, seen)
        for kind, learner in learners.items()
    }
    kind = min(left_out_mm, key=lambda each: left_out_mm[each])
    learnt = learners[kind].fit(inputs, from_centre_mm)
    missed_mm = (from_centre_mm - learnt.predict(inputs))[seen]
    return RobotFace(
        servo_names=capture.servo_names,
        marker_names=capture.marker_names,
        kind=kind,
        learnt=learnt,
        centre_mm=centre_mm,
        middle_deg=poses.middle_deg,
        half_range_deg=half_range_deg,
        backlash_deg=hyperparameters.backlash_deg,
        left_out_rms_mm=left_out_mm[kind],
        noise_mm=float(np.sqrt(np.mean(missed_mm**2))),
    )


@dataclass(frozen=True, slots=True)
class _Process:
    """The process of skin_process.py, its setting found beforehand."""

    hyperparameters: Hyperparameters
    apart_mm2: Array

    def fit(self, inputs: Array, from_centre_mm: Array) -> Learnt:
        return fit_process(self.hyperparameters, inputs, from_centre_mm, self.apart_mm2)


class _Ridge:
    """scikit-learn's regressions: every coordinate of every marker for itself."""

    def __init__(self, regressor: Ridge) -> None:
        self._regressor = regressor

    def fit(self, inputs: Array, from_centre_mm: Array) -> "_Ridge":
        fitted = clone(self._regressor).fit(inputs, from_centre_mm.reshape(len(inputs), -1))
        return _Ridge(fitted)

    def predict(self, inputs: Array) -> Array:
        return np.asarray(self._regressor.predict(inputs)).reshape(len(inputs), -1, 3)


def _learners(hyperparameters: Hyperparameters, apart_mm2: Array) -> Mapping[str, Learner]:
    """Regressions to choose from; inputs run from -1 to 1, outputs are millimetres off centre."""
    return {
        "gaussian process": _Process(hyperparameters, apart_mm2),
        "ridge, straight": _Ridge(Ridge(0.03)),
        "ridge, own squares": _Ridge(make_pipeline(FunctionTransformer(_own_squares), Ridge(0.1))),
    }


def _own_squares(inputs: Array) -> Array:
    """(n, k) -> (n, 2 k): every joint bends its own way, whatever the others do."""
    return np.hstack([inputs, 0.5 * inputs**2])


def _left_out_rms_mm(
    learner: Learner, inputs: Array, from_centre_mm: Array, seen: NDArray[np.bool_]
) -> float:
    """In each axis, over the points that the tracker saw."""
    predicted = np.empty_like(from_centre_mm)
    folds = KFold(min(_FOLDS, len(inputs)), shuffle=True, random_state=0)
    for rows, left_out in folds.split(inputs):
        predicted[left_out] = learner.fit(inputs[rows], from_centre_mm[rows]).predict(
            inputs[left_out]
        )
    return float(np.sqrt(np.mean((predicted - from_centre_mm)[seen] ** 2)))
