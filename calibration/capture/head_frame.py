"""Markers counted from the head: a tripod that was knocked, or a camera held in the hand.

The nose does not move with the mouth. Where its markers go to and fro together, by more than the
tracker's noise, each reading is laid on the usual place of the rigid markers by the best rotation
and shift (Kabsch 1976).
"""

from dataclasses import replace

import numpy as np

from calibration.capture.capture import Capture
from calibration.capture.straight_lines import StraightLines
from lipsync.arrays import Array

_RIGID = ("nose", "cheek_50", "cheek_280")
_LEAST_MARKERS = 3
#: Three dots on a nose, noisy as they are, say nothing of how the lips below them are turned.
_LEAST_TO_TURN = 5
#: What no joint explains must move the nose as one piece by so much, rms, and by so many times what
#: the noise of single markers would.
_MOVES_MM, _TIMES = 1.2, 2.0


def in_head_frame(capture: Capture, lines: StraightLines) -> tuple[Capture, tuple[str, ...]]:
    """The same where the head keeps still or no rigid marker is seen; else laid on one another."""
    nose = [i for i, name in enumerate(capture.marker_names) if name.startswith("nose")]
    rigid = [i for i, name in enumerate(capture.marker_names) if name.startswith(_RIGID)]
    if len(nose) < _LEAST_MARKERS:
        return capture, ()
    usual_mm = np.nanmedian(capture.markers_mm, axis=0)
    off_mm = capture.markers_mm[:, nose] - lines.expected_mm[:, nose]
    whole = np.isfinite(off_mm).all(axis=(1, 2))
    if whole.sum() < len(capture) / 2:
        return capture, ()
    middle_mm = _middle_of(off_mm)[whole][:, 0]
    moves_mm = float(np.sqrt(np.mean(np.sum(middle_mm**2, axis=1))))
    apart_mm = (off_mm - _middle_of(off_mm))[whole]
    noise_mm = 1.4826 * float(np.median(np.abs(apart_mm))) * np.sqrt(3.0 / len(nose)) * 1.5
    if moves_mm < max(_MOVES_MM, _TIMES * noise_mm):
        return capture, ()
    laid = capture.markers_mm.copy()
    for pose, points_mm in enumerate(capture.markers_mm):
        known = [i for i in rigid if np.isfinite(points_mm[i]).all()]
        if len(known) >= _LEAST_MARKERS:
            laid[pose] = _laid_on(points_mm, points_mm[known], usual_mm[known])
    return (
        replace(capture, markers_mm=laid),
        (
            f"the head or the tracker moved by {moves_mm:.1f} mm (rms) during the capture: markers "
            "are counted from the nose; fix the tripod for a better calibration",
        ),
    )


def on_head(
    markers_mm: Array, usual_mm: Array, marker_names: tuple[str, ...]
) -> tuple[Array, bool]:
    """(n, n_markers, 3) laid on the head as it was: where the nose is elsewhere than in usual_mm.

    usual_mm: (n, n_markers, 3), where rigid markers were. First as one piece, as a tripod that
    stands elsewhere wants it, then pose by pose where the nose still moves. The second part:
    whether it was needed.
    """
    nose = [i for i, name in enumerate(marker_names) if name.startswith("nose")]
    rigid = [i for i, name in enumerate(marker_names) if name.startswith(_RIGID)]
    if len(nose) < _LEAST_MARKERS or _nose_moves_mm(markers_mm - usual_mm, nose) < _MOVES_MM:
        return markers_mm, False
    known = np.asarray(np.isfinite(markers_mm[:, rigid]).all(axis=2))
    turns = len(rigid) >= _LEAST_TO_TURN
    seen_mm, wanted_mm = markers_mm[:, rigid][known], usual_mm[:, rigid][known]
    flat_mm = markers_mm.reshape(-1, 3)
    laid = _laid_on(flat_mm, seen_mm, wanted_mm, turns=turns).reshape(markers_mm.shape)
    if _nose_moves_mm(laid - usual_mm, nose) < _MOVES_MM:
        return laid, True
    for pose in np.flatnonzero(known.sum(axis=1) >= _LEAST_MARKERS):
        own = [i for i, is_known in zip(rigid, known[pose], strict=True) if is_known]
        points_mm, at_mm = laid[pose], usual_mm[pose, own]
        laid[pose] = _laid_on(points_mm, points_mm[own], at_mm, turns=turns)
    return laid, True


def _nose_moves_mm(off_mm: Array, nose: list[int]) -> float:
    """How far the nose is off as one piece, rms over poses in which all of it was seen."""
    whole = np.isfinite(off_mm[:, nose]).all(axis=(1, 2))
    if not whole.any():
        return 0.0
    middle_mm = _middle_of(off_mm[whole][:, nose])[:, 0]
    return float(np.sqrt(np.mean(np.sum(middle_mm**2, axis=1))))


def _middle_of(points_mm: Array) -> Array:
    """(n, n_points, 3) -> (n, 1, 3)."""
    return np.asarray(np.median(points_mm, axis=1, keepdims=True))


def _laid_on(points_mm: Array, rigid_mm: Array, usual_mm: Array, *, turns: bool = True) -> Array:
    """(n, 3) by the rotation and shift that bring rigid_mm nearest to usual_mm, or the shift."""
    centre, target = rigid_mm.mean(axis=0), usual_mm.mean(axis=0)
    if not turns:
        return np.asarray(points_mm - centre + target)
    left, _, right = np.linalg.svd((rigid_mm - centre).T @ (usual_mm - target))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray((points_mm - centre) @ (left @ turn @ right) + target)
