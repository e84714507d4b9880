"""Calibration of a jaw alone, from markers on the jaw: the mouth of a talking skeleton.

How far a jaw is open is one number, the blend of a closed and an open jaw line. Edge, Hilton and
Jackson fit it by one parameter alpha for each frame, minimising
sum_i || m_i - ((1 - alpha) c_i + alpha o_i) ||^2 over the jaw line, by Newton's method with finite
differences. The speaker's blend is linear in the model's coefficients. A sweep of the robot's jaw
gives its blend at each angle; the speaker's widest opening becomes the robot's. Lips are ignored,
so P, B and M close as far as the speaker's jaw does.
Loads scikit-learn; the live path never does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.calibration import Calibration, CalibrationError, Origin
from calibration.capture.capture import Capture
from calibration.capture.sanity import check_capture
from calibration.fit.learnt_face import ridge_weights
from calibration.fit.measured import backlash_only, split_frames
from calibration.fit.robot_face import fit_robot_face
from calibration.grade import HoldOutErrors, each_marker_rms_mm
from calibration.mouth_servos import MouthServos, linear_calibration
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: The markers that ride on the jaw.
JAW_LINE: tuple[int, ...] = tuple(
    i for i, name in enumerate(MARKERS_47.names) if name.startswith(("jaw", "chin"))
)
#: A jaw line that moves less than this between closed and open says nothing.
_LEAST_MOTION_MM = 1.0
#: The speaker's open jaw: wider is rare.
_OPEN_QUANTILE = 0.98


@dataclass(frozen=True, slots=True)
class JawBlend:
    """The blend between a closed and an open jaw line; closed_mm, open_mm: (n_points, 3)."""

    closed_mm: Array
    open_mm: Array

    def alpha(self, points_mm: Array) -> Array:
        """Return how far the jaw is open where its line is nearest to points, by least squares.

        Parameters
        ----------
        points_mm : Array
            (n, n_points, 3) mm.

        Returns
        -------
        Array
            (n,): 0 closed, 1 open.
        """
        closed_to_open_mm = self.open_mm - self.closed_mm
        along_mm2 = np.sum((points_mm - self.closed_mm) * closed_to_open_mm, axis=(1, 2))
        return np.asarray(along_mm2 / np.sum(closed_to_open_mm**2))


def speakers_jaw(model: FaceWithAnimPhos) -> JawBlend:
    """Return the speaker's blend: from the model's rest to the mean of its widest open frames.

    Raises CalibrationError for a speaker whose jaw line hardly moves.
    """
    frames = model.animphos.frames
    jaw = list(JAW_LINE)
    markers_mm = model.markers_mm(frames)[:, jaw]
    height_mm = markers_mm[:, :, 1].mean(axis=1)
    # An open jaw is low: the lowest 2 % of the frames.
    widest = height_mm <= np.quantile(height_mm, 1.0 - _OPEN_QUANTILE)
    return jaw_blend(model.markers_mm(model.rest[None])[0, jaw], markers_mm[widest].mean(axis=0))


def jaw_blend(closed_mm: Array, open_mm: Array) -> JawBlend:
    """Return the blend between a closed and an open jaw line.

    Parameters
    ----------
    closed_mm,open_mm : Array
        (n_points, 3) mm.

    Returns
    -------
    JawBlend
        The blend.

    Raises
    ------
    CalibrationError
        The two differ by less than 1 mm.
    """
    apart_mm = float(np.linalg.norm(open_mm - closed_mm, axis=1).max())
    if apart_mm < _LEAST_MOTION_MM:
        raise CalibrationError(
            f"the jaw line moves by {apart_mm:.1f} mm between closed and open mouth; put markers "
            "on the chin"
        )
    return JawBlend(closed_mm, open_mm)


def steady_alphas(blend: JawBlend, degrees: Array, points_mm: Array) -> Array:
    """Return alpha, how far the jaw is open, in each pose of a sweep of the robot's jaw.

    Parameters
    ----------
    blend : JawBlend
        The robot's closed and open jaw line.
    degrees : Array
        (n,) ascending joint angles of the sweep.
    points_mm : Array
        (n, n_points, 3) mm, the jaw line at them.

    Returns
    -------
    Array
        (n,), ascending.

    Raises
    ------
    CalibrationError
        The jaw does not open steadily with its angle.
    """
    alphas = blend.alpha(points_mm)
    if len(degrees) < 2 or (np.diff(degrees) <= 0).any() or (np.diff(alphas) <= 0).any():
        raise CalibrationError(
            "the mouth does not open steadily with the jaw; sweep it again, or reverse its `sign`"
        )
    return alphas


#: Enough for a curve that hardly bends.
_SWEEP = 12
#: Limits are met rarely, as in retargeting.
_USED_SHARE = 0.9
_LEAST_MARKERS = 3


def jaw_markers(marker_names: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of the markers in `marker_names` that lie on the jaw line."""
    line = {MARKERS_47.names[i] for i in JAW_LINE}
    return tuple(i for i, name in enumerate(marker_names) if name in line)


def fit_jaw(
    model: FaceWithAnimPhos,
    capture: Capture,
    servos: MouthServos,
    *,
    date: str = "",
    seed: int = 0,
    accept: bool = False,
) -> tuple[Calibration, tuple[str, ...]]:
    """Return the calibration of a single jaw servo, and warnings. Only jaw-line markers count.

    date: ISO 8601; seed: of the choice of held-out frames; accept: doubts about size and joints
    become warnings. Raises CalibrationError for fewer than three such markers, and for a capture
    with faults.
    """
    on_jaw = list(jaw_markers(capture.marker_names))
    if len(on_jaw) < _LEAST_MARKERS:
        raise CalibrationError(
            f"only {len(on_jaw)} markers are on the jaw, {_LEAST_MARKERS} are needed; their names "
            "begin with `jaw` or `chin`"
        )
    checked = check_capture(capture, model, servos.positive, accept=accept)
    capture, warnings = checked.capture, checked.warnings
    face = fit_robot_face(capture)
    (joint,) = servos.joints
    sweep_deg = np.linspace(joint.min_deg, _USED_SHARE * joint.max_deg, _SWEEP)
    swept_mm = face.markers_mm(sweep_deg[:, None])[:, on_jaw]
    robot_blend = jaw_blend(face.markers_mm(np.zeros((1, 1)))[0, on_jaw], swept_mm[-1])
    alphas = steady_alphas(robot_blend, sweep_deg, swept_mm)
    speaker_blend = speakers_jaw(model)

    def wanted_alpha(frames: Array) -> Array:
        return speaker_blend.alpha(model.markers_mm(frames)[:, list(JAW_LINE)])

    fitted, held_out = split_frames(model, seed)
    limits = servos.limits_deg
    # Straight, and beyond the ends too: limits cut it off at run time, and a line fits a line.
    degrees_per_alpha = float(alphas @ sweep_deg / (alphas @ alphas))
    weights = ridge_weights(fitted - model.rest, degrees_per_alpha * wanted_alpha(fitted)[:, None])
    free_deg = (held_out - model.rest) @ weights.T
    mapped_deg = np.clip(free_deg, *limits)
    wanted_deg = np.interp(wanted_alpha(held_out), alphas, sweep_deg)[:, None]
    # Errors of the held-out frames, on the learnt face and along the jaw line only.
    off_mm = (face.markers_mm(mapped_deg) - face.markers_mm(wanted_deg))[:, on_jaw]
    off_deg = mapped_deg - wanted_deg
    names = [capture.marker_names[i] for i in on_jaw]
    errors = HoldOutErrors(
        n_frames=len(held_out),
        marker_rms_mm=float(np.sqrt(np.mean(np.sum(off_mm**2, axis=2)))),
        clipped_share=float((free_deg != mapped_deg).mean()),
        joint_rms_deg=(float(np.sqrt(np.mean(off_deg**2))),),
        each_marker_rms_mm=each_marker_rms_mm(names, off_mm),
    )
    calibration = linear_calibration(
        model,
        servos,
        weights,
        errors=errors,
        origin=Origin("jaw alone", date, len(capture), servos.models),
        following=backlash_only(face.backlash_deg),
    )
    return calibration, warnings


def jaw_agreement(model: FaceWithAnimPhos, calibration: Calibration, joint: int) -> float:
    """Return the correlation, over some of the speech, of a joint's angle with the speaker's jaw.

    joint: its number. From -1 to 1; 0 where angle or jaw never changes.
    """
    samples = model.animphos.samples[:: max(1, len(model.animphos) // 200)]
    frames = samples.reshape(-1, model.n_components)
    alpha = speakers_jaw(model).alpha(model.markers_mm(frames)[:, list(JAW_LINE)])
    turned_deg = np.array([calibration.positions_deg(frame)[joint] for frame in frames])
    if turned_deg.std() == 0.0 or alpha.std() == 0.0:
        return 0.0
    return float(np.corrcoef(alpha, turned_deg)[0, 1])
