"""The capture of a measured calibration: the range of every joint first, then poses of speech.

Two thirds and more of the poses fill the range of every joint. The face learnt from them shows
roughly which poses speech will use; the rest are taken there, closed lips above all, so that the
face is known best where speech needs it. At the end the first poses are taken again, which shows
what slipped, tore or was moved meanwhile. Loads scikit-learn; the live path never does.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from calibration.calibration import CalibrationError, CouplingRule
from calibration.capture.attitude import attitude_of
from calibration.capture.capture import (
    NOT_KEPT,
    Capture,
    CapturedPose,
    KeptPoses,
    PosePlan,
    Robot,
    gather,
    joined,
    plan_around,
    plan_of_poses,
    plan_poses,
    plan_rows,
    stalled_joint,
    take_poses,
    usual_poses,
)
from calibration.capture.joint_health import (
    MOST_FRAMES,
    doubtful_joints,
    extra_poses,
    unseen_alone,
)
from calibration.capture.repeated_poses import poses_to_repeat
from calibration.capture.sanity import CheckedCapture, check_capture, check_frame
from calibration.capture.swaps import retake_swaps
from calibration.fit.closing import (
    FIRST_STEPS,
    MORE_STEPS,
    MOST_STEPS,
    N_SHAPES,
    Ladder,
    plan_ladders,
    read_ladders,
)
from calibration.fit.measured import MeasuredFit, mouth_of, retargeting_of, split_frames
from calibration.fit.measured_grade import N_GRADED, graded, graded_poses
from calibration.fit.retargeting import Retargeting, correspond, gap_heights_mm, widest_pose_deg
from calibration.fit.robot_face import RobotFace, fit_robot_face
from calibration.mouth_servos import JointRange, MouthServos
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array

#: The part of a plan that is taken where speech will be, and the part of these with lips closed. On
#: development robots (seeds 106, 107, 116, 117) 16 of 60 poses took a quarter off the error of the
#: learnt face in speech, and half off that of closed lips; 8 closed ones of them were no better.
_SPEECH_SHARE, _CLOSED_SHARE = 0.27, 0.375
#: Lips are closed step by step, from a little open to past where they stop: about the closed gap
#: where the first poses told of it, else from the neutral's gap on down.
_ABOUT_CLOSED_MM, _FROM_NEUTRAL_MM = (0.8, -1.2), (0.3, -2.8)
#: So many of the speaker's frames say well enough where speech is.
_FRAMES = 400


#: Captures the poses missing from a plan, of which it may leave out the `pressing` ones, given
#: second, once a servo is strained; gives back the whole capture.
_Take = Callable[..., Capture]


@dataclass(frozen=True, slots=True)
class _Learnt:
    """The face learnt from a first capture, by which poses of speech are chosen.

    from_rest: (n, n_components), frames of speech from which they are chosen.
    """

    face: RobotFace
    retargeting: Retargeting
    from_rest: Array


def machine_poses(n_wanted: int, n_servos: int) -> int:
    """Return how many poses a machine takes: `n_wanted`, or more if the joints need more.

    So many that every joint is alone from both sides and that poses of speech, closing steps and
    repeats follow.
    """
    return max(n_wanted, math.ceil(usual_poses(n_servos) / (1.0 - _SPEECH_SHARE)))


@dataclass(frozen=True, slots=True)
class Procedure:
    """The settings of a measured capture: the speaker, the joints, number of poses, coupling rules.

    seed: of poses and frames; positive: one word per joint for its positive angle, so that reversed
    joints are found before speech is captured; accept: doubts about size and joints become
    warnings.
    """

    model: FaceWithAnimPhos
    joints: Sequence[JointRange]
    n_poses: int
    rules: tuple[CouplingRule, ...] = ()
    seed: int = 0
    positive: tuple[str, ...] = ()
    accept: bool = False

    @property
    def n_of_speech(self) -> int:
        """The number of poses reserved for speech; 0 where every pose is needed for the range."""
        spare = self.n_poses - usual_poses(len(self.joints))
        return max(0, min(round(_SPEECH_SHARE * self.n_poses), spare))

    def range_plan(self) -> PosePlan:
        """Return the plan of the poses that fill the joints' ranges, without those of speech."""
        n_poses = self.n_poses - self.n_of_speech
        return plan_poses(self.joints, n_poses, rules=self.rules, seed=self.seed)

    @property
    def n_usual_more(self) -> int:
        """How many poses usually follow the `n_poses`: closing steps, repeats, those to grade."""
        return N_SHAPES * FIRST_STEPS + len(poses_to_repeat(self.range_plan())) + N_GRADED

    def whole_range_plan(self) -> PosePlan:
        """Return a plan of all `n_poses` poses in the joints' ranges, for a capture by files.

        The first ones are repeated at the end, except where all poses are needed for the range.
        """
        plan = plan_poses(self.joints, self.n_poses, rules=self.rules, seed=self.seed)
        return joined(plan, poses_to_repeat(plan)) if self.n_of_speech else plan

    def further_plan(
        self, capture: Capture, positive: Sequence[str], *, accept: bool
    ) -> tuple[PosePlan, tuple[str, ...]]:
        """Return the plan to capture next, after a capture read from files, and messages about it.

        Joints that may be dead, but not those with an empty word in `positive`, are captured again
        alone, before poses of speech. Raises CalibrationError for a capture with faults, as
        `check_capture` finds them.
        """
        unsure = [j for j in unseen_alone(capture) if not positive or positive[j]]
        if unsure:
            extras = extra_poses(self.joints, unsure, rules=self.rules)
            names = ", ".join(repr(self.joints[joint].name) for joint in unsure)
            reason = (
                f"the markers hardly tell yet what {names} does: {len(extras)} poses in which it "
                "moves alone; record them and refine once more"
            )
            return extras, (reason,)
        checked = check_capture(capture, self.model, positive, accept=accept)
        return self.speech_plan(checked, max(1, self.n_of_speech)), checked.warnings

    def speech_plan(self, checked: CheckedCapture, n_poses: int) -> PosePlan:
        """Return a plan of `n_poses` poses of speech, in whole degrees.

        They are chosen by the face that is learnt from `checked`, a capture of the joints' ranges.
        First come poses that close the lips in steps, then the widest opening, then centres of the
        speaker's other mouth shapes.
        """
        with threadpool_limits(limits=1):  # as `fit_measured`
            learnt = self._learn_face(checked.capture, checked.still)
            retargeting, from_rest = learnt.retargeting, learnt.from_rest
            mouth, face = retargeting.mouth, learnt.face
            closed = retargeting.closing(from_rest) >= 1.0
            n_closed = self._n_closed(n_poses) if closed.any() else 0
            usual_closed = np.median(from_rest[closed], axis=0)[None] if n_closed else from_rest[:1]
            heights_mm = _closing_heights_mm(retargeting, face.contact is not None, n_closed)
            # One pose with the widest opening: the robot's scale is better learnt from seeing it
            # than from extrapolation.
            n_widest = int(n_poses > n_closed)
            n_others = n_poses - n_closed - n_widest
            goals_deg = np.concatenate(
                [
                    *(retargeting.at_gap(usual_closed, height_mm) for height_mm in heights_mm),
                    np.repeat(widest_pose_deg(mouth)[None], n_widest, axis=0),
                    _centre_poses(retargeting.poses_deg(from_rest[~closed]), n_others),
                ]
            )
            return plan_around(np.rint(goals_deg), self.joints, rules=self.rules, seed=self.seed)

    def _learn_face(self, capture: Capture, still: Sequence[int]) -> "_Learnt":
        """Learn the face from a capture; return it with some of the speaker's frames of speech.

        still: numbers of joints that stay at 0.
        """
        names = correspond(capture.marker_names)
        face = fit_robot_face(capture, names.shape_features)
        servos = MouthServos(tuple(self.joints), rules=tuple(self.rules)).holding(still)
        mouth = mouth_of(face, names, servos)
        frames = split_frames(self.model, self.seed)[0]
        frames = frames[:: max(1, len(frames) // _FRAMES)]
        retargeting = retargeting_of(self.model, mouth, face, capture)
        return _Learnt(face, retargeting, frames - self.model.rest)

    def _n_closed(self, n_poses: int) -> int:
        """Return how many of `n_poses` poses of speech, the first ones, close the lips in steps."""
        return round(_CLOSED_SHARE * n_poses)

    def capture(
        self,
        marker_names: tuple[str, ...],
        robot: Robot,
        *,
        kept: KeptPoses = NOT_KEPT,
        report: Callable[[str], None] = lambda _: None,
    ) -> Capture:
        """Capture range, speech and ladders, and repeat the first poses; return the capture.

        Ladders are poses that close the lips step by step. Axes and size are checked by the first
        pose. Added to the `n_poses` are: a joint that may be dead, alone once more; the first part
        of the plan, at the end; each pose in which the tracker exchanged two names, again. kept:
        file of poses, from which an interrupted capture is resumed; report: called with lines for
        the user. Once a servo is strained, lips are closed no farther. Raises CalibrationError for
        a capture with faults, and at once where a marker that poses of speech need is missing.
        """
        if self.n_of_speech:
            correspond(marker_names)
        poses: list[CapturedPose] = []
        left_out: set[int] = set()
        # Rows are taken in order: one that the file lacks before its last was left out.
        last_kept = max(kept.markers_mm(), default=-1)

        def take(plan: PosePlan, pressing: Sequence[int] = (), on: Robot = robot) -> Capture:
            # Capture what `poses`, or the file, lacks of the plan; return all of it.
            earlier = poses if kept.path is None else kept.read(plan, marker_names)
            done = {pose.index for pose in earlier}
            left_out.update(row for row in pressing if row < last_kept and row not in done)
            poses[:] = take_poses(plan, marker_names, on, earlier, kept, pressing, left_out)
            poses[:] = retake_swaps(plan, marker_names, robot, poses, kept, report)
            return gather(plan, marker_names, poses)

        plan = self.range_plan()

        def stands(row: int, reached_deg: Array) -> None:
            # Before the pose is recorded or kept: the next run would go on with it.
            if (stall := stalled_joint(plan, row, reached_deg)) is not None:
                raise CalibrationError(f"{stall}; free that joint and check its torque")
            robot.arrived(row, reached_deg)

        # First neutral alone: wrong axes or units show before the robot moves on.
        take(plan_rows(plan, [0]), on=replace(robot, arrived=stands))
        check_frame(marker_names, poses[0].markers_mm, self.model, accept=self.accept)
        captured = take(plan)
        # Joints that may be dead are captured alone, a few times at most, until that is clear.
        doubtful = doubtful_joints(captured)
        for _ in range(MOST_FRAMES):
            if not doubtful:
                break
            names = ", ".join(repr(self.joints[joint].name) for joint in doubtful)
            extras = extra_poses(self.joints, doubtful, rules=self.rules)
            report(f"the markers hardly tell yet what {names} does: {len(extras)} poses more")
            plan = joined(plan, extras)
            captured = take(plan)
            doubtful = doubtful_joints(captured, doubtful)
        if not self.n_of_speech:
            return captured
        checked = check_capture(captured, self.model, self.positive, accept=self.accept)
        # Rows of the plan that close the lips: the first of the poses of speech.
        pressing = range(len(plan), len(plan) + self._n_closed(self.n_of_speech))
        plan = joined(plan, self.speech_plan(checked, self.n_of_speech))
        straightened = attitude_of(captured, self.positive).straightened
        captured = straightened(take(plan, pressing))
        plan = self._with_ladders(
            plan, captured, checked.still, lambda *poses: straightened(take(*poses))
        )
        return take(joined(plan, poses_to_repeat(self.range_plan())))

    def _with_ladders(
        self, plan: PosePlan, captured: Capture, still: Sequence[int], take: _Take
    ) -> PosePlan:
        """Capture ladders by `take` until lips are seen to meet or joints are at limits.

        Ladders are poses that close the lips step by step. captured: of `plan` so far; still:
        numbers of dead joints. Return the plan with the ladders appended; unchanged for a speaker
        with lips that never close.
        """
        with threadpool_limits(limits=1):
            learnt = self._learn_face(captured, still)
            is_closed = learnt.retargeting.closing(learnt.from_rest) >= 1.0
            if not is_closed.any():
                return plan
            ladders = plan_ladders(learnt.retargeting, learnt.from_rest[is_closed], MOST_STEPS)
        first_row, n_done = len(plan), 0
        for until in range(FIRST_STEPS, MOST_STEPS + 1, MORE_STEPS):
            for number, ladder in enumerate(ladders):
                if len(ladder.goals_deg) > n_done:
                    plan = joined(plan, self._ladder_plan(ladder, number + 1, slice(n_done, until)))
            # All ladders go on together, some steps at a time.
            captured = take(plan, range(first_row, len(plan)))
            n_done = until
            seen = read_ladders(captured, learnt.face.free_mm, learnt.face.noise_mm)
            if seen is None or seen.meet or all(len(each.goals_deg) <= n_done for each in ladders):
                break
        return plan

    def _ladder_plan(self, ladder: Ladder, number: int, steps: slice) -> PosePlan:
        """Return a plan of some steps of a ladder, all marked with its `number`, counted from 1.

        steps: slice of the ladder's poses. Joints come from the ladder's own sides.
        """
        goals_deg = ladder.goals_deg[steps]
        sides = np.tile(ladder.from_below, (len(goals_deg), 1))
        plan = plan_of_poses(self.joints, goals_deg, sides, self.rules)
        return replace(plan, ladders=np.full(len(goals_deg), number, dtype=np.int64))


def take_grade(
    fit: MeasuredFit,
    servos: MouthServos,
    marker_names: tuple[str, ...],
    robot: Robot,
    kept: KeptPoses = NOT_KEPT,
    n_captured: int = 0,
) -> MeasuredFit:
    """Move the robot to ten poses of speech, measure them, and return the fit with its grade.

    kept: file of poses, in which these come after the `n_captured` poses of the capture; `arrived`
    of the robot gets their numbers there.
    """
    wanted = graded_poses(fit, servos)
    plan = wanted.plan
    kept = kept.after(n_captured, plan)
    numbered = replace(robot, arrived=lambda row, deg: robot.arrived(kept.first + row, deg))
    poses = take_poses(plan, marker_names, numbered, kept.read(plan, marker_names), kept)
    poses = retake_swaps(plan, marker_names, numbered, poses, kept, expected_mm=wanted.targets_mm)
    calibration, remarks = graded(fit.calibration, wanted, gather(plan, marker_names, poses))
    return replace(fit, calibration=calibration, warnings=(*fit.warnings, *remarks))


def _closing_heights_mm(retargeting: Retargeting, known: bool, n: int) -> list[float]:
    """Return `n` falling heights of the middle lip gap for poses that close the lips in steps.

    known: whether contact was found; then they lie about its gap, else go down from neutral's.
    """
    neutral_mm = retargeting.mouth.neutral_mm()[None]
    gaps = retargeting.mouth.names.shape_features.gaps
    base_mm = float(retargeting.closed_mm[0] if known else gap_heights_mm(neutral_mm, gaps)[0, 0])
    return [
        base_mm + off for off in np.linspace(*(_ABOUT_CLOSED_MM if known else _FROM_NEUTRAL_MM), n)
    ]


def _centre_poses(poses_deg: Array, n: int) -> Array:
    """Return up to `n` poses, (n, n_servos) degrees, so that each of poses_deg is near one of them.

    They are the centres of k-means, or poses_deg itself if these are `n` or fewer.
    """
    if n == 0:
        return np.zeros((0, poses_deg.shape[1]))
    if len(poses_deg) <= n:
        return poses_deg
    return np.asarray(KMeans(n, n_init=4, random_state=0).fit(poses_deg).cluster_centers_)
