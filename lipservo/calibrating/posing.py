"""Poses that a person makes one after another: the one session behind every way by hand.

A front shows a pose and takes an order: keys in a terminal, sliders of a page, or fingers on limp
servos. Each kept pose is stored at once, so that the same command goes on from it.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np

from calibration.fit.guided import (
    GuidedSession,
    LandmarkPose,
    fit_guided,
    keep_poses,
    kept_poses,
    landmark_poses,
    start_session,
)
from calibration.mouth_servos import JointRange
from lipservo.calibrating.calibration_setup import CalibrationSetup, held_servos, today
from lipservo.calibrating.measured_calibration import CalibrationResult, Save, with_lags
from lipservo.runtime.servos.assembly import servo_memories
from lipservo.runtime.servos.held_face import HeldFace
from lipsync.arrays import Array


class Front(Protocol):
    """What a person sees of a session, and orders it by."""

    def show(self, session: GuidedSession) -> None:
        """Show the pose to make, and where the joints are."""

    def after_order(self, session: GuidedSession) -> GuidedSession:
        """Return the session after the person's next order."""


def make_poses(
    joints: Sequence[JointRange],
    poses: Sequence[LandmarkPose],
    front: Front,
    lead: Callable[[Array], object],
    keep: Path | None,
    undivided: Callable[[], AbstractContextManager[object]] = nullcontext,
    begin_deg: Mapping[str, Array] = MappingProxyType({}),
) -> dict[str, Array]:
    """Let a person make poses through a front until all are made or the person stops.

    Parameters
    ----------
    joints : Sequence[JointRange]
        The n_servos joints.
    poses : Sequence[LandmarkPose]
        The poses to make.
    front : Front
        Shows the session and takes orders.
    lead : Callable[[Array], object]
        Takes the joints to angles (n_servos,) in degrees; to 0 at the end.
    keep : Path | None
        The file of each pose made; None: they are not stored.
    undivided : Callable[[], AbstractContextManager[object]]
        A context in which no signal interrupts the writing of the file.
    begin_deg : Mapping[str, Array]
        (n_servos,) degrees at which poses begin, by their names; others where the joints are.

    Returns
    -------
    dict[str, Array]
        (n_servos,) degrees of each pose, by its name.
    """
    joint_names = [joint.name for joint in joints]
    session, begun = start_session(joints, poses, kept_poses(joint_names, keep)), -1
    try:
        while not session.done:
            name = session.poses[session.pose].name
            if session.pose != begun and name in begin_deg and name not in session.made_deg:
                begin = zip(joint_names, begin_deg[name].tolist(), strict=True)
                session = session.moved(dict(begin))
            begun = session.pose
            lead(session.positions_deg)
            front.show(session)
            new_session = front.after_order(session)
            if keep is not None and new_session.made_deg is not session.made_deg:
                with undivided():
                    keep_poses(new_session.made_deg, joint_names, keep)
            session = new_session
    finally:
        lead(np.zeros(len(joints)))
    return dict(session.made_deg)


def calibrate_by_eye(
    setup: CalibrationSetup,
    make_front: Callable[[HeldFace], Front],
    save: Save = lambda _: None,
) -> CalibrationResult:
    """Let a person match the speaker's shapes on the face's held servos; fit a calibration.

    make_front: makes what shows the poses and takes orders, from the held servos. save: called
    with the calibration before the servos' lags are measured. Raises CalibrationError for too few
    poses.
    """
    memories = servo_memories(setup.settings)
    with held_servos(setup) as robot:
        poses, joints = landmark_poses(setup.model), setup.servos.joints
        made_deg = make_poses(joints, poses, make_front(robot), robot.lead, setup.keep)
        result = robot.hold_while(lambda: fit_by_eye(setup, made_deg)).with_memories(memories)
        save(result)
        return with_lags(setup, robot, result) if setup.lags else result


def fit_by_eye(setup: CalibrationSetup, made_deg: Mapping[str, Array]) -> CalibrationResult:
    """Fit a calibration to poses that a person made. Raises CalibrationError for too few.

    Parameters
    ----------
    setup : CalibrationSetup
        The face and its servos.
    made_deg : Mapping[str, Array]
        (n_servos,) degrees of each pose, by its name.
    """
    return CalibrationResult(fit_guided(setup.model, setup.servos, made_deg, date=today()))
