"""What can be wrong with a capture, found before it becomes a calibration, and named.

A joint that moves nothing or the wrong way, markers that swapped names, points that the tracker
lost, poses that did not get there.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture import Capture
from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.markers import MARKERS_47

#: A joint is dead if it moves all markers together by no more than chance would: chance gives a
#: ratio of 1 to 1.2, the joints of simulated robots (seeds 100 to 103) 4 and more.
_DEAD_RATIO = 2.0
#: Rounds of filling in lost points; each brings them some ten times closer.
_FILLING_ROUNDS = 3
#: A marker seen in fewer poses than this share of them is not worth keeping.
_LEAST_SEEN = 0.5
#: Swapped names must explain this part of what a pose leaves unexplained, and at least so much:
#: two markers 3 mm apart that change places are 3 mm off each, six times the noise.
_SWAP_SHARE, _SWAP_MM = 0.6, 3.0

#: Two dots that touch are farther apart than this, by their own noise alone.
_SAME_DOT_MM = 0.05

#: Which way the lips go for the words that face YAMLs use: markers, axis, sign.
_UPPER, _LOWER = ("outer_lip_0", "inner_lip_13"), ("outer_lip_17", "inner_lip_14")
_RIGHT, _LEFT = "outer_lip_61", "outer_lip_291"


def least_poses_to_fit(n_servos: int) -> int:
    """A straight line for each joint and one constant need n + 1 poses; half as many again."""
    return round(1.5 * (n_servos + 1))


def check_capture(
    capture: Capture, model: FaceModel, positive: Sequence[str] = ()
) -> tuple[str, ...]:
    """Warnings, one line each: stalled poses, lost points.

    What makes a calibration worthless raises CalibrationError and is named: too few poses, a dead
    or reversed joint, swapped markers, a marker hardly ever seen. positive: the word of the face
    YAML for each joint, where reversed joints shall be found.
    """
    least = least_poses_to_fit(len(capture.servo_names))
    if len(capture) < least:
        why = f"; left out: {capture.stalled[0]}" if capture.stalled else ""
        raise CalibrationError(
            f"{len(capture)} poses are too few for {len(capture.servo_names)} servos, "
            f"{least} are needed{why}"
        )
    lost = _lost_points(capture)
    _check_doubles(capture)
    _check_swapped_everywhere(capture, model)
    slopes, chance_mm, expected_mm = _straight_lines(capture)
    _check_swapped_in_poses(capture, expected_mm)
    for joint, name in enumerate(capture.servo_names):
        _check_alive(capture, slopes[joint], chance_mm[joint], joint)
        if positive:
            _check_direction(capture, slopes[joint], name, positive[joint])
    return (*capture.stalled, *lost)


def _lost_points(capture: Capture) -> tuple[str, ...]:
    seen = np.isfinite(capture.markers_mm).all(axis=2).mean(axis=0)
    worst = int(seen.argmin())
    name = capture.marker_names[worst]
    if seen[worst] < _LEAST_SEEN:
        raise CalibrationError(
            f"marker {name!r} was seen in {seen[worst]:.0%} of the poses; "
            "fix or hide that dot, or leave the marker out, and capture again"
        )
    n_lost = int((~np.isfinite(capture.markers_mm).all(axis=2)).sum())
    if not n_lost:
        return ()
    return (f"{n_lost} points were lost by the tracker, most often {name} ({1 - seen[worst]:.0%})",)


def _check_doubles(capture: Capture) -> None:
    """One dot under two names: nobody else is in the same place in every pose."""
    for a, b in combinations(range(len(capture.marker_names)), 2):
        apart_mm = np.linalg.norm(capture.markers_mm[:, a] - capture.markers_mm[:, b], axis=1)
        if np.nanmax(apart_mm, initial=0.0) < _SAME_DOT_MM:
            names = capture.marker_names
            raise CalibrationError(
                f"markers {names[a]!r} and {names[b]!r} are the same point in every pose; "
                "name them anew in the tracker and capture again"
            )


def _straight_lines(capture: Capture) -> tuple[Array, Array, Array]:
    """Slopes (n_servos, n_markers, 3) in mm over a joint's captured range, and where they lead.

    Between the two, (n_servos,), the rms in each axis that noise alone would give the slopes. What
    they lead to is shaped as captured. Lost points count as where these lines lead.
    """
    low, high = capture.goals_deg.min(axis=0), capture.goals_deg.max(axis=0)
    inputs = (capture.goals_deg - low) / np.maximum(high - low, 1e-6)
    inputs = np.hstack([inputs, np.ones((len(inputs), 1))])
    usual_mm = np.nanmedian(capture.markers_mm, axis=0)
    expected_mm = np.broadcast_to(usual_mm, capture.markers_mm.shape)
    for _ in range(_FILLING_ROUNDS):
        seen = np.where(np.isfinite(capture.markers_mm), capture.markers_mm, expected_mm)
        fit = np.linalg.lstsq(inputs, seen.reshape(len(inputs), -1), rcond=None)[0]
        expected_mm = (inputs @ fit).reshape(seen.shape)
    noise_mm2 = np.sum((seen - expected_mm) ** 2) / (seen[0].size * (len(seen) - inputs.shape[1]))
    chance_mm = np.sqrt(noise_mm2 * np.diag(np.linalg.pinv(inputs.T @ inputs))[:-1])
    return fit[:-1].reshape(-1, *usual_mm.shape), chance_mm, expected_mm


def _check_alive(capture: Capture, slope_mm: Array, chance_mm: float, joint: int) -> None:
    if np.mean(slope_mm**2) < _DEAD_RATIO * chance_mm**2:
        raise CalibrationError(
            f"servo {capture.servo_names[joint]!r} moves no marker by more than chance; "
            "check its horn, its linkage and its limits"
        )


def _check_direction(capture: Capture, slope_mm: Array, name: str, word: str) -> None:
    """slope_mm: (n_markers, 3), what growing angles do."""
    wanted = _wanted_direction(capture.marker_names, name, word)
    if wanted is None:
        return
    along_mm = float((slope_mm * wanted).sum())
    if along_mm < 0.0:
        raise CalibrationError(
            f"servo {name!r} is reversed: a positive angle should {_bare(word)}, and does the "
            "opposite; change its `sign` in the face YAML"
        )


def _wanted_direction(names: tuple[str, ...], servo: str, word: str) -> Array | None:
    """(n_markers, 3), or None for a word that says nothing of markers."""
    lips = [i for i, name in enumerate(names) if name in MARKERS_47.names and "lip" in name]
    wanted = np.zeros((len(names), 3))
    if word == "opens":
        rides = [i for i, n in enumerate(names) if n in _LOWER or n.startswith(("jaw", "chin"))]
        wanted[rides, 1] = -1.0
    elif word in ("raises", "lowers"):
        wanted[lips, 1] = 1.0 if word == "raises" else -1.0
    elif word in ("widens", "narrows"):
        sign = 1.0 if word == "widens" else -1.0
        if not servo.startswith(("corner_right", "right")) and _LEFT in names:
            wanted[names.index(_LEFT), 0] = sign
        if not servo.startswith(("corner_left", "left")) and _RIGHT in names:
            wanted[names.index(_RIGHT), 0] = -sign
    elif word == "protrudes":
        wanted[lips, 2] = 1.0
    else:
        return None
    return wanted


def _bare(word: str) -> str:
    """`opens` -> `open`."""
    return word[:-1] if word.endswith("s") else word


def _check_swapped_everywhere(capture: Capture, model: FaceModel) -> None:
    """Two names exchanged throughout: the robot's neutral looks more like a face the other way.

    Compared with the speaker's rest after moving and scaling one onto the other, axis by axis.
    """
    human_mm = model.markers_mm(model.rest[None])[0]
    known = [i for i, name in enumerate(capture.marker_names) if name in MARKERS_47.names]
    human_mm = human_mm[[MARKERS_47.names.index(capture.marker_names[i]) for i in known]]
    robot_mm = np.nanmedian(capture.markers_mm, axis=0)[known]

    def like(points_mm: Array) -> Array:
        """Standardised in each axis."""
        centred = points_mm - np.median(points_mm, axis=0)
        return np.asarray(centred / np.maximum(np.median(np.abs(centred), axis=0), 1e-6))

    apart = like(robot_mm) - like(human_mm)
    size_mm = np.median(np.abs(robot_mm - np.median(robot_mm, axis=0)), axis=0)
    _refuse_swap(capture, known, apart * size_mm, robot_mm, "in every pose")


def _check_swapped_in_poses(capture: Capture, expected_mm: Array) -> None:
    everything = list(range(len(capture.marker_names)))
    for pose, (seen_mm, wanted_mm) in enumerate(zip(capture.markers_mm, expected_mm, strict=True)):
        filled_mm = np.where(np.isfinite(seen_mm), seen_mm, wanted_mm)
        where = f"in pose {pose + 1}"
        _refuse_swap(capture, everything, filled_mm - wanted_mm, filled_mm, where)


def _refuse_swap(
    capture: Capture, known: list[int], off_mm: Array, points_mm: Array, where: str
) -> None:
    """off_mm: (n, 3), how far each point is from where its name belongs."""
    far = [i for i in range(len(off_mm)) if np.linalg.norm(off_mm[i]) > _SWAP_MM]
    for a, b in combinations(far, 2):
        as_named = np.linalg.norm(off_mm[a]) ** 2 + np.linalg.norm(off_mm[b]) ** 2
        change_mm = points_mm[b] - points_mm[a]
        swapped = (
            np.linalg.norm(off_mm[a] + change_mm) ** 2 + np.linalg.norm(off_mm[b] - change_mm) ** 2
        )
        if swapped < (1.0 - _SWAP_SHARE) * as_named:
            names = capture.marker_names
            raise CalibrationError(
                f"markers {names[known[a]]!r} and {names[known[b]]!r} have changed places {where}; "
                "name them the other way round in the tracker and capture again"
            )
