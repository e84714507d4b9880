"""Joints that stopped, slipped or came loose while a capture went on: named rightly or not at all.

Every suspicion is a model of the whole capture, fitted by least squares beside the healthy one: a
joint that stands still from some pose on, or everything shifted from some pose on. A suspicion must
explain far more than chance, and the accused far more than any other joint.
"""

from dataclasses import dataclass

import numpy as np

from calibration.capture.capture import Capture
from calibration.capture.straight_lines import StraightLines
from lipsync.arrays import Array

#: F values: by how much a suspicion explains more than noise would (1), and than another's.
_SURE, _AHEAD = 5.0, 1.5
#: A shift is a joint's own where it goes along with what the joint does, and with no other.
_ALIKE, _UNLIKE = 0.8, 0.15
_FIRST, _LAST = 6, 5
_STOP_SHARE = 0.7
_KINDS = {
    "stopped": "stopped moving",
    "slipped": "slipped on its shaft",
}


@dataclass(frozen=True, slots=True)
class JointFault:
    """kind: `stopped` or `slipped`, or `shifted` with no joint (-1) to blame; pose from 1."""

    kind: str
    joint: int
    pose: int

    def told(self, names: tuple[str, ...]) -> str:
        """One line, with what to do."""
        if self.joint < 0:
            return (
                f"from pose {self.pose} on the face is another one than before: was the tracker or "
                "a part moved? Look for it and capture again"
            )
        return (
            f"servo {names[self.joint]!r} {_KINDS[self.kind]} at about pose {self.pose}; check "
            "its horn, its rod and its torque, and capture again"
        )


def joint_fault(capture: Capture, lines: StraightLines) -> JointFault | None:
    """The one thing that went wrong, if one explains the capture so much better than none."""
    n = len(capture)
    low, high = capture.goals_deg.min(axis=0), capture.goals_deg.max(axis=0)
    x = 2 * (capture.goals_deg - low) / np.maximum(high - low, 1e-6) - 1
    seen = np.isfinite(capture.markers_mm).all(axis=2) & ~lines.far
    y = np.where(seen[..., None], capture.markers_mm, lines.expected_mm).reshape(n, -1)
    y = y - y.mean(axis=0)
    base = np.hstack([np.ones((n, 1)), x, x**2])
    if n < base.shape[1] + _FIRST + _LAST:
        base = base[:, : 1 + x.shape[1]]
    if n < base.shape[1] + _FIRST + _LAST:
        return None
    healthy = _left(base, y)
    # A joint that stands still is somewhere else, too: so a stop is asked for first.
    stops, shifts = _stops(base, x, y, healthy), _shifts(base, x, y, healthy)
    if stops and (not shifts or stops[0][0] > _STOP_SHARE * shifts[0][0]):
        return stops[0][1]
    return shifts[0][1] if shifts else None


def _left(inputs: Array, y: Array) -> float:
    """What a least-squares fit leaves, squared."""
    basis = np.linalg.qr(inputs)[0]
    return float((y**2).sum() - ((basis.T @ y) ** 2).sum())


def _stops(base: Array, x: Array, y: Array, healthy: float) -> list[tuple[float, JointFault]]:
    """The joint that best counts as standing still from some pose on."""
    n, n_servos = x.shape
    freedom = n - base.shape[1]
    best = []
    for joint in range(n_servos):
        others = np.delete(base, list(range(1 + joint, base.shape[1], n_servos)), 1)
        tries = []
        for k in range(_FIRST, n - _LAST):
            moves = np.where(np.arange(n)[:, None] < k, x[:, joint : joint + 1], 0.0)
            left = _left(np.hstack([others, moves, moves**2, np.arange(n)[:, None] >= k]), y)
            tries.append(((healthy - left) / (left / freedom), k))
        best.append((max(tries), joint))
    best.sort(reverse=True)
    (gain, k), joint = best[0]
    second = best[1][0][0] if len(best) > 1 else 0.0
    if gain > _SURE and gain > _AHEAD * max(second, 0.0):
        return [(gain, JointFault("stopped", joint, k + 1))]
    return []


def _shifts(base: Array, x: Array, y: Array, healthy: float) -> list[tuple[float, JointFault]]:
    """Everything shifted from some pose on: by whom, if it is what one joint does."""
    n, n_servos = x.shape
    tries = []
    for k in range(_FIRST, n - _LAST):
        inputs = np.hstack([base, np.arange(n)[:, None] >= k])
        left = _left(inputs, y)
        tries.append(((healthy - left) / (left / (n - inputs.shape[1])), k))
    gain, k = max(tries)
    if gain <= _SURE:
        return []
    fit = np.linalg.lstsq(np.hstack([base, np.arange(n)[:, None] >= k]), y, rcond=None)[0]
    shift, does = fit[-1], fit[1 : 1 + n_servos]
    alike = np.abs(does @ shift) / (np.linalg.norm(does, axis=1) * np.linalg.norm(shift) + 1e-12)
    order = np.argsort(alike)[::-1]
    second = alike[order[1]] if n_servos > 1 else 0.0
    own = alike[order[0]] > _ALIKE and alike[order[0]] > second + _UNLIKE
    return [
        (gain, JointFault("slipped" if own else "shifted", int(order[0]) if own else -1, k + 1))
    ]
