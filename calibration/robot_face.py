"""What a robot's face does: markers as a function of servo angles, learnt from captured poses.

Loads scikit-learn; the live path never does.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct
from sklearn.linear_model import Ridge
from sklearn.model_selection import KFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, PolynomialFeatures

from calibration.capture import Capture
from calibration.skin import skin_smoothing

Array = NDArray[np.float64]

_FOLDS = 6
#: Rounds between fitting the face, its play, and the points that the tracker lost; the play of the
#: simulated robots changes by less than 0.01 degree after the third.
_ROUNDS = 3
#: How far along the skin markers are taken to move alike, to choose from; 0: not at all.
_SKIN_WIDTHS_MM = (0.0, 10.0, 18.0)
#: Play that a face shows too weakly to be measured is taken to be like that of the others.
_PRIOR_PLAY_SD_DEG = 0.4
_DIFFERENCE_DEG = 0.25


class Regressor(Protocol):
    """What scikit-learn's regressors have in common."""

    def fit(self, inputs: Array, outputs: Array) -> "Regressor":
        """Learn (n, n_inputs) -> (n, n_outputs)."""

    def predict(self, inputs: Array) -> Array:
        """(n, n_inputs) -> (n, n_outputs)."""


@dataclass(frozen=True, slots=True)
class RobotFace:
    """A learnt face. backlash_deg: (n_servos,), the whole width of the play.

    kind: which regression cross-validation chose; skin: (n_markers, n_markers), how it is smoothed
    over neighbouring markers; left_out_rms_mm: its error on poses left out, in
    each axis, the tracker's noise included; noise_mm: what the fit leaves unexplained.
    """

    servo_names: tuple[str, ...]
    marker_names: tuple[str, ...]
    kind: str
    regressor: Regressor
    skin: Array
    centre_mm: Array
    middle_deg: Array
    half_range_deg: Array
    backlash_deg: Array
    left_out_rms_mm: float
    noise_mm: float

    def markers_mm(self, output_deg: Array) -> Array:
        """(n, n_servos), degrees in the middle of the play -> (n, n_markers, 3)."""
        inputs = (output_deg - self.middle_deg) / self.half_range_deg
        learnt = np.asarray(self.regressor.predict(inputs))
        moved_mm = self.skin @ learnt.reshape(len(output_deg), *self.centre_mm.shape)
        return np.asarray(self.centre_mm + moved_mm)


def fit_robot_face(capture: Capture) -> RobotFace:
    """Learn the face from a capture; points that the tracker lost are left out of the fit.

    The kind of regression is chosen by cross-validation over poses. Play is found from the side
    that each pose was reached from, together with the face.
    """
    low, high = capture.goals_deg.min(axis=0), capture.goals_deg.max(axis=0)
    centre_mm = np.nanmean(capture.markers_mm, axis=0)
    seen = np.isfinite(capture.markers_mm)
    from_centre_mm = np.where(seen, capture.markers_mm - centre_mm, 0.0)
    face = RobotFace(
        servo_names=capture.servo_names,
        marker_names=capture.marker_names,
        kind="",
        regressor=Ridge(),
        skin=np.eye(len(centre_mm)),
        centre_mm=centre_mm,
        middle_deg=(high + low) / 2,
        half_range_deg=np.maximum((high - low) / 2, 1e-6),
        backlash_deg=np.zeros(len(low)),
        left_out_rms_mm=0.0,
        noise_mm=0.0,
    )
    for _ in range(_ROUNDS):
        face = _refit(face, capture, from_centre_mm, {"ridge, straight": _KINDS["ridge, straight"]})
        reached_mm = face.markers_mm(_reached_deg(face, capture)) - centre_mm
        from_centre_mm = np.where(seen, from_centre_mm, reached_mm)
        face = replace(face, backlash_deg=_play_deg(face, capture, from_centre_mm))
    face = _refit(face, capture, from_centre_mm, _KINDS)
    missed = (centre_mm + from_centre_mm - face.markers_mm(_reached_deg(face, capture)))[seen]
    return replace(face, noise_mm=float(np.sqrt(np.mean(missed**2))))


def _reached_deg(face: RobotFace, capture: Capture) -> Array:
    """(n, n_servos): where the horns stood, behind the play."""
    return np.asarray(capture.goals_deg - capture.from_below * face.backlash_deg / 2)


def _refit(
    face: RobotFace, capture: Capture, from_centre_mm: Array, kinds: Mapping[str, Regressor]
) -> RobotFace:
    """The kind with the least error on poses left out, fitted to all of them."""
    inputs = (_reached_deg(face, capture) - face.middle_deg) / face.half_range_deg
    outputs = from_centre_mm.reshape(len(inputs), -1)
    skins = [skin_smoothing(face.marker_names, face.centre_mm, w) for w in _SKIN_WIDTHS_MM]
    folds = KFold(_FOLDS, shuffle=True, random_state=0)
    least_mm, best = np.inf, face
    for kind, regressor in kinds.items():
        predicted = cross_val_predict(regressor, inputs, outputs, cv=folds)
        for width_mm, skin in zip(_SKIN_WIDTHS_MM, skins, strict=True):
            missed_mm = skin @ predicted.reshape(from_centre_mm.shape) - from_centre_mm
            error_mm = float(np.sqrt(np.mean(missed_mm**2)))
            if error_mm < least_mm:
                label = f"{kind}, skin {width_mm:g} mm"
                least_mm, best = error_mm, replace(face, kind=label, skin=skin, regressor=regressor)
    regressor = clone(best.regressor).fit(inputs, outputs)
    return replace(best, regressor=regressor, left_out_rms_mm=least_mm)


def _own_squares(inputs: Array) -> Array:
    """(n, k) -> (n, 2 k): every joint bends its own way, whatever the others do."""
    return np.hstack([inputs, 0.5 * inputs**2])


def _candidates() -> dict[str, Regressor]:
    """Regressions to choose from; inputs run from -1 to 1, outputs are millimetres off centre."""
    # Straight lines of about 3 mm a half range and a smooth remainder; alpha: variance of noise.
    straight = ConstantKernel(9.0, "fixed") * DotProduct(1.0, "fixed")
    bend = ConstantKernel(0.3, "fixed") * RBF(2.0, "fixed")
    return {
        "ridge, straight": Ridge(0.03),
        "ridge, own squares": make_pipeline(FunctionTransformer(_own_squares), Ridge(0.1)),
        "ridge, all squares": make_pipeline(PolynomialFeatures(2, include_bias=False), Ridge(1.0)),
        "gaussian process": GaussianProcessRegressor(straight + bend, alpha=0.3, optimizer=None),
    }


_KINDS = _candidates()


def _play_deg(face: RobotFace, capture: Capture, from_centre_mm: Array) -> Array:
    """(n_servos,): play by least squares on what the two sides of approach leave unexplained.

    A joint that its face hardly shows is drawn towards the mean of those that are seen well.
    """
    reached_deg = _reached_deg(face, capture)
    now_mm = face.markers_mm(reached_deg)
    missing_mm = face.centre_mm + from_centre_mm - now_mm
    columns = []
    for step in _DIFFERENCE_DEG * np.eye(len(face.backlash_deg)):
        slope = (face.markers_mm(reached_deg + step) - now_mm) / _DIFFERENCE_DEG
        side = capture.from_below @ (step > 0)
        columns.append((-side[:, None, None] / 2 * slope).ravel())
    system = np.array(columns)
    noise = np.mean(missing_mm**2)
    normal = system @ system.T / noise
    right = system @ missing_mm.ravel() / noise + normal @ face.backlash_deg
    seen = np.diag(normal)
    free = np.linalg.solve(normal + 1e-9 * np.eye(len(normal)), right)
    mean = float(np.average(free, weights=seen)) if seen.sum() > 0 else 0.0
    prior = np.eye(len(normal)) / _PRIOR_PLAY_SD_DEG**2
    return np.maximum(
        np.linalg.solve(normal + prior, right + prior @ np.full(len(free), mean)), 0.0
    )
