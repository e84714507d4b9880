"""Tracks become an `ExpressionModel`: mixture, ridge, non-negative regression, log-normal blinks.

The only module here that loads scikit-learn and SciPy.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize, nnls
from scipy.signal import lfilter
from scipy.special import log_ndtr
from sklearn.mixture import GaussianMixture
from threadpoolctl import threadpool_limits

from lipservo_lab.learning.expression.tracks import GAZE, HEAD, LIDS, HeardTrack, TrackError
from lipservo_lab.learning.learned_expression.expression_model import (
    GAZE_POSES,
    HEAD_POSES,
    RATE_HZ,
    ExpressionModel,
    gaze_inputs,
    lid_inputs,
)
from lipservo_lab.learning.learned_expression.pose_mixture import N_FEATURES, PoseMixture
from lipsync.arrays import Array

#: Parts of the mixture: 12 of the design note's 8 to 16.
N_PARTS = 12
#: Below it there is nothing to learn: 20 frames for each number of 12 parts would be far more.
_LEAST_FRAMES = 1000
_REGULARISATION = 1e-4
#: Trackers jitter by 0.1 to 0.3 degrees a frame (second differences, grid_s1). An exponential mean
#: forwards and backwards leaves a spectrum that poses of second order can have: generated ones come
#: within 2.4 dB of it; with a moving cubic over 7 frames, 4.1 (training recordings, measured).
_SMOOTHING = 0.5
_RIDGE = 10.0
#: Poses stay within what was seen, and half as far again.
_SEEN_PERCENTILE, _BEYOND = 99.5, 1.5
#: A lid is shut in a blink above the first, and open again below the second.
_SHUT_ABOVE, _OPEN_BELOW = 0.5, 0.3
_FEWEST_BLINKS = 10


def smoothed(values: Array) -> Array:
    """Return angles without a tracker's jitter; half as large at 2.9 Hz, not late.

    Parameters
    ----------
    values : Array
        (n_frames, n).

    Returns
    -------
    Array
        (n_frames, n).
    """
    for _ in range(2):
        begin = (1.0 - _SMOOTHING) * values[:1]
        passed, _end = lfilter([_SMOOTHING], [1.0, _SMOOTHING - 1.0], values, axis=0, zi=begin)
        values = passed[::-1]
    return values


def fit_expression(heard: Sequence[HeardTrack], seed: int = 0) -> ExpressionModel:
    """Learn from tracks that tell of the same things. The same seed gives the same model.

    Raises TrackError for too little.
    """
    poses = [smoothed(each.track.stacked(HEAD)) for each in heard]
    usual = np.median(np.concatenate(poses), axis=0)
    poses = [each - usual for each in poses]
    with threadpool_limits(limits=1):  # several threads add up in changing order
        head = _fit_mixture(poses, [each.prosody for each in heard], seed)
    known = heard[0].track.values
    gaze = farthest_gaze_deg = lids = blinks = None
    gazes: list[Array] = []
    if set(GAZE) <= set(known):
        gazes = [smoothed(each.track.stacked(GAZE)) for each in heard]
        usual = np.median(np.concatenate(gazes), axis=0)
        gazes = [each - usual for each in gazes]
        gaze = _fit_gaze(poses, gazes, [each.prosody for each in heard])
        farthest_gaze_deg = _farthest(gazes)
    if set(LIDS) <= set(known):
        shut = [each.track.stacked(LIDS).mean(axis=1) for each in heard]
        blinks = fit_blinks(shut)
        lids = _fit_lids(shut, poses, gazes) if gazes else None
    return ExpressionModel(head, _farthest(poses), gaze, farthest_gaze_deg, lids, blinks)


def _farthest(values: list[Array]) -> Array:
    seen: Array = np.percentile(np.abs(np.concatenate(values)), _SEEN_PERCENTILE, axis=0)
    return _BEYOND * np.maximum(seen, 1e-3)


def _fit_mixture(poses: list[Array], prosody: list[Array], seed: int) -> PoseMixture:
    rows = []
    for pose, heard in zip(poses, prosody, strict=True):
        speed = np.diff(pose, axis=0) * RATE_HZ
        bend = np.diff(speed, axis=0) * RATE_HZ
        rows.append(np.concatenate((pose[2:], speed[1:], bend, heard[2 : len(pose)]), axis=1))
    features = np.concatenate(rows)
    if len(features) < _LEAST_FRAMES:
        raise TrackError(
            f"{len(features) / RATE_HZ:.0f} s of tracks teach no motion; record 20 minutes and more"
        )
    scale = np.maximum(features.std(axis=0), 1e-6)
    mixture = GaussianMixture(N_PARTS, reg_covar=_REGULARISATION, random_state=seed, max_iter=200)
    mixture.fit(features / scale)
    precisions = mixture.precisions_ / np.outer(scale, scale)
    symmetric = 0.5 * (precisions + precisions.transpose(0, 2, 1))
    assert symmetric.shape[1:] == (N_FEATURES, N_FEATURES)
    return PoseMixture(mixture.weights_, mixture.means_ * scale, symmetric, 1.0 / RATE_HZ)


def _fit_gaze(poses: list[Array], gazes: list[Array], prosody: list[Array]) -> Array:
    """Ridge regression (2, 21) from the last six poses of the head and the prosody."""
    inputs, targets = [], []
    for pose, gaze, heard in zip(poses, gazes, prosody, strict=True):
        for frame in range(HEAD_POSES - 1, len(pose)):
            newest_first = pose[frame - HEAD_POSES + 1 : frame + 1][::-1]
            inputs.append(gaze_inputs(newest_first, heard[frame]))
            targets.append(gaze[frame])
    x, y = np.array(inputs), np.array(targets)
    penalty = _RIDGE * np.eye(x.shape[1])
    penalty[-1, -1] = 0.0
    weights: Array = np.linalg.solve(x.T @ x + penalty, x.T @ y).T
    return weights


def _fit_lids(shut: list[Array], poses: list[Array], gazes: list[Array]) -> Array:
    """Non-negative regression (6,) of the lids between blinks."""
    inputs, targets = [], []
    for lid, pose, gaze in zip(shut, poses, gazes, strict=True):
        blinks = lid > _OPEN_BELOW
        near = blinks.copy()
        for shift in range(1, 6):  # 0.2 s on both sides: lids move before the bar and after it
            near[shift:] |= blinks[:-shift]
            near[:-shift] |= blinks[shift:]
        for frame in np.flatnonzero(~near):
            if frame >= GAZE_POSES - 1:
                newest_first = gaze[frame - GAZE_POSES + 1 : frame + 1, 1][::-1]
                inputs.append(lid_inputs(newest_first, float(pose[frame, 0])))
                targets.append(lid[frame])
    if len(inputs) < _LEAST_FRAMES // 10:
        raise TrackError("lids are hardly ever open in these tracks; are they 0 = open, 1 = shut?")
    weights: Array = nnls(np.array(inputs), np.array(targets))[0]
    return weights


def blink_times_s(shut: Array) -> Array:
    """Return when the lids of a track pass half shut on their way down.

    Parameters
    ----------
    shut : Array
        (n_frames,).

    Returns
    -------
    Array
        (n_blinks,) s.
    """
    times_s, is_shut = [], bool(shut[0] > _OPEN_BELOW)
    for frame, value in enumerate(shut.tolist()):
        if not is_shut and value > _SHUT_ABOVE:
            times_s.append(frame / RATE_HZ)
            is_shut = True
        elif value < _OPEN_BELOW:
            is_shut = False
    return np.array(times_s)


def fit_blinks(shut: Sequence[Array]) -> tuple[float, float] | None:
    """Return mean and standard deviation of log intervals by maximum likelihood.

    Intervals that a recording's end cuts off count as longer than what was seen of them, or short
    recordings would know of short intervals only. What precedes the first blink is left out.

    Parameters
    ----------
    shut : Sequence[Array]
        (n_frames,) each.

    Returns
    -------
    tuple[float, float] | None
        Of the logarithm of s; None: too few blinks.
    """
    whole, cut, n_blinks = [], [], 0
    for lid in shut:
        times_s = blink_times_s(lid)
        n_blinks += len(times_s)
        if len(times_s):
            whole += np.diff(times_s).tolist()
            cut.append(max(1.0 / RATE_HZ, (len(lid) - 1) / RATE_HZ - times_s[-1]))
    if n_blinks < _FEWEST_BLINKS or len(whole) < _FEWEST_BLINKS // 2:
        return None
    seen, unseen = np.log(np.array(whole)), np.log(np.array(cut))

    def cost(parameters: Array) -> float:
        mean, log_sd = parameters
        sd = math.exp(log_sd)
        inside = 0.5 * np.square((seen - mean) / sd).sum() + len(seen) * log_sd
        return float(inside - log_ndtr((mean - unseen) / sd).sum())

    best = minimize(cost, (float(seen.mean()), 0.0), method="Nelder-Mead")
    return float(best.x[0]), float(np.exp(best.x[1]))
