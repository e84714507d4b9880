"""How well a measured calibration makes the shapes it was asked for, as far as the face is learnt.

On the learnt face, not the real one: what it got wrong everywhere alike does not show here. The
error of poses left out of its fit, noise included, is reported beside these.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.calibration import VisemeReach
from calibration.fit.correspondence import RobotMouth
from calibration.fit.retargeting import Retargeting
from calibration.hold_out import CLOSED_GAP_MM, HoldOutErrors, each_marker_rms_mm
from calibration.run.run_time_map import RunTimeMap
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.phonemes import VISEME_CLASSES

#: A shape counts as reachable when the best pose is within this, rms over the lips.
REACHABLE_MM = 0.5
#: AnimPhos looked at for each viseme class: their middle frames.
_FRAMES_PER_CLASS = 30


@dataclass(frozen=True, slots=True)
class ShapeErrors:
    """What shapes are measured with: the speaker, the mouth as learnt, what is aimed for."""

    model: FaceWithAnimPhos
    mouth: RobotMouth
    retargeting: Retargeting

    def best_deg(self, targets_mm: Array) -> Array:
        """(n, n_markers, 3) -> (n, n_servos): the poses that come nearest."""
        return self.mouth.nearest_deg(self.mouth.names.shape_features.of(targets_mm))

    def apart_mm(self, poses_deg: Array, targets_mm: Array) -> Array:
        """(n,): distance of the face's lips from the targets, rms over the lip markers."""
        lips = list(self.mouth.names.shape_features.lips)
        return lips_apart_mm(self.mouth.markers_of(poses_deg), targets_mm, lips)


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
    targets_mm = on.retargeting.targets_mm(from_rest)
    best_deg = on.best_deg(targets_mm)
    free_deg = run.free_deg(from_rest)
    poses_deg = on.mouth.kept_deg(free_deg)
    robot_mm = on.mouth.markers_of(poses_deg)
    human_gap_mm = np.array([on.model.lip_gap_mm(frame) for frame in held_out])
    gap_mm = _signed_gap_mm(on, robot_mm)
    closed = human_gap_mm <= CLOSED_GAP_MM
    moves = min(human_gap_mm.std(), gap_mm.std()) > 0.0
    return HoldOutErrors(
        n_frames=len(held_out),
        marker_rms_mm=_rms(np.linalg.norm(robot_mm - targets_mm, axis=2)),
        lip_rms_mm=_rms(on.apart_mm(poses_deg, targets_mm)),
        nearest_lip_rms_mm=_rms(on.apart_mm(best_deg, targets_mm)),
        gap_rms_mm=_rms(gap_mm - _signed_gap_mm(on, targets_mm)),
        gap_correlation=float(np.corrcoef(human_gap_mm, gap_mm)[0, 1]) if moves else 0.0,
        n_closures=int(closed.sum()),
        closed_gap_mm=max(0.0, float(np.quantile(gap_mm[closed], 0.95))) if closed.any() else 0.0,
        clipped_share=float((free_deg != poses_deg).any(axis=1).mean()),
        joint_rms_deg=tuple(_rms(column) for column in (poses_deg - best_deg).T),
        each_marker_rms_mm=each_marker_rms_mm(on.mouth.names.marker_names, robot_mm - targets_mm),
    )


def _coverage(on: ShapeErrors, run: RunTimeMap) -> dict[str, VisemeReach]:
    """By the first phoneme of each class the speaker ever said."""
    rows = {viseme[0]: _rows_of(on.model, viseme) for viseme in VISEME_CLASSES}
    rows = {viseme: chosen for viseme, chosen in rows.items() if len(chosen)}
    from_rest = on.model.animphos.samples[np.concatenate(list(rows.values())), 2] - on.model.rest
    targets_mm = on.retargeting.targets_mm(from_rest)
    best_mm = on.apart_mm(on.best_deg(targets_mm), targets_mm)
    off_mm = on.apart_mm(on.mouth.kept_deg(run.free_deg(from_rest)), targets_mm)
    reach: dict[str, VisemeReach] = {}
    begin = 0
    for viseme, chosen in rows.items():
        own = slice(begin, begin + len(chosen))
        reached = float((best_mm[own] <= REACHABLE_MM).mean())
        reach[viseme] = VisemeReach(reached, _rms(off_mm[own]))
        begin = own.stop
    return reach


def _rows_of(model: FaceWithAnimPhos, viseme: tuple[str, ...]) -> NDArray[np.int64]:
    """Some AnimPhos of a class, evenly from all it has."""
    rows = np.concatenate([model.animphos.of_phoneme(phoneme) for phoneme in viseme])
    if not len(rows):
        return rows
    some = np.linspace(0, len(rows) - 1, min(len(rows), _FRAMES_PER_CLASS)).astype(np.int64)
    return np.asarray(rows[some], dtype=np.int64)


def _signed_gap_mm(on: ShapeErrors, markers_mm: Array) -> Array:
    """(n,): height of the middle of the upper inner lip over the lower; below 0: pressed."""
    upper, lower = on.mouth.names.shape_features.gaps[0]
    return np.asarray(markers_mm[:, upper, 1] - markers_mm[:, lower, 1])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
