"""Corrections of a map's angles on their path to the servos: viseme trims, servo lags, backlash.

Streaming; NumPy only, a few microseconds a frame.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calibration.calibration import Calibration, CalibrationError
from lipsync.arrays import Array
from lipsync.phonemes import VISEME_CLASSES, VISEME_OF

#: A turn smaller than this is not made up for: goals would chatter by the whole backlash at every
#: rounding. About four steps of a Dynamixel X.
_TURN_DEG = 0.35


class BacklashCompensation:
    """A filter that shifts every goal by half the backlash, towards the joint's motion.

    Without it a horn stays half the backlash behind its pose. `feed` is called once a tick.
    """

    def __init__(self, backlash_deg: Array) -> None:
        """Store half of backlash_deg, (n_servos,), the whole width of each joint's backlash."""
        self._half_backlash_deg = backlash_deg / 2
        self._has_backlash = bool(backlash_deg.any())
        #: The direction of each joint's last motion, 1 or -1, and the furthest it went that way.
        self._side = np.ones(len(backlash_deg))
        self._furthest_deg: Array | None = None

    def feed(self, poses_deg: Array) -> Array:
        """Return the goals that bring the horns to poses, despite the backlash.

        Only the first pose, that of now, changes the stored state: later ones may be revised.

        Parameters
        ----------
        poses_deg : Array
            (k, n_servos) degrees, positions of the horns now and later.

        Returns
        -------
        Array
            (k, n_servos) degrees.
        """
        if not self._has_backlash:
            return poses_deg
        side = self._side
        furthest_deg = poses_deg[0] if self._furthest_deg is None else self._furthest_deg
        sides = np.empty_like(poses_deg)
        for n, pose_deg in enumerate(poses_deg):
            beyond_deg = (pose_deg - furthest_deg) * side
            # A joint has reversed once it is back from its furthest angle by more than rounding.
            reversed_ = beyond_deg < -_TURN_DEG
            side = np.where(reversed_, -side, side)
            furthest_deg = np.where(reversed_ | (beyond_deg > 0), pose_deg, furthest_deg)
            sides[n] = side
            if n == 0:
                self._side, self._furthest_deg = side, furthest_deg
        return np.asarray(poses_deg + sides * self._half_backlash_deg)


class LagCompensation:
    """A filter that sends each joint its goal earlier by that servo's lag behind its goals.

    Poses go in `advance_s`, the largest lag, before they are shown; the slowest joint gets its goal
    at once, the others are delayed here by the difference. `feed` is called each `period_s`.
    """

    def __init__(self, lag_s: Array, period_s: float, *, look_ahead_s: float) -> None:
        """Set how long ahead each joint gets its goal: by lag_s, (n_servos,), at most look_ahead_s.

        period_s: time between calls of `feed`; look_ahead_s: how far ahead poses are known.
        """
        ahead_s = np.minimum(np.maximum(lag_s, 0.0), look_ahead_s)
        self.advance_s = float(ahead_s.max(initial=0.0))
        # The delay of each joint here, in periods: whole ones, and the part of one that is left.
        wait_periods = (self.advance_s - ahead_s) / period_s
        self._n_whole = np.floor(wait_periods + 1e-9).astype(np.int64)
        self._part = np.maximum(wait_periods - self._n_whole, 0.0)
        self._n_stored = int(self._n_whole.max(initial=0)) + 2
        self._joints = np.arange(len(lag_s))
        self._recent: Array | None = None
        self._newest = 0

    def feed(self, positions_deg: Array) -> Array:
        """Return the goals to send now, each joint's delayed by `advance_s` less its lag.

        Parameters
        ----------
        positions_deg : Array
            (n_servos,) degrees, the pose to show `advance_s` from now.

        Returns
        -------
        Array
            (n_servos,) degrees.
        """
        if self._recent is None:
            self._recent = np.tile(positions_deg, (self._n_stored, 1))
        self._newest = (self._newest + 1) % self._n_stored
        self._recent[self._newest] = positions_deg
        # Each joint's goal lies between two stored poses, by the part of a period.
        newer_deg = self._recent[(self._newest - self._n_whole) % self._n_stored, self._joints]
        older_deg = self._recent[(self._newest - self._n_whole - 1) % self._n_stored, self._joints]
        return np.asarray(newer_deg + self._part * (older_deg - newer_deg))


#: Trims come and go with this time constant: within a phone of 80 ms, without a step that the
#: servos would make audible.
_BLEND_S = 0.03


def trimmed(calibration: Calibration, phoneme: str, joint: str, degrees: float) -> Calibration:
    """Return the calibration with the trim of one joint in a phoneme's viseme class replaced.

    Raises CalibrationError for an unknown phoneme or joint, or degrees beyond the joint's range.
    """
    if phoneme not in VISEME_OF:
        known = " ".join(viseme[0] for viseme in VISEME_CLASSES)
        raise CalibrationError(f"no phoneme {phoneme!r}; one of each viseme: {known}")
    if joint not in calibration.servo_names:
        known = ", ".join(calibration.servo_names)
        raise CalibrationError(f"this calibration has no joint {joint!r}; it has {known}")
    joint_number = calibration.servo_names.index(joint)
    span_deg = float(calibration.max_deg[joint_number] - calibration.min_deg[joint_number])
    if not abs(degrees) <= span_deg:
        raise CalibrationError(f"{joint} turns {span_deg:g} deg in all, not {degrees:g}")
    viseme = VISEME_CLASSES[VISEME_OF[phoneme]][0]
    added_deg = calibration.trim.get(viseme, np.zeros(len(calibration.servo_names))).copy()
    added_deg[joint_number] = degrees
    return replace(calibration, trim={**calibration.trim, viseme: added_deg})


class VisemeTrim:
    """A filter with the trim, in degrees, of the viseme class being spoken, blended over 30 ms."""

    def __init__(self, trim: Mapping[str, Array], n_servos: int, period_s: float) -> None:
        """Store the trims: degrees (n_servos,) by the first phoneme of a viseme class.

        period_s: time between calls of `feed`.
        """
        self._zeros_deg = np.zeros(n_servos)
        self._trims_deg = [trim.get(viseme[0], self._zeros_deg) for viseme in VISEME_CLASSES]
        # How much of the way to the wanted trim is gone in one period.
        self._step_share = 1.0 - np.exp(-period_s / _BLEND_S)
        self._idle = not trim
        self._added_deg = self._zeros_deg

    def feed(self, phoneme: str) -> Array:
        """Return the degrees to add to the pose in this period.

        Parameters
        ----------
        phoneme : str
            Phoneme shown in this period.

        Returns
        -------
        Array
            (n_servos,) degrees.
        """
        if not self._idle:
            wanted_deg = self._trims_deg[VISEME_OF[phoneme]]
            self._added_deg = self._added_deg + self._step_share * (wanted_deg - self._added_deg)
        return self._added_deg
