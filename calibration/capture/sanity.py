"""Checks of a capture before it becomes a calibration, with a message for each fault.

Faults are markers that are not in millimetres, x to the robot's left, y up, z forward, or that
swapped names; a joint that moves nothing or is reversed; points that the tracker lost; poses that
did not reach their goals. Axes are compared with the speaker's closed mouth under every exchange
and reversal: a robot is another face, but its nose is above its chin and its left is not its right.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations, product

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture import Capture, outside_ladders
from calibration.capture.joint_health import (
    SUSPECTED,
    WEAK,
    JointFault,
    alive,
    is_dead,
    joint_fault,
    moved_alone_mm,
)
from calibration.capture.repeated_poses import FaceChange, bears_out, changed_poses, face_change
from calibration.capture.straight_lines import (
    StraightLines,
    in_head_frame,
    straight_lines,
    without_far_points,
)
from calibration.capture.swaps import (
    described_swaps,
    exchanged,
    refuse_swaps,
    swapped_everywhere,
    swapped_in_poses,
)
from calibration.joint_motion import Channel, joint_motion
from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.markers import MARKERS_47

#: With fewer markers several ways round look alike.
_LEAST_MARKERS = 8
#: Another way round must be so much more like a face, and a face it must be.
_BETTER, _A_FACE = 0.1, 0.85
#: Faces of robots are from three fifths to one and a half times a person's; others are units.
_SIZES = (0.62, 1.6)
#: Nothing is seen along an axis on which the markers are as flat as this.
_FLAT_MM = 1e-6
_AXES = ("x", "y", "z")
_NAMES: dict[tuple[int, ...], str] = {
    (-1, 1, 1): "are mirrored: x should grow to the robot's own left",
    (1, -1, 1): "are upside down: y should grow upwards",
    (1, 1, -1): "are turned back to front: z should grow forwards",
    (-1, -1, 1): "are turned by half a turn: x should grow to the robot's left and y upwards",
    (-1, 1, -1): "are seen from behind: x should grow to the robot's left and z forwards",
    (1, -1, -1): "are upside down and back to front: y should grow upwards and z forwards",
}


def frame_faults(
    marker_names: tuple[str, ...], usual_mm: Array, model: FaceModel
) -> tuple[str | None, str | None]:
    """Return one message about wrong axes and one about an odd size of the markers, or None.

    Parameters
    ----------
    marker_names : tuple[str, ...]
        n_markers.
    usual_mm : Array
        (n_markers, 3) mm, the usual position of each.
    model : FaceModel
        A person's face in mm.

    Returns
    -------
    tuple[str | None, str | None]
        Message about the axes and about the size, None where right or unknown.
    """
    known = [i for i, name in enumerate(marker_names) if name in MARKERS_47.names]
    known = [i for i in known if np.isfinite(usual_mm[i]).all()]
    if len(known) < _LEAST_MARKERS:
        return None, None
    rest_mm = model.markers_mm(model.rest[None])[0]
    human = rest_mm[[MARKERS_47.names.index(marker_names[i]) for i in known]]
    human, robot = human - human.mean(axis=0), usual_mm[known] - usual_mm[known].mean(axis=0)
    flat = bool(np.ptp(robot[:, 2]) < _FLAT_MM)
    n = 2 if flat else 3
    robot, human = robot[:, :n], human[:, :n]
    upright = _likeness(robot, human)
    best, order, signs = max(
        (_likeness(robot, human[:, order] * signs), order, signs)
        for order in permutations(range(n))
        for signs in product((1, -1), repeat=n)
    )
    size = float(np.linalg.norm(robot) / np.linalg.norm(human))
    axes = None
    if best > upright + _BETTER and best > _A_FACE:
        full = (*signs, 1)[:3]
        if size > _SIZES[1] and order[:2] == (0, 1) and full[:2] == (1, -1):
            axes = (
                "the markers look like pixels of a picture (y grows downwards, the mouth is "
                f"{size:.1f} times a person's): give millimetres, y upwards"
            )
        elif order == tuple(range(n)):
            axes = f"the markers {_NAMES.get(full, 'are turned round on all three axes')}"
        else:
            given = ", ".join(
                f"{_AXES[k]} is {'-' if signs[k] < 0 else ''}{_AXES[order[k]]}" for k in range(n)
            )
            axes = f"the markers' axes are exchanged ({given}): x left, y up, z forward"
    elif flat and size > _SIZES[1]:
        axes = f"the markers look like pixels of a picture ({size:.1f} times a person's face)"
    if axes is not None or _SIZES[0] <= size <= _SIZES[1]:
        return axes, None
    return None, (
        f"the scale is odd: the face is {size:.2f} times as large as a person's; are the markers "
        "in millimetres?"
    )


def is_flat(capture: Capture) -> bool:
    """Return whether no marker ever moves forward or back, so that depth was not measured."""
    depths_mm = capture.markers_mm[..., 2]
    return bool((np.nanmax(depths_mm, axis=0) - np.nanmin(depths_mm, axis=0) < _FLAT_MM).all())


def check_frame(
    marker_names: tuple[str, ...], usual_mm: Array, model: FaceModel, *, accept: bool
) -> tuple[str, ...]:
    """Check the axes and the size of a capture's usual markers against a person's face.

    Parameters
    ----------
    marker_names : tuple[str, ...]
        n_markers.
    usual_mm : Array
        (n_markers, 3) mm, the usual position of each.
    model : FaceModel
        A person's face in mm.
    accept : bool
        Whether an odd size is only a warning.

    Returns
    -------
    tuple[str, ...]
        Warning about the size, or empty.

    Raises
    ------
    CalibrationError
        Wrong axes, or an odd size that is not accepted.
    """
    axes, size = frame_faults(marker_names, usual_mm, model)
    if axes is not None:
        raise CalibrationError(f"{axes}; correct the tracker's axes and capture again")
    if size is not None and not accept:
        raise CalibrationError(f"{size} If the robot is that large, add --accept")
    return () if size is None else (size,)


def _likeness(robot: Array, human: Array) -> float:
    """Return the cosine between two shapes, (n, 2 or 3) each about its mean, at most 1.

    It is 1 for shapes that are equal up to their size; none is rotated before.
    """
    return float((robot * human).sum() / (np.linalg.norm(robot) * np.linalg.norm(human) + 1e-12))


#: A joint is reversed where most of what it does goes the wrong way, by so many standard errors.
_REVERSED_SHARE, _REVERSED_ERRORS = 0.5, 5.0
_MOVED_MOST = 5
#: A marker seen in fewer poses than this share of them is not worth keeping.
_LEAST_SEEN = 0.5
#: A joint that is moved less than this was not moved.
_LEAST_RANGE_DEG = 0.5
#: Two dots that touch are farther apart than this, by their own noise alone.
_SAME_DOT_MM = 0.05

#: Which way the lips go for the words that face YAMLs use: markers, axis, sign.
_LOWER = ("outer_lip_17", "inner_lip_14")
_RIGHT, _LEFT = "outer_lip_61", "outer_lip_291"


def least_poses_to_fit(n_servos: int) -> int:
    """Return the fewest poses of a fit: 1.5 for each parameter of a line over n_servos joints."""
    return round(1.5 * (n_servos + 1))


@dataclass(frozen=True, slots=True)
class CheckedCapture:
    """A capture without its wrong readings, and warnings about it.

    still: numbers of joints that move no marker visibly, which is accepted; they stay at 0.
    """

    capture: Capture
    warnings: tuple[str, ...]
    still: tuple[int, ...] = ()


def check_capture(
    capture: Capture, model: FaceModel, positive: Sequence[str] = (), *, accept: bool = False
) -> CheckedCapture:
    """Return the capture without wrong readings, with a warning each for lesser faults.

    Warnings are about stalled poses, lost points, outliers and weak joints. Raises CalibrationError
    for what makes a calibration worthless: wrong axes or units, too few poses, swapped markers, a
    marker hardly ever seen, a dead, reversed, stopped or slipped joint.
    positive: what a positive angle of each joint does, from the face's YAML; empty: reversed joints
    are not found. accept: doubts about size, swaps and joints become warnings.
    """
    least = least_poses_to_fit(len(capture.servo_names))
    if len(capture) < least:
        why = f"; left out: {capture.stalled[0]}" if capture.stalled else ""
        raise CalibrationError(
            f"{len(capture)} poses are too few for {len(capture.servo_names)} servos, "
            f"{least} are needed{why}"
        )
    _check_range(capture)
    stalled = capture.stalled
    lost = _lost_points(capture)
    _check_doubles(capture)
    usual_mm = np.nanmedian(capture.markers_mm, axis=0)
    sizes = check_frame(capture.marker_names, usual_mm, model, accept=accept)
    everywhere = swapped_everywhere(capture, model)
    lines = straight_lines(capture)
    capture, moved = in_head_frame(capture, lines)
    lines = straight_lines(capture) if moved else lines
    swaps = swapped_in_poses(capture, lines.expected_mm)
    refuse_swaps([*everywhere, *(() if accept else swaps)])
    renamed: tuple[str, ...] = ()
    if swaps:
        capture = replace(capture, markers_mm=exchanged(capture, swaps))
        lines = straight_lines(capture)
        renamed = (f"markers {described_swaps(swaps)}: exchanged there",)
    capture, far = without_far_points(capture, lines)
    # Lips that press each other are no fault of a joint.
    conditions = outside_ladders(capture)
    joints = _joint_warnings(conditions, straight_lines(conditions), positive)
    if joints.certain and not accept:
        raise CalibrationError(f"{joints.certain[0]}. If it is as it should be, add --accept")
    all_faults = (*joints.certain, *joints.doubtful)
    warnings = (*stalled, *lost, *sizes, *moved, *renamed, *far, *all_faults)
    return CheckedCapture(capture, warnings, tuple(joints.still))


def _check_range(capture: Capture) -> None:
    """Raise CalibrationError for a joint that no captured pose moves; it cannot be learnt."""
    still = np.ptp(capture.goals_deg, axis=0) < _LEAST_RANGE_DEG
    if still.any():
        name = capture.servo_names[int(still.argmax())]
        raise CalibrationError(
            f"the captured poses never move servo {name!r}; were markers recorded for all poses?"
        )


@dataclass(slots=True)
class _JointFindings:
    """Messages about faulty joints, by how sure the fault is.

    certain: faults that are errors unless the user accepts them; doubtful: warnings; still: the
    numbers of dead joints.
    """

    certain: list[str] = field(default_factory=list)
    doubtful: list[str] = field(default_factory=list)
    still: list[int] = field(default_factory=list)


def _joint_warnings(
    capture: Capture, lines: StraightLines, positive: Sequence[str]
) -> _JointFindings:
    """Return the faults of joints: stopped, slipped, dead, reversed or weak.

    positive: one word per joint for its positive angle, or empty. Poses that were captured twice
    are preferred as evidence of what happened during the capture.
    """
    found = _JointFindings()
    changed = changed_poses(capture, lines)
    fault: JointFault | FaceChange | None
    if changed is None:
        fault = joint_fault(capture, lines)
    else:
        fault = face_change(changed)
        suspected = joint_fault(capture, lines, SUSPECTED)
        if suspected is not None and bears_out(changed, suspected):
            # It knows at which pose, and a joint that stands still from one that slipped.
            fault = suspected if fault is None or fault.joint == suspected.joint else fault
    if fault is not None:
        description = fault.description(capture.servo_names)
        (found.certain if fault.joint >= 0 else found.doubtful).append(description)
    n_servos = len(capture.servo_names)
    found.still += [joint for joint in range(n_servos) if is_dead(capture, lines, joint)]
    # Where something happened on the way, what joints seem to do is not what they do.
    conditions = capture.servo_names if fault is None else ()
    for joint, name in enumerate(conditions):
        word = positive[joint] if positive else ""
        if joint in found.still and positive and not word:
            found.doubtful.append(
                f"servo {name!r} moves the lips forward, which is not seen here: it stays at 0"
            )
        elif joint in found.still:
            found.certain.append(
                f"servo {name!r} moves no marker by more than chance, so speech would not move it; "
                "check its horn, linkage and limits, look again (`plan --refine`), or give it "
                "`part: other`"
            )
        elif word and _is_reversed(capture, lines, joint, _usual_word(name, word)):
            found.certain.append(
                f"servo {name!r} is reversed: a positive angle should {_bare(word)}, "
                "and does the opposite; change its `sign` in the face YAML"
            )
        elif alive(lines, joint) < WEAK:
            found.doubtful.append(
                f"servo {name!r} is weak or dead: it moves the markers little above chance"
            )
    return found


def _is_reversed(capture: Capture, lines: StraightLines, joint: int, word: str) -> bool:
    """Return whether a joint's positive angle does the opposite of `word`, such as `opens`.

    The fitted lines must show it in the markers that the joint moves most and, where the joint was
    captured alone, its motion then: lines of many joints are not quite straight.
    """
    slope_mm = lines.slopes_mm[joint]
    wanted = _wanted_direction(capture.marker_names, slope_mm, word)
    if wanted is None:
        return False
    spoken_of = np.flatnonzero(np.abs(wanted).sum(axis=1))
    if not len(spoken_of):
        return False
    sizes = np.linalg.norm(slope_mm[spoken_of], axis=1)
    most = spoken_of[np.argsort(sizes)[-_MOVED_MOST:]]
    along_mm = float((slope_mm[most] * wanted[most]).sum())
    all_mm = float(np.linalg.norm(slope_mm[most], axis=1).sum())
    if np.nansum(moved_alone_mm(capture, joint)[most] * wanted[most]) > 0.0:
        return False
    error_mm = float(lines.chance_mm[joint] * np.sqrt(len(most)))
    return along_mm < -_REVERSED_SHARE * all_mm and along_mm < -_REVERSED_ERRORS * error_mm


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
    """Raise CalibrationError for two markers at one position in every pose: one dot, two names."""
    for a, b in combinations(range(len(capture.marker_names)), 2):
        apart_mm = np.linalg.norm(capture.markers_mm[:, a] - capture.markers_mm[:, b], axis=1)
        if np.nanmax(apart_mm, initial=0.0) < _SAME_DOT_MM:
            names = capture.marker_names
            raise CalibrationError(
                f"markers {names[a]!r} and {names[b]!r} are the same point in every pose; "
                "name them anew in the tracker and capture again"
            )


def _wanted_direction(names: tuple[str, ...], slope_mm: Array, word: str) -> Array | None:
    """Return the direction in which `word` moves each marker, (n_markers, 3); None: unknown word.

    slope_mm: (n_markers, 3), the joint's measured effect: of the mouth's corners only those count
    that it moves, because words contain no side.
    """
    lips = [i for i, name in enumerate(names) if name in MARKERS_47.names and "lip" in name]
    wanted = np.zeros((len(names), 3))
    if word in ("opens", "closes"):
        rides = [i for i, n in enumerate(names) if n in _LOWER or n.startswith(("jaw", "chin"))]
        wanted[rides, 1] = -1.0 if word == "opens" else 1.0
    elif word in ("raises", "lowers"):
        wanted[lips, 1] = 1.0 if word == "raises" else -1.0
    elif word in ("widens", "narrows"):
        sign = 1.0 if word == "widens" else -1.0
        corners = [
            (names.index(n), side) for n, side in ((_LEFT, 1.0), (_RIGHT, -1.0)) if n in names
        ]
        moved_mm = [float(np.linalg.norm(slope_mm[i])) for i, _ in corners]
        for (corner, side), by_mm in zip(corners, moved_mm, strict=True):
            if by_mm > 0.5 * max(moved_mm):
                wanted[corner, 0] = sign * side
    elif word in ("protrudes", "retracts"):
        wanted[lips, 2] = 1.0 if word == "protrudes" else -1.0
    else:
        return None
    return wanted


#: What a joint does in a channel's forward direction, and in its backward one.
_WORDS: Mapping[Channel, tuple[str, str]] = {
    "jaw": ("opens", "closes"),
    "upper_lip": ("raises", "lowers"),
    "lower_lip": ("lowers", "raises"),
    "corner_out": ("widens", "narrows"),
    "corner_up": ("raises", "lowers"),
    "protrusion": ("protrudes", "retracts"),
}


def _usual_word(name: str, word: str) -> str:
    """Return `word` as one of the known verbs, by the joint's name: `opens` for a jaw that `drops`.

    A word that the name does not explain is returned unchanged.
    """
    if any(word in pair for pair in _WORDS.values()):
        return word
    motion = joint_motion(name, word)
    return word if motion is None else _WORDS[motion.channel][0 if motion.sign > 0 else 1]


def _bare(word: str) -> str:
    """Return the verb `word` without its s, for messages: `opens` to `open`."""
    return word[:-1] if word.endswith("s") else word
