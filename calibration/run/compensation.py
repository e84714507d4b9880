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
        self._half_deg = backlash_deg / 2
        self._any = bool(backlash_deg.any())
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
        if not self._any:
            return poses_deg
        side = self._side
        furthest_deg = poses_deg[0] if self._furthest_deg is None else self._furthest_deg
        sides = np.empty_like(poses_deg)
        for n, pose_deg in enumerate(poses_deg):
            beyond_deg = (pose_deg - furthest_deg) * side
            turned = beyond_deg < -_TURN_DEG
            side = np.where(turned, -side, side)
            furthest_deg = np.where(turned | (beyond_deg > 0), pose_deg, furthest_deg)
            sides[n] = side
            if n == 0:
                self._side, self._furthest_deg = side, furthest_deg
        return np.asarray(poses_deg + sides * self._half_deg)


class LagCompensation:
    """A filter that sends each joint its goal earlier by that servo's lag behind its goals.

    Poses go in `advance_s`, the largest lag, before they are shown; the slowest joint gets its goal
    at once, the others are delayed here by the difference. `feed` is called each `period_s`.
    """

    def __init__(self, lag_s: Array, period_s: float, *, look_ahead_s: float) -> None:
        """Set how long ahead each joint gets its goal: by lag_s, (n_servos,), at most look_ahead_s.

        period_s: time between calls of `feed`; look_ahead_s: how far ahead poses are known.
        """
        early_s = np.minimum(np.maximum(lag_s, 0.0), look_ahead_s)
        self.advance_s = float(early_s.max(initial=0.0))
        wait = (self.advance_s - early_s) / period_s
        self._whole = np.floor(wait + 1e-9).astype(np.int64)
        self._part = np.maximum(wait - self._whole, 0.0)
        self._length = int(self._whole.max(initial=0)) + 2
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
            self._recent = np.tile(positions_deg, (self._length, 1))
        self._newest = (self._newest + 1) % self._length
        self._recent[self._newest] = positions_deg
        later = self._recent[(self._newest - self._whole) % self._length, self._joints]
        earlier = self._recent[(self._newest - self._whole - 1) % self._length, self._joints]
        return np.asarray(later + self._part * (earlier - later))


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
    index = calibration.servo_names.index(joint)
    span_deg = float(calibration.max_deg[index] - calibration.min_deg[index])
    if not abs(degrees) <= span_deg:
        raise CalibrationError(f"{joint} turns {span_deg:g} deg in all, not {degrees:g}")
    viseme = VISEME_CLASSES[VISEME_OF[phoneme]][0]
    row = calibration.trim.get(viseme, np.zeros(len(calibration.servo_names))).copy()
    row[index] = degrees
    return replace(calibration, trim={**calibration.trim, viseme: row})


class VisemeTrim:
    """A filter with the trim, in degrees, of the viseme class being spoken, blended over 30 ms."""

    def __init__(self, trim: Mapping[str, Array], n_servos: int, period_s: float) -> None:
        """Store the trims: degrees (n_servos,) by the first phoneme of a viseme class.

        period_s: time between calls of `feed`.
        """
        self._nothing = np.zeros(n_servos)
        self._wanted = [trim.get(viseme[0], self._nothing) for viseme in VISEME_CLASSES]
        self._share = 1.0 - np.exp(-period_s / _BLEND_S)
        self._idle = not trim
        self._added_deg = self._nothing

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
            wanted = self._wanted[VISEME_OF[phoneme]]
            self._added_deg = self._added_deg + self._share * (wanted - self._added_deg)
        return self._added_deg
