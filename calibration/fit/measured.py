"""The fit of a measured calibration from captured poses, with its errors.

Errors compare the made shapes with the wanted ones on the learnt face, not the real one: what the
learnt face has wrong everywhere alike does not show in them. The error of poses left out of the
face's own fit, noise included, is reported beside these.
Loads scikit-learn; the live path never does.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from calibration.calibration import Calibration, CalibrationError, Following, Origin, Touch
from calibration.capture.capture import Capture
from calibration.capture.sanity import check_capture
from calibration.closure import CLOSED_GAP_MM
from calibration.fit.closing import pair_slopes
from calibration.fit.retargeting import (
    LEAST_OPENING_MM,
    PRESS_MM,
    Correspondence,
    Retargeting,
    RobotMouth,
    correspond,
    fit_retargeting,
    gap_heights_mm,
    no_opening,
)
from calibration.fit.robot_face import RobotFace, fit_robot_face
from calibration.fit.run_time_map import fit_closure, fit_run_time_map
from calibration.grade import (
    CONTACT,
    LIMITS,
    PASSED,
    Closing,
    HoldOutErrors,
    LearntLips,
    VisemeReach,
    each_marker_rms_mm,
    gap_figures,
)
from calibration.mouth_servos import MouthServos, linear_calibration
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.phonemes import VISEME_CLASSES

#: A shape counts as reached when opening and width of the best pose are within this.
REACHABLE_MM = 1.0
#: AnimPhos looked at for each viseme class: their middle frames.
_FRAMES_PER_CLASS = 30


@dataclass(frozen=True, slots=True)
class ShapeErrors:
    """The speaker, learnt mouth and wanted shapes, from which a map's errors are computed.

    stay_apart_mm: how far lips stay apart that are as closed as they can be.
    """

    model: FaceWithAnimPhos
    mouth: RobotMouth
    retargeting: Retargeting
    stay_apart_mm: float = 0.0

    def reached(self, from_rest: Array) -> NDArray[np.bool_]:
        """Return whether the best pose for each frame has opening and width within 1 mm of wanted.

        Parameters
        ----------
        from_rest : Array
            (n, n_components) mm, coefficients less the rest.

        Returns
        -------
        NDArray[np.bool_]
            (n,).
        """
        wanted_mm, best_mm = self.openings_and_widths_mm(from_rest)
        return np.asarray((np.abs(best_mm - wanted_mm) <= REACHABLE_MM).all(axis=1))

    def openings_and_widths_mm(self, from_rest: Array) -> tuple[Array, Array]:
        """Return the wanted opening and width of the mouth, and those of the best poses.

        Parameters
        ----------
        from_rest : Array
            (n, n_components) mm, coefficients less the rest.

        Returns
        -------
        tuple[Array, Array]
            (n, 2) mm each: opening, width.
        """
        right, left = self.mouth.names.corners
        poses_deg = self.retargeting.poses_deg(from_rest)
        # The wanted gaps, and the speaker's scaled motion on the robot's neutral.
        copies_mm, gaps_mm = self.retargeting.copies_mm(from_rest)
        best_mm = self.mouth.markers_of(poses_deg)
        opening_mm = gap_heights_mm(best_mm, self.mouth.names.shape_features.gaps[:1])[:, 0]
        wanted = [gaps_mm[:, 0, 1], copies_mm[:, left, 0] - copies_mm[:, right, 0]]
        best = [opening_mm, best_mm[:, left, 0] - best_mm[:, right, 0]]
        return np.stack(wanted, axis=1), np.stack(best, axis=1)

    def apart_mm(self, poses_deg: Array, targets_mm: Array) -> Array:
        """Return the distance of the learnt face's lips from targets, rms over the lip markers.

        Parameters
        ----------
        poses_deg : Array
            (n, n_servos) degrees.
        targets_mm : Array
            (n, n_markers, 3) mm.

        Returns
        -------
        Array
            (n,) mm.
        """
        lips = list(self.mouth.names.shape_features.lips)
        return lips_apart_mm(self.mouth.seen_mm(poses_deg), targets_mm, lips)


def lips_apart_mm(markers_mm: Array, targets_mm: Array, lips: list[int]) -> Array:
    """Return the distance in space between two sets of lip markers, rms over the markers.

    Parameters
    ----------
    markers_mm,targets_mm : Array
        (n, n_markers, 3) mm.
    lips : list[int]
        Numbers of the lip markers.

    Returns
    -------
    Array
        (n,) mm.
    """
    squares = np.sum((markers_mm - targets_mm)[:, lips] ** 2, axis=2)
    return np.asarray(np.sqrt(squares.mean(axis=1)))


def _errors(ref: ShapeErrors, run: Calibration, held_out: Array) -> HoldOutErrors:
    """Return the errors of the calibration `run` on held-out frames of speech, on the learnt face.

    ref: speaker, learnt mouth and wanted shapes; held_out: (n, n_components) coefficients.
    Markers are compared with the wanted shapes, angles with the best poses.
    """
    from_rest = held_out - ref.model.rest
    best_deg = ref.retargeting.poses_deg(from_rest)
    targets_mm = ref.retargeting.targets_mm(from_rest)
    poses_deg = run.poses_deg(held_out)
    robot_mm = ref.mouth.seen_mm(poses_deg)
    human_gap_mm = ref.model.lip_gaps_mm(ref.model.markers_mm(held_out))
    gap_mm = _opening_mm(ref, robot_mm)
    is_closed = human_gap_mm <= CLOSED_GAP_MM
    gaps = gap_figures(ref.retargeting.wanted_open_mm(from_rest)[:, 0], gap_mm, human_gap_mm)
    both_move = min(human_gap_mm.std(), gap_mm.std()) > 0.0
    return HoldOutErrors(
        n_frames=len(held_out),
        marker_rms_mm=_rms(np.linalg.norm(robot_mm - targets_mm, axis=2)),
        lip_rms_mm=_rms(ref.apart_mm(poses_deg, targets_mm)),
        gap_rms_mm=_rms(gap_mm - _opening_mm(ref, targets_mm)),
        gap_correlation=float(np.corrcoef(human_gap_mm, gap_mm)[0, 1]) if both_move else 0.0,
        n_closures=int(is_closed.sum()),
        closed_gap_mm=ref.stay_apart_mm + (gaps.closed_mm or 0.0),
        clipped_share=float(_is_at_limit(poses_deg, ref.mouth).mean()),
        joint_rms_deg=tuple(_rms(column) for column in (poses_deg - best_deg).T),
        each_marker_rms_mm=each_marker_rms_mm(ref.mouth.names.marker_names, robot_mm - targets_mm),
        gap_slope=gaps.slope,
        small_gaps_kept=gaps.small_kept,
    )


def _coverage(ref: ShapeErrors, run: Calibration) -> dict[str, VisemeReach]:
    """Return how well the calibration `run` reaches each viseme class, by its first phoneme.

    ref: speaker and learnt mouth. Compared are the middle frames of at most 30 AnimPhos (pieces
    of recorded motion about a phoneme) of each class.
    """
    rows = {viseme[0]: _rows_of_class(ref.model, viseme) for viseme in VISEME_CLASSES}
    rows = {viseme: class_rows for viseme, class_rows in rows.items() if len(class_rows)}
    # The middle frame of each piece of motion (AnimPho), class after class.
    frames = ref.model.animphos.samples[np.concatenate(list(rows.values())), 2]
    from_rest = frames - ref.model.rest
    reached = ref.reached(from_rest)
    targets_mm = ref.retargeting.targets_mm(from_rest)
    poses_deg = run.poses_deg(frames)
    off_mm = ref.apart_mm(poses_deg, targets_mm)
    wanted_mm = ref.retargeting.wanted_open_mm(from_rest)[:, 0]
    made_mm = _opening_mm(ref, ref.mouth.seen_mm(poses_deg))
    human_mm = ref.model.lip_gaps_mm(ref.model.markers_mm(frames))
    at_limit = _is_at_limit(poses_deg, ref.mouth)
    reach: dict[str, VisemeReach] = {}
    begin = 0
    for viseme, class_rows in rows.items():
        part = slice(begin, begin + len(class_rows))
        gaps = gap_figures(wanted_mm[part], made_mm[part], human_mm[part])
        reach[viseme] = VisemeReach(
            reachable=float(reached[part].mean()),
            off_mm=_rms(off_mm[part]),
            gap_slope=gaps.slope,
            closed_gap_mm=None if gaps.closed_mm is None else ref.stay_apart_mm + gaps.closed_mm,
            small_gaps_kept=gaps.small_kept,
            at_limit=float(at_limit[part].mean()),
        )
        begin = part.stop
    return reach


def _is_at_limit(poses_deg: Array, mouth: RobotMouth) -> NDArray[np.bool_]:
    """Return whether any joint of the mouth is at a limit in each pose, (n,)."""
    low, high = mouth.limits_deg
    return np.asarray(((poses_deg <= low) | (poses_deg >= high)).any(axis=1))


def _rows_of_class(model: FaceWithAnimPhos, viseme: tuple[str, ...]) -> NDArray[np.int64]:
    """Return row numbers of at most 30 AnimPhos, evenly over all of a viseme class.

    An AnimPho is a stretch of face motion about one phoneme; viseme: phonemes of the class.
    """
    rows = np.concatenate([model.animphos.of_phoneme(phoneme) for phoneme in viseme])
    if not len(rows):
        return rows
    evenly = np.linspace(0, len(rows) - 1, min(len(rows), _FRAMES_PER_CLASS)).astype(np.int64)
    return np.asarray(rows[evenly], dtype=np.int64)


def _opening_mm(ref: ShapeErrors, markers_mm: Array) -> Array:
    """Return the openings of the middle of the lips, (n,) mm, beyond the robot's own closed gap."""
    heights_mm = gap_heights_mm(markers_mm, ref.mouth.names.shape_features.gaps[:1])[:, 0]
    return np.asarray(heights_mm - ref.retargeting.closed_mm[0])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


#: One joint is loose with so much play, so many times the usual, and so many times the next's: of
#: healthy simulated robots (1 degree all) the fit says up to 1.7.
_LOOSE_DEG, _LOOSE_TIMES, _AHEAD_OF_NEXT, _FEWEST_JOINTS = 2.0, 1.8, 1.25, 3


def loose_joint(servo_names: tuple[str, ...], backlash_deg: Array) -> tuple[str, ...]:
    """Return a warning if exactly one joint has far more backlash than is usual for its face.

    Backlash beyond the last step of a pose (3 degrees) is underestimated, and a joint that hardly
    moves the skin is not distinguished from its neighbours, so that it gives no warning.

    Parameters
    ----------
    servo_names : tuple[str, ...]
        Names of the n_servos servos.
    backlash_deg : Array
        (n_servos,) degrees.

    Returns
    -------
    tuple[str, ...]
        One line, or () if no joint is loose.
    """
    if len(backlash_deg) < _FEWEST_JOINTS:
        return ()
    order = np.argsort(backlash_deg)[::-1]
    most_deg, next_deg = backlash_deg[order[:2]]
    usual_deg = float(np.median(backlash_deg))
    if most_deg < max(_LOOSE_DEG, _LOOSE_TIMES * usual_deg) or most_deg < _AHEAD_OF_NEXT * next_deg:
        return ()
    return (
        f"servo {servo_names[order[0]]!r} is loose: it has {most_deg:.1f} deg of play or more, "
        f"where {usual_deg:.1f} is usual in this face; tighten its horn and its rod",
    )


HOLD_OUT_SHARE = 0.2
#: At most so many AnimPhos of 5 frames are fitted to: a map of 45 numbers for each servo needs no
#: more. And held out: so many that closures, a tenth of the frames, are well over fifty.
MAX_FITTED, MAX_HELD_OUT = 240, 160
#: A fifth of what an XL330-M288-T draws when stalled at 5 V, 1.47 A
#: (https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#specifications). Soft lips need less.
TOUCH_CURRENT_MA = 294.0

#: Where lips were seen to stop each other, closures go so far past contact: less leaves the middle
#: of lips open that are pulled at their sides (docs/decisions/calibration.md).
_CONTACT_PRESS_MM = 1.0
#: What noise gives a kink of three ladders at the most, in square standard errors.
_CONTACT_HINT = 15.0
#: A joint that is so near to its limit stands at it.
_AT_LIMIT_DEG = 0.5
#: One narrow reading may be noise.
_NARROW_Q = 0.05


@dataclass(frozen=True, slots=True)
class MeasuredFit:
    """A calibration with the learnt face, the retargeting and the frames that it was made from.

    held_out: (n, n_components), frames left out of the fit.
    """

    calibration: Calibration
    face: RobotFace
    retargeting: Retargeting
    names: Correspondence
    held_out: Array
    warnings: tuple[str, ...]


def fit_measured(
    model: FaceWithAnimPhos,
    capture: Capture,
    servos: MouthServos,
    *,
    date: str = "",
    seed: int = 0,
    accept: bool = False,
) -> MeasuredFit:
    """Return the calibration fitted to a capture, with the learnt face and warnings.

    The capture is checked; face, retargeting and run-time map are fitted; errors are measured on
    held-out AnimPhos (stretches of motion about a phoneme), drawn by `seed`. date: ISO 8601.
    accept: doubts about size and joints become warnings. Raises CalibrationError for a capture with
    faults.
    """
    # Threads that share small products wait for each other: a minute in place of twenty seconds.
    with threadpool_limits(limits=1):
        names = correspond(capture.marker_names)
        checked = check_capture(capture, model, servos.positive, accept=accept)
        capture = checked.capture
        face = fit_robot_face(capture, names.shape_features)
        warnings = (*checked.warnings, *loose_joint(face.servo_names, face.backlash_deg))
        fitted, held_out = split_frames(model, seed)
        # The mouth that is searched for poses; joints that move nothing visibly stay at 0.
        mouth = mouth_of(face, names, servos.holding(checked.still))
        retargeting = retargeting_of(model, mouth, face, capture)
        from_rest = fitted - model.rest
        poses_deg = retargeting.poses_deg(from_rest)
        closing = closing_of(face, mouth, capture)
        stay_apart_mm = 0.0 if closing is None else closing.apart_mm
        shapes = ShapeErrors(model, mouth, retargeting, stay_apart_mm)
        calibration = linear_calibration(
            model,
            servos,
            **fit_run_time_map(from_rest, poses_deg),
            closure=fit_closure(retargeting, from_rest, poses_deg),
            errors=HoldOutErrors(),
            origin=Origin("measured", date, len(capture), servos.models),
            following=backlash_only(face.backlash_deg),
            touch=Touch(_touch_deg(retargeting), TOUCH_CURRENT_MA),
            rules=servos.rules,
            closing=closing,
            learnt_lips=LearntLips(
                left_out_rms_mm=face.left_out_rms_mm,
                noise_mm=face.noise_mm,
                own_gap_mm=float(retargeting.closed_mm[0]),
                stop=face.contact is not None,
            ),
        )
        calibration = replace(
            calibration,
            errors=_errors(shapes, calibration, held_out),
            coverage=_coverage(shapes, calibration),
        )
        return MeasuredFit(calibration, face, retargeting, names, held_out, warnings)


def split_frames(
    model: FaceWithAnimPhos, seed: int, n_animphos: int | None = None
) -> tuple[Array, Array]:
    """Return frames to fit and frames to hold out, from different AnimPhos, drawn by `seed`.

    AnimPhos are recorded pieces of motion, each about one phoneme. n_animphos: a fifth of so many
    is held out, the others are fitted; None: 240 are fitted and 160, but at most a fifth of all,
    are held out. Raises CalibrationError for a model with fewer than two AnimPhos.

    Returns
    -------
    tuple[Array, Array]
        (n, n_components) each.
    """
    shuffled = np.random.default_rng(seed).permutation(len(model.animphos))
    if len(shuffled) < 2:
        raise CalibrationError("the model has fewer than 2 AnimPhos; give another with --model")
    n_held_out, n_fitted = MAX_HELD_OUT, MAX_FITTED
    if n_animphos is not None:
        n_held_out = round(HOLD_OUT_SHARE * n_animphos)
        n_fitted = n_animphos - n_held_out
    n_held_out = min(n_held_out, max(1, round(HOLD_OUT_SHARE * len(shuffled))))
    held_out, fitted = shuffled[:n_held_out], shuffled[n_held_out : n_held_out + n_fitted]
    frames = model.animphos.samples.reshape(len(shuffled), -1, model.n_components)
    return np.concatenate(frames[fitted]), np.concatenate(frames[held_out])


def backlash_only(backlash_deg: Array) -> Following:
    """Return a servo response that contains backlash alone, before lags and speeds are measured.

    Parameters
    ----------
    backlash_deg : Array
        (n_servos,) degrees.

    Returns
    -------
    Following
        Lags 0, speeds and bandwidths inf; backlash in degrees.
    """
    unknown = np.full(len(backlash_deg), np.inf)
    return Following(np.zeros(len(backlash_deg)), backlash_deg, unknown, unknown)


def mouth_of(face: RobotFace, names: Correspondence, servos: MouthServos) -> RobotMouth:
    """Return the mouth of a learnt face, with the servos' limits and rules, for retargeting."""
    return RobotMouth(face.free_mm, names, servos.limits_deg, servos.rules, face.markers_mm)


def retargeting_of(
    model: FaceWithAnimPhos, mouth: RobotMouth, face: RobotFace, capture: Capture
) -> Retargeting:
    """Return the retargeting to a learnt face, with the closed gaps that the capture shows.

    Closed gaps are those of contact where it was found, else those of the ladder (poses that close
    the lips in steps) that brings lips nearest, else the narrowest captured. The scale is fitted to
    all recorded speech, because the widest gaps of a few hundred frames are chance. Raises
    CalibrationError for lips that hardly part in the capture.
    """
    frames = model.animphos.frames
    heights_mm = gap_heights_mm(capture.markers_mm, mouth.names.shape_features.gaps)
    opening_mm = float(np.ptp(np.nanquantile(heights_mm[:, 0], [_NARROW_Q, 1.0 - _NARROW_Q])))
    if opening_mm < LEAST_OPENING_MM:
        raise no_opening(mouth, opening_mm)
    if face.contact is not None:
        return fit_retargeting(model, frames, mouth, face.contact.closed_mm, _CONTACT_PRESS_MM)
    if face.ladders is not None and not face.ladders.meet:
        # The gaps of the nearest pose count as closed, and there is nothing to press.
        return fit_retargeting(model, frames, mouth, nearest_gaps(face, capture)[1], 0.0)
    # Dots cannot pass each other, so lips touch at a gap of 0 at the latest. Where dots never came
    # so near, they lie beside the lips' edges, and the narrowest gap seen is the best guess.
    narrowest_mm = np.nanquantile(heights_mm, _NARROW_Q, axis=0)
    return fit_retargeting(model, frames, mouth, np.maximum(narrowest_mm, 0.0), PRESS_MM)


def nearest_gaps(face: RobotFace, capture: Capture) -> tuple[Array, Array]:
    """Return the last pose of the ladder that brings lips nearest, and the gaps in that pose.

    A ladder is a series of poses that close the lips step by step.

    Parameters
    ----------
    face : RobotFace
        Learnt face, with ladders.
    capture : Capture
        Capture that the face was learnt from.

    Returns
    -------
    tuple[Array, Array]
        (n_servos,) degrees and (n_gaps,) mm.
    """
    assert face.ladders is not None
    rows = [ladder_rows[-1] for ladder_rows in face.ladders.rows]
    ends_deg = capture.goals_deg[rows]
    horns_deg = ends_deg - capture.from_below[rows] * face.backlash_deg / 2
    heights_mm = gap_heights_mm(face.free_mm(horns_deg), face.gaps)
    nearest_row = int(heights_mm[:, 0].argmin())
    return ends_deg[nearest_row], heights_mm[nearest_row]


def closing_of(face: RobotFace, mouth: RobotMouth, capture: Capture) -> Closing | None:
    """Return whether lips meet, by the ladders: poses that close the lips step by step.

    None without ladders, or where these show neither lips that meet nor joints at a limit.
    """
    if face.ladders is None:
        return None
    if face.ladders.kink.is_contact:
        return Closing(CONTACT)
    if face.ladders.passed:
        return Closing(PASSED)
    if face.ladders.kink.explained > _CONTACT_HINT:
        return None  # something stalls there, and nobody can say what
    pose_deg, gaps_mm = nearest_gaps(face, capture)
    mm_per_deg = pair_slopes(mouth.markers_of, pose_deg, face.gaps[:1])[0]
    low_deg, high_deg = mouth.limits_deg
    # Joints that would close the lips farther but are within half a degree of their limits.
    at_end = np.where(mm_per_deg > 0.0, pose_deg - low_deg, high_deg - pose_deg) < _AT_LIMIT_DEG
    if not at_end.any():
        return None
    joint = int(np.where(at_end, np.abs(mm_per_deg), 0.0).argmax())
    apart_mm = max(float(gaps_mm[0]), 0.0)
    missing_deg = apart_mm / max(abs(float(mm_per_deg[joint])), 1e-3)
    return Closing(LIMITS, apart_mm, face.servo_names[joint], missing_deg)


def _touch_deg(retargeting: Retargeting) -> Array:
    """Return the pose, (n_servos,) degrees, of the speaker's rest with the lips just meeting."""
    rest = np.zeros((1, retargeting.model.n_components))
    return np.asarray(retargeting.at_gap(rest, float(retargeting.closed_mm[0]))[0])
