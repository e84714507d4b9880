"""The measured way from nothing to a capture: first the whole range, then what speech asks for.

Two thirds and more of the poses fill the range of every joint. What they teach says roughly which
poses speech will use; the rest are taken there, closed lips above all, so that the face is known
best where it is looked at most. Loads scikit-learn; the live path never does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sklearn.cluster import KMeans

from calibration.capture.capture import (
    Arrived,
    Capture,
    Measure,
    Move,
    Robot,
    gather,
    read_kept,
    take_poses,
)
from calibration.capture.capture_plan import PosePlan, joined, least_poses, plan_around, plan_poses
from calibration.coupling_rule import CouplingRule
from calibration.fit.correspondence import RobotMouth, correspond
from calibration.fit.measured import split_frames
from calibration.fit.retargeting import fit_retargeting
from calibration.fit.robot_face import fit_robot_face
from calibration.hold_out import CLOSED_GAP_MM
from calibration.joint_range import JointRange
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array

#: The part of a plan that is taken where speech will be, and the part of these with lips closed. On
#: development robots (seeds 106, 107, 116, 117) 16 of 60 poses took a quarter off the error of the
#: learnt face in speech, and half off that of closed lips; 8 closed ones of them were no better.
_SPEECH_SHARE, _CLOSED_SHARE = 0.27, 0.25
#: So many of the speaker's frames say well enough where speech is.
_FRAMES = 400


@dataclass(frozen=True, slots=True)
class Procedure:
    """What is captured: the speaker, the joints, how many poses, what must not go together."""

    model: FaceWithAnimPhos
    joints: Sequence[JointRange]
    n_poses: int
    rules: tuple[CouplingRule, ...] = ()
    seed: int = 0

    @property
    def n_of_speech(self) -> int:
        """Poses that are kept for where speech will be."""
        spare = self.n_poses - least_poses(len(self.joints))
        return max(0, min(round(_SPEECH_SHARE * self.n_poses), spare))

    def range_plan(self) -> PosePlan:
        """The poses that fill the range."""
        n_poses = self.n_poses - self.n_of_speech
        return plan_poses(self.joints, n_poses, rules=self.rules, seed=self.seed)

    def whole_range_plan(self) -> PosePlan:
        """All poses in the range: for who moves a robot by hand and comes back once."""
        return plan_poses(self.joints, self.n_poses, rules=self.rules, seed=self.seed)

    def speech_plan(self, capture: Capture, n_poses: int) -> PosePlan:
        """Poses where speech will be, by what a first capture teaches; whole degrees."""
        limits = (
            np.array([j.min_deg for j in self.joints]),
            np.array([j.max_deg for j in self.joints]),
        )
        face = fit_robot_face(capture)
        mouth = RobotMouth(
            face.markers_mm, correspond(capture.marker_names), limits, tuple(self.rules)
        )
        frames = split_frames(self.model, self.seed)[0]
        frames = frames[:: max(1, len(frames) // _FRAMES)]
        wanted_mm = fit_retargeting(self.model, frames, mouth).targets_mm(frames - self.model.rest)
        poses_deg = mouth.nearest_deg(mouth.names.shape_features.of(wanted_mm))
        gaps_mm = np.array([self.model.lip_gap_mm(frame) for frame in frames])
        closed = gaps_mm <= CLOSED_GAP_MM
        n_closed = round(_CLOSED_SHARE * n_poses) if closed.any() else 0
        goals_deg = np.concatenate(
            [
                _middles(poses_deg[closed], n_closed),
                _middles(poses_deg[~closed], n_poses - n_closed),
            ]
        )
        return plan_around(np.rint(goals_deg), self.joints, rules=self.rules, seed=self.seed)

    def capture(
        self,
        marker_names: tuple[str, ...],
        move: Move,
        measure: Measure,
        *,
        keep: Path | None = None,
        arrived: Arrived = lambda *_: None,
        progress: Callable[[int], None] = lambda _: None,
    ) -> Capture:
        """Both parts, one after the other; arguments as of `capture_poses`."""
        first = self.range_plan()
        on = Robot(move, measure, arrived, progress)
        kept = [] if keep is None else read_kept(keep, first, marker_names, goes_on=True)
        poses = take_poses(first, marker_names, on, kept, keep)
        captured = gather(first, marker_names, poses)
        if not self.n_of_speech:
            return captured
        whole = joined(first, self.speech_plan(captured, self.n_of_speech))
        kept = poses if keep is None else read_kept(keep, whole, marker_names)
        return gather(whole, marker_names, take_poses(whole, marker_names, on, kept, keep))


def _middles(poses_deg: Array, n: int) -> Array:
    """(n, n_servos): so many that every pose is near one of them."""
    if n == 0:
        return np.zeros((0, poses_deg.shape[1]))
    if len(poses_deg) <= n:
        return poses_deg
    return np.asarray(KMeans(n, n_init=4, random_state=0).fit(poses_deg).cluster_centers_)
