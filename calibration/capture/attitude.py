"""The attitude of a tracker, by the robot's own halves and motion, and readings turned back by it.

Yaw and roll follow from the lines that join each marker to its mirror image. Pitch follows from
motion: what raises or lowers lips does so along the height, and the jaw turns about a hinge behind
and above the lips. Neither depends on which way a joint is mounted, nor on the depth of a person's
face. What is within its own error is left as it was seen.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.capture.capture import Capture, outside_ladders
from calibration.capture.straight_lines import straight_lines
from calibration.joint_motion import DOWN, UP, joint_motion, words
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: Landmarks on the robot's right, and their mirror images.
_MIRRORED = {
    61: 291, 39: 269, 37: 267, 181: 405, 84: 314, 98: 327, 172: 397, 136: 365, 149: 378, 176: 400,
    50: 280, 205: 425, 207: 427, 187: 411, 216: 436, 212: 432, 78: 308, 82: 312, 87: 317,
}  # fmt: skip
_MIDDLE, _LOWER_LIP = (13, 14), (405, 314, 17, 84, 181, 317, 14, 87)
_ON_JAW = ("jaw", "chin", "outer_lip_17", "inner_lip_14")
#: No face is quite its own mirror image: that of grid_s1 is 5 degrees off. A pitch is believed from
#: so many degrees and of its standard errors on: straight robots with 15 markers were up to 21 off.
_LEAST_DEG, _LEAST_PITCH_DEG, _LEAST_ERRORS = 8.0, 25.0, 3.0
#: Standard error of the pitch by lips that are raised: 6 on simulated robots of both families
#: (seeds 100 to 149).
_RAISED_ERROR_DEG = 6.0
#: Seen from the lips, the hinge lies so far above the level (Balkwill's angle), more or less, as a
#: designer likes it; what lies farther away is no hinge.
_HINGE_DEG, _HINGE_ERROR_DEG, _FARTHEST_MM = 26.0, 10.0, 200.0
_FEWEST_ON_JAW, _MOVED_MOST, _STILL_DEG = 6, 5, 0.1
_NO_TURN = Rotation.identity()


@dataclass(frozen=True, slots=True)
class Attitude:
    """How a tracker stands.

    turn: from its axes to the robot's, as far as that is beyond doubt; text: what is reported of
    it, empty where it is straight; is_pitched: a part of the turn is known by motion alone.
    """

    turn: Rotation = _NO_TURN
    text: str = ""
    is_pitched: bool = False

    def straightened(self, capture: Capture) -> Capture:
        """Return the capture in the robot's axes; the same one if the tracker stands straight."""
        if not self.text:
            return capture
        return replace(capture, markers_mm=capture.markers_mm @ self.turn.as_matrix().T)


def attitude_of(capture: Capture, positive: Sequence[str]) -> Attitude:
    """Return how the tracker of a capture stands against the robot.

    Parameters
    ----------
    capture : Capture
        Poses that move every joint.
    positive : Sequence[str]
        What a positive angle of each joint does; empty: nothing is known of the pitch.

    Returns
    -------
    Attitude
        Straight where no marker is seen with its mirror image.
    """
    row_of = {
        MARKERS_47.landmarks[MARKERS_47.names.index(name)]: row
        for row, name in enumerate(capture.marker_names)
        if name in MARKERS_47.names
    }
    usual_mm = np.nanmedian(capture.markers_mm, axis=0)
    pairs = [(row_of[r], row_of[n]) for r, n in _MIRRORED.items() if {r, n} <= row_of.keys()]
    if not pairs:
        return Attitude()
    across_mm = np.sum([usual_mm[left] - usual_mm[right] for right, left in pairs], axis=0)
    level = Rotation.align_vectors([[1.0, 0.0, 0.0]], [across_mm])[0]
    estimates = list(_pitches_deg(capture, positive, level, row_of)) if len(positive) else []
    pitches_deg, errors_deg = np.array(estimates or [(0.0, np.inf)]).T
    # Each estimate counts by its precision; without any, no pitch is believed.
    precision = errors_deg**-2.0
    error_deg = float(precision.sum() ** -0.5) if estimates else np.inf
    pitch_deg = float(np.average(pitches_deg, weights=precision if estimates else None))
    is_off_side = np.rad2deg(level.magnitude()) > _LEAST_DEG
    is_pitched = abs(pitch_deg) > max(_LEAST_PITCH_DEG, _LEAST_ERRORS * error_deg)
    if not is_off_side and not is_pitched:
        return Attitude()
    yaw_deg, roll_deg = np.rad2deg(np.arctan2([-across_mm[2], across_mm[1]], across_mm[0]))
    pitch_text = f"{pitch_deg:.0f} (to {error_deg:.0f})" if estimates else "unknown"
    text = f"yaw {yaw_deg:.0f}, roll {roll_deg:.0f} (each to 5), pitch {pitch_text} deg"
    unpitched = Rotation.from_euler("x", -pitch_deg * is_pitched, degrees=True)
    return Attitude(
        turn=unpitched * (level if is_off_side else _NO_TURN),
        text=f"the tracker stands askew: {text}",
        is_pitched=is_pitched,
    )


def _pitches_deg(
    capture: Capture, positive: Sequence[str], level: Rotation, row_of: Mapping[int, int]
) -> Iterator[tuple[float, float]]:
    """Yield estimates of the tracker's pitch and their standard errors, in degrees.

    level: lays the line from the robot's right to its left along x; row_of: rows of the markers, by
    landmark.
    """
    capture = outside_ladders(capture)
    lines = straight_lines(capture)
    slopes_mm = lines.slopes_mm @ level.as_matrix().T
    joints = list(zip(capture.servo_names, positive, strict=True))
    motions = [joint_motion(name, word) for name, word in joints]
    jaws = [joint for joint, motion in enumerate(motions) if motion and motion.channel == "jaw"]
    turn_rad = 0.0
    rows = [row for row, name in enumerate(capture.marker_names) if name.startswith(_ON_JAW)]
    if jaws and len(rows) >= _FEWEST_ON_JAW and set(_MIDDLE) <= row_of.keys():
        is_neutral = (np.abs(capture.goals_deg) < _STILL_DEG).all(axis=1)
        usual_mm, neutral_mm = (
            level.apply(np.nanmedian(capture.markers_mm[poses], axis=0))
            for poses in (slice(None), is_neutral if is_neutral.any() else slice(None))
        )
        range_rad, *hinge_mm = _hinge(usual_mm[rows], slopes_mm[jaws[0], rows])
        lips_mm = neutral_mm[[row_of[landmark] for landmark in _MIDDLE]].mean(axis=0)
        up_mm, forward_mm = hinge_mm - lips_mm[1:]
        if np.hypot(up_mm, forward_mm) < _FARTHEST_MM:
            angle_deg = float(np.rad2deg(np.arctan2(up_mm, -forward_mm)))
            # A dead jaw has its hinge anywhere.
            way_mm = np.sqrt(np.mean(np.sum(slopes_mm[jaws[0], rows] ** 2, axis=1)))
            noise_deg = np.rad2deg(lines.chance_mm[jaws[0]] / way_mm)
            yield angle_deg - _HINGE_DEG, float(np.hypot(_HINGE_ERROR_DEG, noise_deg))
            angles_deg = capture.goals_deg[:, jaws[0]]
            turn_rad = range_rad * angles_deg.mean() / np.ptp(angles_deg)
    # What hangs on the jaw was seen turned with it.
    lower = [row_of[n] for n in _LOWER_LIP if n in row_of]
    slopes_mm[:, lower] = slopes_mm[:, lower] @ Rotation.from_euler("x", turn_rad).as_matrix()
    lips = np.array([row for row, name in enumerate(capture.marker_names) if "lip" in name])
    raised, noise_mm = np.zeros((2, 2)), 0.0
    for joint, (_, word) in enumerate(joints):
        if joint not in jaws and words(word) & (UP | DOWN):
            sizes_mm = np.linalg.norm(slopes_mm[joint, lips], axis=1)
            along_mm = slopes_mm[joint, lips[np.argsort(sizes_mm)[-_MOVED_MOST:]], 1:].mean(axis=0)
            raised += np.outer(along_mm, along_mm)
            noise_mm = max(noise_mm, float(lines.chance_mm[joint]))
    if raised.any():
        # The line along which lips are raised most, whichever way each of them goes.
        sizes_mm2, axes = np.linalg.eigh(raised)
        y, z = axes[:, 1] * np.sign(axes[0, 1])
        noise_deg = np.rad2deg(noise_mm / np.sqrt(sizes_mm2[1]))
        yield float(np.rad2deg(np.arctan2(z, y))), float(np.hypot(_RAISED_ERROR_DEG, noise_deg))


def _hinge(places_mm: Array, slopes_mm: Array) -> Array:
    """Return how far points turn about x, in rad, and height and depth, mm, of their hinge.

    places_mm, slopes_mm: (n, 3), of the points and their motion. A turn by w about a hinge
    (h_y, h_z) moves a point by w (h_z - z, y - h_y): linear in w, w h_y and w h_z.
    """
    none, one = np.zeros(len(places_mm)), np.ones(len(places_mm))
    along_y, along_z = (-places_mm[:, 2], none, one), (places_mm[:, 1], -one, none)
    inputs = np.vstack([np.stack(along_y, axis=1), np.stack(along_z, axis=1)])
    turn, *at = np.linalg.lstsq(inputs, slopes_mm[:, 1:].T.ravel(), rcond=None)[0]
    return np.array([turn, *(np.array(at) / turn)])


def turned_like(markers_mm: Array, wanted_mm: Array) -> Array:
    """Return markers turned as the wanted ones stand, where they are far from that.

    Parameters
    ----------
    markers_mm,wanted_mm : Array
        (n, n_markers, 3) mm, NaN where lost.

    Returns
    -------
    Array
        (n, n_markers, 3) mm; unchanged where the best turn is small.
    """
    is_seen = np.isfinite(markers_mm + wanted_mm).all(axis=2)
    if not is_seen.any():
        return markers_mm
    given_mm, like_mm = markers_mm[is_seen], wanted_mm[is_seen]
    is_near = np.ones(len(given_mm), dtype=bool)
    for middle in (np.median, np.mean, np.mean):  # readings that are wildly off turn nothing
        from_mm, to_mm = (middle(each[is_near], axis=0) for each in (given_mm, like_mm))
        best = Rotation.align_vectors((like_mm - to_mm)[is_near], (given_mm - from_mm)[is_near])[0]
        off_mm = np.linalg.norm(like_mm - to_mm - best.apply(given_mm - from_mm), axis=1)
        is_near = off_mm <= 6.0 * np.median(off_mm)
    if np.rad2deg(best.magnitude()) < _LEAST_DEG:
        return markers_mm
    return np.asarray((markers_mm - from_mm) @ best.as_matrix().T + to_mm)
