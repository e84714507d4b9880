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
from calibration.fit.closing import SeenLadders, read_ladders
from calibration.fit.retargeting import ShapeFeatures, gap_heights_mm
from calibration.fit.skin_process import (
    Poses,
    SkinProcess,
    fit_hyperparameters,
    fit_process,
    squared_distances_mm2,
)
from lipsync.arrays import Array, Indices

#: A pose this much beyond contact, and so many of them, are evidence; fewer say nothing.
_BEYOND_MM, _LEAST_POSES = 0.4, 3
#: Touching must explain the gaps of those poses this much better than going on does.
_BETTER_SHARE = 0.6
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
#: Without ladders the narrowest gaps count as closed first; by turns the poses sort themselves.
_FIRST_CONTACT_SHARE, _CONTACT_ROUNDS = 0.12, 4
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
    fit = _FaceFit(capture)
    middle_deg, half_range_deg = fit.poses.middle_deg, fit.poses.half_range_deg
    process = fit.process_of(fit.filled_mm)

    filled_mm, known, contact, ladders = fit.filled_mm, fit.known, None, None
    if mouth is not None:
        noise_mm = float(np.sqrt(fit.hyperparameters.noise_mm2))
        ladders = read_ladders(
            capture,
            lambda deg: fit.centre_mm + process.predict((deg - middle_deg) / half_range_deg),
            noise_mm,
        )
    if mouth is not None and (ladders is None or ladders.kink.is_contact):
        # Contact, if ladders show it; without ladders it is looked for in all poses.
        freed = _without_contact(fit, mouth, None if ladders is None else ladders.touching)
        if freed is not None:
            filled_mm, known, closed_mm = freed
            process = fit.process_of(filled_mm)
            markers_mm = fit.centre_mm + process.predict(fit.inputs)
            gaps_mm = gap_heights_mm(markers_mm, mouth.gaps)
            missed_mm = capture.markers_mm - markers_mm
            contact = fit_contact(missed_mm, gaps_mm, closed_mm, mouth.gaps)
    off_mm = filled_mm - process.predict(fit.inputs)
    return RobotFace(
        servo_names=capture.servo_names,
        marker_names=capture.marker_names,
        process=process,
        centre_mm=fit.centre_mm,
        middle_deg=middle_deg,
        half_range_deg=half_range_deg,
        backlash_deg=fit.hyperparameters.backlash_deg,
        left_out_rms_mm=_left_out_rms_mm(fit, filled_mm, known),
        noise_mm=float(np.sqrt(np.mean(off_mm[known] ** 2))),
        contact=contact,
        gaps=() if mouth is None else mouth.gaps,
        ladders=ladders,
    )


class _FaceFit:
    """The hyperparameters of a capture, found in alternation with the filling in of lost points.

    Markers, (n, n_markers, 3) mm, are from each one's mean over the capture, centre_mm: seen_mm,
    NaN where not known, and filled_mm, with lost points predicted. inputs: of the process.
    """

    def __init__(self, capture: Capture) -> None:
        low_deg, high_deg = capture.goals_deg.min(axis=0), capture.goals_deg.max(axis=0)
        half_range_deg = np.maximum((high_deg - low_deg) / 2, 1e-6)
        side = np.asarray(capture.from_below, dtype=np.float64)
        self.poses = Poses(capture.goals_deg, side, (high_deg + low_deg) / 2, half_range_deg)
        self.centre_mm = np.nanmean(capture.markers_mm, axis=0)
        self.seen_mm = capture.markers_mm - self.centre_mm
        self.known = np.isfinite(self.seen_mm)
        self.filled_mm = np.where(self.known, self.seen_mm, 0.0)
        self._apart_mm2 = squared_distances_mm2(capture.marker_names, self.centre_mm)
        for _ in range(1 if self.known.all() else _FIT_ROUNDS):
            self.hyperparameters = fit_hyperparameters(self.poses, self.filled_mm, self._apart_mm2)
            self.inputs = self.poses.inputs(self.hyperparameters.backlash_deg)
            self.filled_mm = self.filled(self.known, self.filled_mm)

    def process_of(self, from_centre_mm: Array, rows: Indices | slice = slice(None)) -> SkinProcess:
        """Return the process fitted to markers (n, n_markers, 3) mm of the poses `rows`."""
        inputs, markers_mm = self.inputs[rows], from_centre_mm[rows]
        return fit_process(self.hyperparameters, inputs, markers_mm, self._apart_mm2)

    def filled(self, known: NDArray[np.bool_], filled_mm: Array) -> Array:
        """Return the markers with points that are not `known` predicted, from filled_mm on."""
        for _ in range(0 if known.all() else _FILLING_ROUNDS):
            predicted_mm = self.process_of(filled_mm).predict(self.inputs)
            filled_mm = np.where(known, self.seen_mm, predicted_mm)
        return filled_mm


def _without_contact(
    fit: _FaceFit, mouth: ShapeFeatures, touching: NDArray[np.bool_] | None
) -> tuple[Array, NDArray[np.bool_], Array] | None:
    """Return markers as if lips did not stop each other, which are measured, and closed gaps in mm.

    None without evidence that lips stop each other. touching: (n,), poses in which ladders, which
    close the lips in steps, showed contact; None: there are no ladders.
    """
    gaps = mouth.gaps
    seen_gaps_mm = gap_heights_mm(fit.seen_mm + fit.centre_mm, gaps)
    contact = touching
    if contact is None:
        contact = seen_gaps_mm[:, 0] < np.nanquantile(seen_gaps_mm[:, 0], _FIRST_CONTACT_SHARE)
    if contact.sum() < _LEAST_POSES or not np.isfinite(seen_gaps_mm).any(axis=0).all():
        return None
    # In turns: predict the lips of poses in contact, sort the poses by it, estimate the gaps anew.
    closed_mm, filled_mm = first_closed_mm(seen_gaps_mm, contact), fit.filled_mm
    for _ in range(_CONTACT_ROUNDS):
        # Heights of lips in contact are treated as lost, and predicted from all other poses.
        known = fit.known.copy()
        known[np.ix_(np.flatnonzero(contact), np.array(mouth.lips), np.array([1]))] = False
        filled_mm = fit.filled(known, filled_mm)
        expected_mm = fit.process_of(filled_mm).predict(fit.inputs)
        freed_mm = np.where(contact[:, None, None], filled_mm, expected_mm)
        free_gaps_mm = gap_heights_mm(freed_mm + fit.centre_mm, gaps)
        contact = np.asarray((free_gaps_mm < closed_mm).any(axis=1))
        if contact.sum() < _LEAST_POSES:
            return None
        closed_mm = touching_gaps_mm(seen_gaps_mm, free_gaps_mm, closed_mm)
    if touching is None and not is_stopped(seen_gaps_mm, free_gaps_mm, closed_mm):
        return None
    return filled_mm, known, closed_mm


def _left_out_rms_mm(fit: _FaceFit, from_centre_mm: Array, seen: NDArray[np.bool_]) -> float:
    """Return the cross-validated rms error in each axis, in mm, of the points that were `seen`."""
    off_mm = np.full_like(from_centre_mm, np.nan)
    folds = KFold(min(_FOLDS, len(off_mm)), shuffle=True, random_state=0)
    for rows, left_out in folds.split(off_mm):
        predicted_mm = fit.process_of(from_centre_mm, rows).predict(fit.inputs[left_out])
        off_mm[left_out] = predicted_mm - from_centre_mm[left_out]
    return float(np.sqrt(np.mean(off_mm[seen] ** 2)))
