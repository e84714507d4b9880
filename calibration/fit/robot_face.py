"""A model of a robot's face: markers as a function of servo angles, learnt from captured poses.

Until lips meet, they follow the joints: the free face. Where that would bring two dots nearer than
they ever come, the lips stop each other. That least gap is estimated in alternation with the free
face, which is learnt without the lips of poses in contact. Dots beside the lips' edges, thick lips
and an open neutral are thereby handled alike. Loads scikit-learn; the live path never does.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import KFold

from calibration.capture.capture import Capture
from calibration.fit.closing import SeenLadders, lips_are_open, read_ladders
from calibration.fit.retargeting import ShapeFeatures, gap_heights_mm
from calibration.fit.skin_process import (
    Hyperparameters,
    Poses,
    SkinProcess,
    fit_hyperparameters,
    fit_process,
    squared_distances_mm2,
)
from lipsync.arrays import Array

#: A pose this much beyond contact, and so many of them, are evidence; fewer say nothing.
_BEYOND_MM, _LEAST_POSES = 0.4, 3
#: Touching must explain the gaps of those poses this much better than going on does.
_BETTER_SHARE = 0.6
_MOST_YIELD = 0.5
#: Lips that overlap by so much touch and are not pressed flat.
_LIGHT_OVERLAP_MM = (0.1, 2.5)
#: What touching does is nearly the same everywhere; a millimetre squared of doubt.
_RIDGE_MM2 = 2.0


@dataclass(frozen=True, slots=True)
class LipContact:
    """The gaps at which lips stop each other, and how markers yield then.

    closed_mm: (n_gaps,), the dots' gaps where lips touch; pushed: (n_gaps, n_markers, 3), motion of
    markers per millimetre of overlap in each gap.
    """

    closed_mm: Array
    pushed: Array

    def overlap_mm(self, free_gaps_mm: Array) -> Array:
        """Return how far lips would overlap if they did not stop each other, (n, n_gaps) mm, >= 0.

        Parameters
        ----------
        free_gaps_mm : Array
            (n, n_gaps) mm, gaps if lips did not stop each other (the free face).
        """
        return np.maximum(self.closed_mm - free_gaps_mm, 0.0)

    def seen_mm(self, free_mm: Array, free_gaps_mm: Array) -> Array:
        """Return the free face's markers moved by lips that stop each other, (n, n_markers, 3) mm.

        Parameters
        ----------
        free_mm : Array
            (n, n_markers, 3) mm, markers of the free face.
        free_gaps_mm : Array
            (n, n_gaps) mm, gaps if lips did not stop each other (the free face).
        """
        pushed = np.tensordot(self.overlap_mm(free_gaps_mm), self.pushed, axes=1)
        return np.asarray(free_mm + pushed)


def poses_in_contact(free_gaps_mm: Array, closed_mm: Array) -> NDArray[np.bool_]:
    """Return which poses have a middle gap, in the free face, narrower than the closed one, (n,).

    Parameters
    ----------
    free_gaps_mm : Array
        (n, n_gaps) mm, gaps if lips did not stop each other (the free face).
    closed_mm : Array
        (n_gaps,) mm, gaps of closed lips.
    """
    return np.asarray(free_gaps_mm[:, 0] < closed_mm[0])


def first_closed_mm(seen_gaps_mm: Array, contact: NDArray[np.bool_]) -> Array:
    """Return a first estimate of closed gaps: the median over poses in contact, (n_gaps,) mm.

    A gap whose dots are lost in all of these gets its least captured value over all poses.

    Parameters
    ----------
    seen_gaps_mm : Array
        (n, n_gaps) mm, NaN where a dot was lost.
    contact : NDArray[np.bool_]
        (n,): poses in contact.
    """
    is_seen = np.isfinite(seen_gaps_mm[contact]).any(axis=0)
    contact_gaps_mm = np.where(is_seen, seen_gaps_mm[contact], np.nanmin(seen_gaps_mm, axis=0))
    return np.asarray(np.nanmedian(contact_gaps_mm, axis=0))


def closed_gaps_mm(
    seen_gaps_mm: Array, free_gaps_mm: Array, contact: NDArray[np.bool_], closed_mm: Array
) -> Array:
    """Return the gaps at which lips begin to touch, from poses in contact, (n_gaps,) mm.

    Soft lips yield when pressed, so each gap is the value, at overlap 0, of a line through the
    captured gaps by overlap; the line falls by 0 to 0.5 mm per mm.

    Parameters
    ----------
    seen_gaps_mm,free_gaps_mm : Array
        (n, n_gaps) mm: captured, and if lips did not stop each other.
    contact : NDArray[np.bool_]
        (n,): poses in contact.
    closed_mm : Array
        (n_gaps,) mm, a first estimate.
    """
    overlap_mm = np.maximum(closed_mm[0] - free_gaps_mm[contact, 0], 0.0)
    touch_mm = np.empty(seen_gaps_mm.shape[1])
    for gap, seen in enumerate(seen_gaps_mm[contact].T):
        known = np.isfinite(seen)
        if not known.any():
            # Dots that closed lips hide: the first estimate stays.
            touch_mm[gap] = closed_mm[gap]
            continue
        # Overlap and captured gap in the poses in which this gap is seen.
        o, g = overlap_mm[known], seen[known]
        # By how much the gap falls per mm of overlap; 1.0 in the denominator draws it to 0.
        yields = -np.sum((o - o.mean()) * (g - g.mean())) / (np.sum((o - o.mean()) ** 2) + 1.0)
        touch_mm[gap] = np.median(g + np.clip(yields, 0.0, _MOST_YIELD) * o)
    return touch_mm


def touching_gaps_mm(seen_gaps_mm: Array, free_gaps_mm: Array, closed_mm: Array) -> Array:
    """Return the mean of each gap over poses in which lips touch without being pressed hard.

    Parameters
    ----------
    seen_gaps_mm,free_gaps_mm : Array
        (n, n_gaps) mm: captured, and if lips did not stop each other.
    closed_mm : Array
        (n_gaps,) mm, an estimate, kept where fewer than 3 poses touch.

    Returns
    -------
    Array
        (n_gaps,) mm.
    """
    overlap_mm = closed_mm - free_gaps_mm
    lightly = (overlap_mm > _LIGHT_OVERLAP_MM[0]) & (overlap_mm < _LIGHT_OVERLAP_MM[1])
    seen_mm = np.where(lightly, seen_gaps_mm, np.nan)
    counts = np.isfinite(seen_mm).sum(axis=0)
    means = np.nansum(seen_mm, axis=0) / np.maximum(counts, 1)
    return np.where(counts >= _LEAST_POSES, means, closed_mm)


def is_stopped(seen_gaps_mm: Array, free_gaps_mm: Array, closed_mm: Array) -> bool:
    """Return whether captured gaps are nearer to closed ones than to those of the free face.

    Only poses over 0.4 mm beyond contact count; False if fewer than 3 are.

    Parameters
    ----------
    seen_gaps_mm,free_gaps_mm : Array
        (n, n_gaps) mm: captured, and if lips did not stop each other.
    closed_mm : Array
        (n_gaps,) mm, gaps of closed lips.
    """
    beyond = free_gaps_mm[:, 0] < closed_mm[0] - _BEYOND_MM
    seen, free = seen_gaps_mm[beyond, 0], free_gaps_mm[beyond, 0]
    known = np.isfinite(seen)
    if known.sum() < _LEAST_POSES:
        return False
    stopped_cost = np.sum((seen - closed_mm[0])[known] ** 2)
    free_cost = np.sum((seen - free)[known] ** 2)
    return bool(stopped_cost < _BETTER_SHARE * free_cost)


def fit_contact(
    missed_mm: Array,
    free_gaps_mm: Array,
    closed_mm: Array,
    gaps: tuple[tuple[int, int], ...],
) -> LipContact:
    """Return how lips in contact push the markers, by ridge regression on the overlap.

    Parameters
    ----------
    missed_mm : Array
        (n, n_markers, 3) mm, captured less those of free lips, NaN where lost.
    free_gaps_mm : Array
        (n, n_gaps) mm, gaps if lips did not stop each other.
    closed_mm : Array
        (n_gaps,) mm, gaps of closed lips.
    gaps : tuple[tuple[int, int], ...]
        Upper and lower marker numbers.

    Returns
    -------
    LipContact
        Closed gaps, and motion of markers per mm of overlap.
    """
    overlap_mm = np.maximum(closed_mm - free_gaps_mm, 0.0)
    touched = overlap_mm[:, 0] > 0.0
    over_mm, missed = overlap_mm[touched], np.nan_to_num(missed_mm[touched])
    mean_mm = over_mm.mean(axis=1, keepdims=True)
    # Ridge regression on the mean overlap of all gaps, shared evenly among the gaps.
    by_mean = (mean_mm.T @ missed.reshape(len(missed), -1)) / (mean_mm.T @ mean_mm + _RIDGE_MM2)
    evenly = np.repeat(by_mean, over_mm.shape[1], axis=0) / over_mm.shape[1]
    by_gap = evenly.reshape(over_mm.shape[1], *missed_mm.shape[1:]).copy()
    for gap, (upper, lower) in enumerate(gaps):
        # The two dots of a gap part by all of its own overlap, and by no other gap's; what is
        # missing is shared by both.
        for other in range(len(gaps)):
            wanted = 1.0 if other == gap else 0.0
            missing = wanted - (by_gap[other, upper, 1] - by_gap[other, lower, 1])
            by_gap[other, upper, 1] += missing / 2
            by_gap[other, lower, 1] -= missing / 2
    return LipContact(closed_mm, by_gap)


_FOLDS = 6
#: Rounds of filling in, the hyperparameters as they are.
_FILLING_ROUNDS = 12
#: The narrowest gaps are taken for closed first; by turns the poses sort themselves.
_FIRST_CONTACT_SHARE, _CONTACT_ROUNDS, _LEAST_IN_CONTACT = 0.12, 4, 3
#: Rounds between hyperparameters and lost points.
_FIT_ROUNDS = 2


@dataclass(frozen=True, slots=True)
class RobotFace:
    """A learnt face: markers by pose. backlash_deg: (n_servos,), the whole width of the backlash.

    left_out_rms_mm: the error on poses left out of the fit, in each axis, the tracker's noise
    included; noise_mm: rms residual of the fit. contact: None
    where lips were not found to stop each other. ladders: evidence from poses that close the lips
    step by step; None where none were captured.
    """

    servo_names: tuple[str, ...]
    marker_names: tuple[str, ...]
    process: SkinProcess
    centre_mm: Array
    middle_deg: Array
    half_range_deg: Array
    backlash_deg: Array
    left_out_rms_mm: float
    noise_mm: float
    contact: LipContact | None = None
    gaps: tuple[tuple[int, int], ...] = ()
    ladders: SeenLadders | None = None

    def free_mm(self, output_deg: Array) -> Array:
        """Return the markers of poses as if lips did not stop each other and might overlap.

        Parameters
        ----------
        output_deg : Array
            (n, n_servos) degrees of the horns, without backlash.

        Returns
        -------
        Array
            (n, n_markers, 3) mm.
        """
        inputs = (output_deg - self.middle_deg) / self.half_range_deg
        return np.asarray(self.centre_mm + self.process.predict(inputs))

    def markers_mm(self, output_deg: Array) -> Array:
        """Return the markers of poses, with lips that stop each other if they were found to.

        Parameters
        ----------
        output_deg : Array
            (n, n_servos) degrees of the horns, without backlash.

        Returns
        -------
        Array
            (n, n_markers, 3) mm.
        """
        free_mm = self.free_mm(output_deg)
        if self.contact is None:
            return free_mm
        return self.contact.seen_mm(free_mm, gap_heights_mm(free_mm, self.gaps))


def fit_robot_face(capture: Capture, mouth: ShapeFeatures | None = None) -> RobotFace:
    """Return the face learnt from a capture; points that the tracker lost are left out of the fit.

    Backlash is estimated from the side that each pose was reached from, together with the face.
    mouth: features with the lip gaps, for finding whether lips stop each other; None: not examined.
    """
    low_deg, high_deg = capture.goals_deg.min(axis=0), capture.goals_deg.max(axis=0)
    half_range_deg = np.maximum((high_deg - low_deg) / 2, 1e-6)
    side = np.asarray(capture.from_below, dtype=np.float64)
    poses = Poses(capture.goals_deg, side, (high_deg + low_deg) / 2, half_range_deg)
    centre_mm = np.nanmean(capture.markers_mm, axis=0)
    seen_mm = capture.markers_mm - centre_mm
    apart_mm2 = squared_distances_mm2(capture.marker_names, centre_mm)
    fit = _FaceFit(poses, apart_mm2, lips_are_open(capture))
    known = np.isfinite(seen_mm)
    filled = fit.fill_lost_points(seen_mm, known)
    assert fit.hyperparameters is not None
    noise_mm = float(np.sqrt(fit.hyperparameters.noise_mm2))
    closed_mm: Array | None = None
    gaps = () if mouth is None else mouth.gaps
    ladders = None
    if mouth is not None:
        # Contact, if ladders (poses that close the lips in steps) show it; without ladders it is
        # looked for in all poses.
        ladders = read_ladders(capture, lambda deg: centre_mm + fit.predict(filled, deg), noise_mm)
        if ladders is None or ladders.kink.is_contact:
            touching = None if ladders is None else ladders.touching
            freed = _without_contact(fit, seen_mm, known, filled, centre_mm, mouth, touching)
            if freed is not None:
                filled, known, closed_mm = freed
    inputs = poses.inputs(fit.hyperparameters.backlash_deg)
    process = fit.process_at(inputs, filled)
    missed_mm = filled - process.predict(inputs)
    # How lips in contact push the markers, from what the captured ones differ from the free face.
    contact = None
    if closed_mm is not None:
        free_mm = centre_mm + process.predict(inputs)
        free_gaps_mm = gap_heights_mm(free_mm, gaps)
        contact = fit_contact(capture.markers_mm - free_mm, free_gaps_mm, closed_mm, gaps)
    return RobotFace(
        servo_names=capture.servo_names,
        marker_names=capture.marker_names,
        process=process,
        centre_mm=centre_mm,
        middle_deg=poses.middle_deg,
        half_range_deg=half_range_deg,
        backlash_deg=fit.hyperparameters.backlash_deg,
        left_out_rms_mm=_left_out_rms_mm(fit, inputs, filled, known),
        noise_mm=float(np.sqrt(np.mean(missed_mm[known] ** 2))),
        contact=contact,
        gaps=gaps,
        ladders=ladders,
    )


class _FaceFit:
    """A Gaussian process fitted in alternation with the filling in of lost points.

    hyperparameters: None before the first call of `fill_lost_points`. opened: (n,), poses in which
    no ladder presses the lips, from which the hyperparameters are found.
    """

    def __init__(self, poses: Poses, apart_mm2: Array, opened: NDArray[np.bool_]) -> None:
        self._poses = poses
        self._open_poses = poses.of(opened)
        self._is_open = opened
        self._apart_mm2 = apart_mm2
        self.hyperparameters: Hyperparameters | None = None

    def fill_lost_points(self, seen_mm: Array, known: NDArray[np.bool_]) -> Array:
        """Fit the Gaussian process; return seen_mm with points that are not `known` predicted.

        seen_mm, known: (n, n_markers, 3), mm from each marker's mean. With lost points, fits of the
        hyperparameters and predictions of these points alternate.
        """
        filled_mm = np.where(known, seen_mm, 0.0)
        for _ in range(1 if known.all() else _FIT_ROUNDS):
            open_mm = filled_mm[self._is_open]
            self.hyperparameters = fit_hyperparameters(self._open_poses, open_mm, self._apart_mm2)
            for _ in range(1 if known.all() else _FILLING_ROUNDS):
                filled_mm = np.where(known, filled_mm, self.predict_captured(filled_mm))
        return filled_mm

    def process_at(self, inputs: Array, from_centre_mm: Array) -> SkinProcess:
        """Return the process fitted at `inputs` (n, n_servos) to markers (n, n_markers, 3) mm."""
        assert self.hyperparameters is not None
        return fit_process(self.hyperparameters, inputs, from_centre_mm, self._apart_mm2)

    def predict(self, filled_mm: Array, goals_deg: Array) -> Array:
        """Predict markers at goals (m, n_servos) in degrees; return (m, n_markers, 3) mm.

        Markers are relative to each marker's mean over all captured poses. filled_mm: (n,
        n_markers, 3), the captured markers, lost ones filled in; only the poses in which lips are
        not pressed together are learnt from.
        """
        assert self.hyperparameters is not None
        poses = self._poses
        inputs = self._open_poses.inputs(self.hyperparameters.backlash_deg)
        process = self.process_at(inputs, filled_mm[self._is_open])
        return process.predict((goals_deg - poses.middle_deg) / poses.half_range_deg)

    def predict_captured(self, filled_mm: Array) -> Array:
        """Return markers, (n, n_markers, 3) mm, predicted at all captured poses from filled_mm.

        filled_mm: (n, n_markers, 3), the captured markers, lost ones filled in; all count.
        """
        assert self.hyperparameters is not None
        inputs = self._poses.inputs(self.hyperparameters.backlash_deg)
        return self.process_at(inputs, filled_mm).predict(inputs)


def _without_contact(
    fit: _FaceFit,
    seen_mm: Array,
    known: NDArray[np.bool_],
    filled: Array,
    centre_mm: Array,
    mouth: ShapeFeatures,
    touching: NDArray[np.bool_] | None,
) -> tuple[Array, NDArray[np.bool_], Array] | None:
    """Return markers as if lips did not stop each other, which are measured, and closed gaps in mm.

    None without evidence that lips stop each other. seen_mm, known, filled: captured markers from
    their centres centre_mm, which of them are known, and the markers with lost ones predicted, (n,
    n_markers, 3) each. touching: (n,), poses in which ladders, which close the lips in steps,
    showed contact; None: there are no ladders.
    """
    gaps = mouth.gaps
    seen_gaps_mm = gap_heights_mm(np.where(known, seen_mm, np.nan) + centre_mm, gaps)
    contact = touching
    # Without ladders the poses with the narrowest gaps are taken for contact at first.
    if contact is None:
        contact = seen_gaps_mm[:, 0] < np.nanquantile(seen_gaps_mm[:, 0], _FIRST_CONTACT_SHARE)
    if contact.sum() < _LEAST_IN_CONTACT or not np.isfinite(seen_gaps_mm).any(axis=0).all():
        return None
    # In turns: predict the lips of poses in contact, sort the poses by it, estimate the gaps anew.
    closed_mm = first_closed_mm(seen_gaps_mm, contact)
    for _ in range(_CONTACT_ROUNDS):
        # Heights of lips in contact are treated as lost, and predicted from all other poses.
        kept_known = known.copy()
        kept_known[np.ix_(np.flatnonzero(contact), np.array(mouth.lips), np.array([1]))] = False
        for _ in range(_FILLING_ROUNDS):
            filled = np.where(kept_known, seen_mm, fit.predict_captured(filled))
        free_gaps_mm = gap_heights_mm(filled + centre_mm, gaps)
        expected_mm = gap_heights_mm(fit.predict_captured(filled) + centre_mm, gaps)
        free_gaps_mm = np.where(contact[:, None], free_gaps_mm, expected_mm)
        contact = (
            poses_in_contact(free_gaps_mm, closed_mm)
            if touching is None
            else np.asarray((free_gaps_mm < closed_mm).any(axis=1))
        )
        if contact.sum() < _LEAST_IN_CONTACT:
            return None
        closed_mm = (
            closed_gaps_mm(seen_gaps_mm, free_gaps_mm, contact, closed_mm)
            if touching is None
            else touching_gaps_mm(seen_gaps_mm, free_gaps_mm, closed_mm)
        )
    if touching is None and not is_stopped(seen_gaps_mm, free_gaps_mm, closed_mm):
        return None
    return filled, kept_known, closed_mm


def _left_out_rms_mm(
    fit: _FaceFit, inputs: Array, from_centre_mm: Array, seen: NDArray[np.bool_]
) -> float:
    """Return the cross-validated rms error in each axis, in mm, of the points that were `seen`."""
    off_mm = np.full_like(from_centre_mm, np.nan)
    folds = KFold(min(_FOLDS, len(inputs)), shuffle=True, random_state=0)
    for rows, left_out in folds.split(inputs):
        process = fit.process_at(inputs[rows], from_centre_mm[rows])
        off_mm[left_out] = process.predict(inputs[left_out]) - from_centre_mm[left_out]
    return float(np.sqrt(np.mean(off_mm[seen] ** 2)))
