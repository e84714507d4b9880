"""Checks of a capture before it becomes a calibration, with a message for each fault.

Faults are markers that are not in millimetres, x to the robot's left, y up, z forward, or that
swapped names; a joint that moves nothing or is reversed; points that the tracker lost; poses that
did not reach their goals. Axes are compared with the speaker's closed mouth under every exchange
and reversal: a robot is another face, but its nose is above its chin and its left is not its right.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations, product

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.attitude import attitude_of
from calibration.capture.capture import Capture, outside_ladders
from calibration.capture.joint_health import (
    SUSPECTED,
    WEAK,
    JointFault,
    is_dead,
    joint_fault,
    joint_signal,
    moved_alone_mm,
)
from calibration.capture.repeated_poses import FaceChange, changed_poses, confirms, face_change
from calibration.capture.straight_lines import (
    StraightLines,
    in_head_frame,
    straight_lines,
    without_far_points,
)
from calibration.capture.swaps import (
    described_swaps,
    exchanged,
    swapped_everywhere,
    swapped_in_poses,
    swaps_refused,
)
from calibration.joint_motion import Channel, joint_motion
from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.markers import MARKERS_47


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check found: a warning, and the refusal of the capture, if any, with its remedy.

    is_judgement: with --accept it is a warning only.
    """

    warning: str
    refusal: str = ""
    is_judgement: bool = False


#: With fewer markers several ways round look alike.
_LEAST_MARKERS = 8
#: Another way round must be so much more like a face, and a face it must be.
_LEAD, _LEAST_LIKENESS = 0.1, 0.85
#: Faces of robots are from three fifths to one and a half times a person's; others are units.
_SIZES = (0.62, 1.6)
#: Nothing is seen along an axis on which the markers are as flat as this.
_FLAT_MM = 1e-6
_AXES = ("x", "y", "z")
_REVERSALS: dict[tuple[int, ...], str] = {
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
        Names of the n_markers markers.
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
    # Without depth, x and y alone. The best of all exchanges and reversals of the person's axes is
    # compared with the axes as they are.
    as_given = _likeness(robot, human)
    best, order, signs = max(
        (_likeness(robot, human[:, order] * signs), order, signs)
        for order in permutations(range(n))
        for signs in product((1, -1), repeat=n)
    )
    ratio = float(np.linalg.norm(robot) / np.linalg.norm(human))
    fault = None
    if best > as_given + _LEAD and best > _LEAST_LIKENESS:
        all_signs = (*signs, 1)[:3]
        if ratio > _SIZES[1] and order[:2] == (0, 1) and all_signs[:2] == (1, -1):
            fault = (
                "the markers look like pixels of a picture (y grows downwards, the mouth is "
                f"{ratio:.1f} times a person's): give millimetres, y upwards"
            )
        elif order == tuple(range(n)):
            fault = f"the markers {_REVERSALS.get(all_signs, 'are turned round on all three axes')}"
        else:
            given = ", ".join(
                f"{_AXES[k]} is {'-' if signs[k] < 0 else ''}{_AXES[order[k]]}" for k in range(n)
            )
            fault = f"the markers' axes are exchanged ({given}): x left, y up, z forward"
    elif flat and ratio > _SIZES[1]:
        fault = f"the markers look like pixels of a picture ({ratio:.1f} times a person's face)"
    if fault is not None or _SIZES[0] <= ratio <= _SIZES[1]:
        return fault, None
    return None, (
        f"the scale is odd: the face is {ratio:.2f} times as large as a person's; are the markers "
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
        Names of the n_markers markers.
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


@dataclass(frozen=True, slots=True)
class CheckedCapture:
    """A capture without its wrong readings, and warnings about it.

    still: numbers of joints that move no marker visibly, which is accepted; they stay at 0.
    """

    capture: Capture
    warnings: tuple[str, ...]
    still: tuple[int, ...] = ()


@dataclass(slots=True)
class _Record:
    """A capture under the checks, each of which may take wrong readings from it.

    given: the capture before them; lines: through `capture` as it is now; positive: a word for each
    joint's positive angle, or empty; still: numbers of dead joints.
    """

    given: Capture
    model: FaceModel
    positive: Sequence[str]
    capture: Capture
    lines: StraightLines
    still: list[int] = field(default_factory=list)

    def correct(self, capture: Capture) -> None:
        """Go on with a corrected capture."""
        self.capture, self.lines = capture, straight_lines(capture)


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
    warnings = _warnings_of(finding for check in _FIRST_CHECKS for finding in check(capture))
    usual_mm = np.nanmedian(capture.markers_mm, axis=0)
    warnings += check_frame(capture.marker_names, usual_mm, model, accept=accept)
    record = _Record(capture, model, positive, capture, straight_lines(capture))
    for check in _CHECKS:
        warnings += _warnings_of(check(record), accept=accept)
    return CheckedCapture(record.capture, warnings, tuple(record.still))


def _warnings_of(findings: Iterable[Finding], *, accept: bool = False) -> tuple[str, ...]:
    """Return the warning of each finding. Raises CalibrationError for the first that refuses.

    accept: findings that are a judgement warn instead of refusing.
    """
    warnings = []
    for finding in findings:
        if finding.refusal and not (accept and finding.is_judgement):
            raise CalibrationError(finding.refusal)
        warnings.append(finding.warning)
    return tuple(warnings)


def _too_few(capture: Capture) -> Iterator[Finding]:
    # 1.5 for each parameter of a line over all joints.
    least = round(1.5 * (len(capture.servo_names) + 1))
    if len(capture) < least:
        why = f"; left out: {capture.stalled[0]}" if capture.stalled else ""
        few = f"{len(capture)} poses are too few for {len(capture.servo_names)} servos"
        yield Finding("", f"{few}, {least} are needed{why}")


def _never_moved(capture: Capture) -> Iterator[Finding]:
    for joint in np.flatnonzero(np.ptp(capture.goals_deg, axis=0) < _LEAST_RANGE_DEG):
        never = f"the captured poses never move servo {capture.servo_names[joint]!r}"
        yield Finding("", f"{never}; were markers recorded for all poses?")


def _stalled(capture: Capture) -> Iterator[Finding]:
    yield from map(Finding, capture.stalled)


def _lost_points(capture: Capture) -> Iterator[Finding]:
    """Yield a refusal for a marker lost in over half of the poses, else a warning of lost ones."""
    is_seen = np.isfinite(capture.markers_mm).all(axis=2)
    seen, n_lost = is_seen.mean(axis=0), int((~is_seen).sum())
    worst = int(seen.argmin())
    name = capture.marker_names[worst]
    if seen[worst] < _LEAST_SEEN:
        text = f"marker {name!r} was seen in {seen[worst]:.0%} of the poses; fix or hide that dot"
        yield Finding("", f"{text}, or leave the marker out, and capture again")
    elif n_lost:
        often = f"most often {name} ({1 - seen[worst]:.0%})"
        yield Finding(f"{n_lost} points were lost by the tracker, {often}")


def _same_points(capture: Capture) -> Iterator[Finding]:
    """Yield a refusal for two markers at one position in all poses that show both: one dot."""
    names = capture.marker_names
    for a, b in combinations(range(len(names)), 2):
        apart_mm = np.linalg.norm(capture.markers_mm[:, a] - capture.markers_mm[:, b], axis=1)
        if np.isfinite(apart_mm).any() and np.nanmax(apart_mm) < _SAME_DOT_MM:
            text = f"markers {names[a]!r} and {names[b]!r} are the same point in every pose"
            yield Finding("", f"{text}; name them anew in the tracker and capture again")


def _moved_head(record: _Record) -> Iterator[Finding]:
    capture, lines = in_head_frame(record.capture, record.lines)
    if lines:
        record.correct(capture)
    yield from map(Finding, lines)


def _tracker_askew(record: _Record) -> Iterator[Finding]:
    """Yield a warning of a tracker that stands askew, whose readings are turned back in `record`.

    A pitch, which motion alone tells and no better than to 5 degrees, is refused.
    """
    attitude = attitude_of(record.capture, record.positive)
    if attitude.text:
        record.given = attitude.straightened(record.given)
        record.correct(attitude.straightened(record.capture))
        level = "set it level with the mouth, looking straight at it, and capture again"
        refusal = f"{attitude.text}; {level}, or add --accept to have its readings turned back"
        warning = f"{attitude.text}; its readings are turned back"
        yield Finding(warning, refusal if attitude.is_pitched else "", is_judgement=True)


def _exchanged_names(record: _Record) -> Iterator[Finding]:
    """Yield refusals for pairs of markers that swapped names, in every pose or in single poses.

    Swaps in single poses are a judgement: if the refusal is accepted, the names are exchanged back
    in `record`.
    """
    everywhere = swapped_everywhere(record.given, record.model)
    in_poses = swapped_in_poses(record.capture, record.lines.expected_mm)
    if in_poses:
        text = f"markers {described_swaps(in_poses)}: exchanged there"
        yield Finding(text, swaps_refused([*everywhere, *in_poses]), is_judgement=True)
    if everywhere:
        yield Finding("", swaps_refused(everywhere))
    if in_poses:
        record.correct(replace(record.capture, markers_mm=exchanged(record.capture, in_poses)))


def _far_points(record: _Record) -> Iterator[Finding]:
    record.capture, lines = without_far_points(record.capture, record.lines)
    yield from map(Finding, lines)


def _faulty_joints(record: _Record) -> Iterator[Finding]:
    """Yield findings on joints that stopped, slipped, are dead, reversed or weak; refusals first.

    Refusals are judgements, of which `--accept` makes warnings. Dead joints are added to
    `record.still`. After a fault during the capture single joints are not examined.
    """
    # Without the poses that press lips together, which is no fault of a joint.
    capture, positive = outside_ladders(record.capture), record.positive
    lines = straight_lines(capture)
    fault = _fault_during_capture(capture, lines)
    remarks = []
    if fault is not None:
        remarks.append((fault.description(capture.servo_names), fault.joint >= 0))
    n_servos = len(capture.servo_names)
    record.still += [joint for joint in range(n_servos) if is_dead(capture, lines, joint)]
    # After a fault during the capture the fitted effects of joints are not to be trusted.
    for joint, name in enumerate(capture.servo_names if fault is None else ()):
        word = positive[joint] if positive else ""
        if joint in record.still and positive and not word:
            remarks.append(("moves the lips forward, which is not seen here: it stays at 0", False))
        elif joint in record.still:
            dead = (
                "moves no marker by more than chance, so speech would not move it; check its horn, "
                "linkage and limits, look again (`plan --refine`), or give it `part: other`"
            )
            remarks.append((dead, True))
        elif word and _is_reversed(capture, lines, joint, _known_word(name, word)):
            turned = (
                f"is reversed: a positive angle should {word.removesuffix('s')}, and does the "
                "opposite; change its `sign` (hobby servos: that of `us_per_deg`) in the face "
                "YAML, delete the poses captured so far and capture again"
            )
            remarks.append((turned, True))
        elif joint_signal(lines, joint) < WEAK:
            remarks.append(("is weak or dead: it moves the markers little above chance", False))
        else:
            continue
        # Each finding begins with the servo's name.
        remarks[-1] = (f"servo {name!r} {remarks[-1][0]}", remarks[-1][1])
    for text, refuses in sorted(remarks, key=lambda each: not each[1]):
        refusal = f"{text}. If it is as it should be, add --accept" if refuses else ""
        yield Finding(text, refusal, is_judgement=True)


def _fault_during_capture(capture: Capture, lines: StraightLines) -> JointFault | FaceChange | None:
    """Return the fault of a joint, or of the whole face, that arose during the capture, or None.

    Poses that were captured early and again late are preferred as evidence; where there are none,
    the whole capture is fitted with and without a fault.
    """
    changes = changed_poses(capture, lines)
    if changes is None:
        return joint_fault(capture, lines)
    change, suspected = face_change(changes), joint_fault(capture, lines, SUSPECTED)
    if suspected is None or not confirms(changes, suspected):
        return change
    # A confirmed fit says more: at which pose it was, and whether the joint stopped or slipped.
    return suspected if change is None or change.joint == suspected.joint else change


#: Every check in its order: of the capture as it was given, then of one that they correct.
_FIRST_CHECKS = (_too_few, _never_moved, _stalled, _lost_points, _same_points)
_CHECKS = (_moved_head, _tracker_askew, _exchanged_names, _far_points, _faulty_joints)


def _is_reversed(capture: Capture, lines: StraightLines, joint: int, word: str) -> bool:
    """Return whether a joint's positive angle does the opposite of `word`, such as `opens`.

    The fitted lines must show it in the markers that the joint moves most and, where the joint was
    captured alone, its motion then: lines of many joints are not quite straight.
    """
    slope_mm = lines.slopes_mm[joint]
    direction = _wanted_direction(capture.marker_names, slope_mm, word)
    if direction is None:
        return False
    directed = np.flatnonzero(np.abs(direction).sum(axis=1))
    if not len(directed):
        return False
    sizes_mm = np.linalg.norm(slope_mm[directed], axis=1)
    moved_most = directed[np.argsort(sizes_mm)[-_MOVED_MOST:]]
    # Motion in the direction of the word, and all motion, of the markers that the joint moves most.
    along_mm = float((slope_mm[moved_most] * direction[moved_most]).sum())
    total_mm = float(np.linalg.norm(slope_mm[moved_most], axis=1).sum())
    if np.nansum(moved_alone_mm(capture, joint)[moved_most] * direction[moved_most]) > 0.0:
        return False
    error_mm = float(lines.chance_mm[joint] * np.sqrt(len(moved_most)))
    return along_mm < -_REVERSED_SHARE * total_mm and along_mm < -_REVERSED_ERRORS * error_mm


def _wanted_direction(names: tuple[str, ...], slope_mm: Array, word: str) -> Array | None:
    """Return the direction in which `word` moves each marker, (n_markers, 3); None: unknown word.

    slope_mm: (n_markers, 3), the joint's measured effect. Only corners of the mouth that the joint
    moves get a direction, because words such as `widens` name no side.
    """
    lips = [i for i, name in enumerate(names) if name in MARKERS_47.names and "lip" in name]
    on_jaw = [i for i, n in enumerate(names) if n in _LOWER or n.startswith(("jaw", "chin"))]
    corners = [(names.index(n), side) for n, side in ((_LEFT, 1.0), (_RIGHT, -1.0)) if n in names]
    moved_mm = {corner: float(np.linalg.norm(slope_mm[corner])) for corner, _ in corners}
    direction = np.zeros((len(names), 3))
    # Words, the markers that they move, and the axis, along which the first word is positive.
    for forward, backward, marker_rows, axis in (
        ("closes", "opens", on_jaw, 1),
        ("raises", "lowers", lips, 1),
        ("protrudes", "retracts", lips, 2),
        ("widens", "narrows", [], 0),
    ):
        if word in (forward, backward):
            sign = 1.0 if word == forward else -1.0
            direction[marker_rows, axis] = sign
            for corner, side in corners if axis == 0 else ():
                if moved_mm[corner] > 0.5 * max(moved_mm.values()):
                    direction[corner, 0] = sign * side
            return direction
    return None


#: What a joint does in a channel's forward direction, and in its backward one.
_WORDS: Mapping[Channel, tuple[str, str]] = {
    "jaw": ("opens", "closes"),
    "upper_lip": ("raises", "lowers"),
    "lower_lip": ("lowers", "raises"),
    "corner_out": ("widens", "narrows"),
    "corner_up": ("raises", "lowers"),
    "protrusion": ("protrudes", "retracts"),
}


def _known_word(name: str, word: str) -> str:
    """Return the known verb for `word`, by the joint's name: `opens` for a jaw that `drops`.

    A word that is known, or that the name does not explain, is returned unchanged.
    """
    if any(word in pair for pair in _WORDS.values()):
        return word
    motion = joint_motion(name, word)
    return word if motion is None else _WORDS[motion.channel][0 if motion.sign > 0 else 1]
