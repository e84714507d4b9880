"""The regression that runs live: from coefficients to servo angles, fitted to solved poses.

A quadratic ridge regression, and the correction by which lips meet. Centres of bends, errors
weighted by their effect on the lips, and closures that count more were tried and won nothing
(docs/decisions/calibration.md).
"""

from typing import Any

import numpy as np

from calibration.closure import Closure, pairs
from calibration.fit.retargeting import Retargeting, gap_heights_mm
from lipsync.arrays import Array

#: Poses are noisy by a few tenths of a degree where the face hardly shows a joint; this keeps the
#: quadratic terms from following that. In degrees per unit of a standardised feature, squared.
_RIDGE = 3.0
#: The file keeps this many digits, so the fit does as well and its errors are those of the file.
SIGNIFICANT_DIGITS = 6
#: What a degree costs against a millimetre where the lips are made to meet: joints that show little
#: stay tame.
_TURN_MM_PER_DEG = 0.1


def fit_run_time_map(from_rest: Array, poses_deg: Array) -> dict[str, Any]:
    """Return the live map fitted to poses by ridge regression, as fields of a `Calibration`.

    Parameters
    ----------
    from_rest : Array
        (n, n_components) mm, coefficients less the rest.
    poses_deg : Array
        (n, n_servos) degrees, the pose wanted for each.

    Returns
    -------
    dict[str, Any]
        Arrays rounded to the digits of the calibration file.
    """
    n_components = from_rest.shape[1]
    first, second = pairs(n_components)
    # Inputs: coefficients and their products, standardised.
    features = np.hstack([from_rest, from_rest[:, first] * from_rest[:, second]])
    feature_mean, feature_sd = features.mean(axis=0), features.std(axis=0) + 1e-12
    inputs, mean_deg = (features - feature_mean) / feature_sd, poses_deg.mean(axis=0)
    normal = inputs.T @ inputs + _RIDGE * np.eye(inputs.shape[1])
    solved = np.linalg.solve(normal, inputs.T @ (poses_deg - mean_deg))
    slopes = solved / feature_sd[:, None]
    return {
        "rest_deg": rounded(mean_deg - feature_mean @ slopes),
        "weights": rounded(slopes[:n_components].T),
        "quadratic_weights": rounded(slopes[n_components:].T),
        "x_range": rounded(np.array([from_rest.min(axis=0), from_rest.max(axis=0)])),
    }


def rounded(values: Array) -> Array:
    """Return values rounded to the significant digits of the calibration file.

    Parameters
    ----------
    values : Array
        Any shape.

    Returns
    -------
    Array
        Rounded values, shaped as the argument.
    """
    kept = [float(f"{value:.{SIGNIFICANT_DIGITS}g}") for value in values.ravel()]
    return np.array(kept).reshape(values.shape)


def fit_closure(retargeting: Retargeting, from_rest: Array, poses_deg: Array) -> Closure | None:
    """Return the correction that makes lips meet, a quadratic of the joints about closed poses.

    Parameters
    ----------
    retargeting : Retargeting
        The learnt face.
    from_rest : Array
        (n, n_components) mm, coefficients less the rest.
    poses_deg : Array
        (n, n_servos) degrees, the pose wanted for each.

    Returns
    -------
    Closure | None
        None where the speaker's lips never close.
    """
    is_closed = retargeting.closing(from_rest) >= 1.0
    if not is_closed.any():
        return None
    model, mouth = retargeting.model, retargeting.mouth
    shape = mouth.names.shape_features
    n_components = from_rest.shape[1]
    rest_mm = model.markers_mm(model.rest[None])
    moved_mm = model.markers_mm(model.rest + np.eye(n_components)) - rest_mm
    # The speaker's vector between the lips at rest, and after one mm of each coefficient.
    between_mm = model.layout.gap_vectors_mm(np.concatenate([rest_mm, rest_mm + moved_mm]))
    if not model.layout.has_inner_lips:
        between_mm = between_mm - model.lips_touching_mm
    opens_mm = gap_heights_mm(retargeting.scale * moved_mm[:, list(mouth.names.human)], shape.gaps)
    at_deg = poses_deg[is_closed].mean(axis=0)

    def open_mm(moved_deg: Array) -> Array:
        return gap_heights_mm(mouth.markers_of(at_deg + moved_deg), shape.gaps)

    n_servos = len(at_deg)
    first, second = pairs(n_servos)
    one_deg = np.eye(n_servos)
    gaps_closed, more, less = open_mm(np.zeros((1, n_servos))), open_mm(one_deg), open_mm(-one_deg)
    # Slopes, squares and products of the joints by differences of one degree about the closed pose.
    # A joint that is held still turns nothing.
    both = open_mm(one_deg[first] + one_deg[second])
    cross_terms = both - more[first] - more[second] + gaps_closed
    square_terms = (more + less) / 2 - gaps_closed
    bends = np.where((first == second)[:, None], square_terms[first], cross_terms)
    slopes = (more - less).T / 2 * (mouth.limits_deg[0] < mouth.limits_deg[1])
    # Turns that open one gap at the least cost: the regularised inverse of the slopes.
    turns_deg = slopes.T @ np.linalg.inv(
        slopes @ slopes.T + _TURN_MM_PER_DEG**2 * np.eye(len(slopes))
    )
    return Closure(
        speaker_mm=rounded((between_mm[1:] - between_mm[0]).T),
        speaker_rest_mm=rounded(between_mm[0]),
        opens_mm=rounded(opens_mm.T),
        at_deg=rounded(at_deg),
        gaps_mm=rounded(gaps_closed[0] - retargeting.closed_mm),
        slopes=rounded(slopes),
        bends=rounded(bends.T),
        turns_deg=rounded(turns_deg),
        press_mm=retargeting.press_mm,
    )
