"""How well a measured calibration makes the shapes it was asked for, as far as the face is learnt.

On the learnt face, not the real one: what it got wrong everywhere alike does not show here. The
error of poses left out of its fit, noise included, is reported beside these.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.fit.correspondence import RobotMouth
from calibration.fit.gap_figures import gap_figures
from calibration.fit.lip_contact import gap_heights_mm
from calibration.fit.retargeting import Retargeting
from calibration.grade import VisemeReach
from calibration.hold_out import CLOSED_GAP_MM, HoldOutErrors, each_marker_rms_mm
from calibration.run.run_time_map import RunTimeMap
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.phonemes import VISEME_CLASSES

#: A shape counts as reached when opening and width of the best pose are within this.
REACHABLE_MM = 1.0
#: AnimPhos looked at for each viseme class: their middle frames.
_FRAMES_PER_CLASS = 30


@dataclass(frozen=True, slots=True)
class ShapeErrors:
    """What shapes are measured with: the speaker, the mouth as learnt, what is aimed for."""

    model: FaceWithAnimPhos
    mouth: RobotMouth
    retargeting: Retargeting

    def reached(self, from_rest: Array) -> NDArray[np.bool_]:
        """(n, n_components) -> (n,): whether the best pose has the opening and width asked for."""
        asked_mm, best_mm = self.openings_and_widths_mm(from_rest)
        return np.asarray((np.abs(best_mm - asked_mm) <= REACHABLE_MM).all(axis=1))

    def openings_and_widths_mm(self, from_rest: Array) -> tuple[Array, Array]:
        """(n, 2) asked for, and (n, 2) of the best poses."""
        right, left = self.mouth.names.corners
        poses_deg = self.retargeting.poses_deg(from_rest)
        copies_mm, gaps_mm = self.retargeting.copies_mm(from_rest)
        best_mm = self.mouth.markers_of(poses_deg)
        opening_mm = gap_heights_mm(best_mm, self.mouth.names.shape_features.gaps[:1])[:, 0]
        asked = [gaps_mm[:, 0, 1], copies_mm[:, left, 0] - copies_mm[:, right, 0]]
        best = [opening_mm, best_mm[:, left, 0] - best_mm[:, right, 0]]
        return np.stack(asked, axis=1), np.stack(best, axis=1)

    def apart_mm(self, poses_deg: Array, targets_mm: Array) -> Array:
        """(n,): distance of the face's lips from the targets, rms over the lip markers."""
        lips = list(self.mouth.names.shape_features.lips)
        return lips_apart_mm(self.mouth.seen_mm(poses_deg), targets_mm, lips)


def lips_apart_mm(markers_mm: Array, targets_mm: Array, lips: list[int]) -> Array:
    """(n, n_markers, 3) twice -> (n,): rms over the lip markers of their distance in space."""
    squares = np.sum((markers_mm - targets_mm)[:, lips] ** 2, axis=2)
    return np.asarray(np.sqrt(squares.mean(axis=1)))


def measure_shapes(
    on: ShapeErrors, run: RunTimeMap, held_out: Array
) -> tuple[HoldOutErrors, Mapping[str, VisemeReach]]:
    """Errors on held-out frames (n, n_components), and the coverage of every viseme class."""
    return _errors(on, run, held_out), _coverage(on, run)


def _errors(on: ShapeErrors, run: RunTimeMap, held_out: Array) -> HoldOutErrors:
    from_rest = held_out - on.model.rest
    best_deg = on.retargeting.poses_deg(from_rest)
    targets_mm = on.mouth.seen_mm(best_deg)
    free_deg = run.free_deg(from_rest)
    poses_deg = on.mouth.kept_deg(free_deg)
    robot_mm = on.mouth.seen_mm(poses_deg)
    human_gap_mm = on.model.lip_gaps_mm(on.model.markers_mm(held_out))
    gap_mm = _opening_mm(on, robot_mm)
    closed = human_gap_mm <= CLOSED_GAP_MM
    gaps = gap_figures(on.retargeting.asked_open_mm(from_rest)[:, 0], gap_mm, human_gap_mm)
    moves = min(human_gap_mm.std(), gap_mm.std()) > 0.0
    return HoldOutErrors(
        n_frames=len(held_out),
        marker_rms_mm=_rms(np.linalg.norm(robot_mm - targets_mm, axis=2)),
        lip_rms_mm=_rms(on.apart_mm(poses_deg, targets_mm)),
        nearest_lip_rms_mm=0.0,
        gap_rms_mm=_rms(gap_mm - _opening_mm(on, targets_mm)),
        gap_correlation=float(np.corrcoef(human_gap_mm, gap_mm)[0, 1]) if moves else 0.0,
        n_closures=int(closed.sum()),
        closed_gap_mm=gaps.closed_mm or 0.0,
        clipped_share=float((free_deg != poses_deg).any(axis=1).mean()),
        joint_rms_deg=tuple(_rms(column) for column in (poses_deg - best_deg).T),
        each_marker_rms_mm=each_marker_rms_mm(on.mouth.names.marker_names, robot_mm - targets_mm),
        gap_slope=gaps.slope,
        small_gaps_kept=gaps.small_kept,
    )


def _coverage(on: ShapeErrors, run: RunTimeMap) -> dict[str, VisemeReach]:
    """By the first phoneme of each class the speaker ever said.

    Within reach: opening and width of the best pose are those asked for.
    """
    rows = {viseme[0]: _rows_of(on.model, viseme) for viseme in VISEME_CLASSES}
    rows = {viseme: chosen for viseme, chosen in rows.items() if len(chosen)}
    from_rest = on.model.animphos.samples[np.concatenate(list(rows.values())), 2] - on.model.rest
    reached = on.reached(from_rest)
    targets_mm = on.retargeting.targets_mm(from_rest)
    free_deg = run.free_deg(from_rest)
    poses_deg = on.mouth.kept_deg(free_deg)
    off_mm = on.apart_mm(poses_deg, targets_mm)
    asked_mm = on.retargeting.asked_open_mm(from_rest)[:, 0]
    made_mm = _opening_mm(on, on.mouth.seen_mm(poses_deg))
    human_mm = on.model.lip_gaps_mm(on.model.markers_mm(from_rest + on.model.rest))
    at_limit = (free_deg != poses_deg).any(axis=1)
    reach: dict[str, VisemeReach] = {}
    begin = 0
    for viseme, chosen in rows.items():
        own = slice(begin, begin + len(chosen))
        gaps = gap_figures(asked_mm[own], made_mm[own], human_mm[own])
        reach[viseme] = VisemeReach(
            reachable=float(reached[own].mean()),
            off_mm=_rms(off_mm[own]),
            gap_slope=gaps.slope,
            closed_gap_mm=gaps.closed_mm,
            small_gaps_kept=gaps.small_kept,
            at_limit=float(at_limit[own].mean()),
        )
        begin = own.stop
    return reach


def _rows_of(model: FaceWithAnimPhos, viseme: tuple[str, ...]) -> NDArray[np.int64]:
    """Some AnimPhos of a class, evenly from all it has."""
    rows = np.concatenate([model.animphos.of_phoneme(phoneme) for phoneme in viseme])
    if not len(rows):
        return rows
    some = np.linspace(0, len(rows) - 1, min(len(rows), _FRAMES_PER_CLASS)).astype(np.int64)
    return np.asarray(rows[some], dtype=np.int64)


def _opening_mm(on: ShapeErrors, markers_mm: Array) -> Array:
    """(n,): how high the middle of the lips is open, from the robot's own closed gap on."""
    heights_mm = gap_heights_mm(markers_mm, on.mouth.names.shape_features.gaps[:1])[:, 0]
    return np.asarray(heights_mm - on.retargeting.closed_mm[0])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
