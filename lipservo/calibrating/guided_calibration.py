"""`lipservo calibrate guided`: a person moves the robot's mouth by keys into displayed shapes."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from calibration.capture.capture import Move
from calibration.fit.guided import (
    KEYS,
    GuidedSession,
    LandmarkPose,
    fit_guided,
    keep_poses,
    kept_poses,
    landmark_poses,
    start_session,
)
from calibration.mouth_servos import JointRange
from calibration.simulated.practice_robot import markers_of_face
from lipservo.calibrating.calibration_setup import CalibrationSetup, held_servos, today
from lipservo.calibrating.hand_poses import HAND_POSES, ROUNDED, WIDEST
from lipservo.calibrating.measured_calibration import CalibrationResult, Save, with_lags
from lipservo.runtime.servos.assembly import servo_memories
from lipservo.terminal.keys import read_key
from lipservo.terminal.output import MESSAGES
from lipservo.terminal.view import draw_mouth
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array

#: Joint degrees (n_servos,) -> markers (47, 3), where the robot's face can be drawn.
Drawn = Callable[[Array], Array]


def calibrate_by_eye(setup: CalibrationSetup, save: Save = lambda _: None) -> CalibrationResult:
    """Let a person make poses by keys, on the face's servos or simulated ones; fit a calibration.

    save: called with the calibration before the servos' lags are measured. Raises CalibrationError
    for too few poses.
    """
    model, joints = setup.model, setup.servos.joints
    if setup.settings.capabilities.in_memory:
        markers_of = markers_of_face(model.markers_mm(model.rest[None])[0], setup.servos)

        def drawn(positions_deg: Array) -> Array:
            return np.asarray(markers_of(positions_deg[None])[0])

        made_deg = guide(
            model, joints, lambda goal_deg: goal_deg, read_key, MESSAGES,
            keep=setup.keep, drawn=drawn,
        )  # fmt: skip
        return fit_by_eye(setup, made_deg)
    memories = servo_memories(setup.settings)
    with held_servos(setup) as robot:
        made_deg = guide(
            model, joints, robot.lead, lambda: robot.hold_while(read_key), MESSAGES, keep=setup.keep
        )
        result = fit_by_eye(setup, made_deg).with_memories(memories)
        save(result)
        return with_lags(setup, robot, result) if setup.lags else result


def hand_poses_by_keys(setup: CalibrationSetup) -> dict[str, Array]:
    """Let a person make the hand poses by keys, for servos that report no position.

    Returns (n_servos,) degrees by the name of the pose.
    """
    model = setup.model
    frames = {pose.name: pose.coefficients for pose in landmark_poses(model)}
    shown = {WIDEST: frames["open"], ROUNDED: frames["narrow"]}
    poses = [
        LandmarkPose(pose.name, pose.instruction, shown.get(pose.name, model.rest))
        for pose in HAND_POSES
    ]
    with held_servos(setup) as robot:
        return guide(
            model, setup.servos.joints, robot.lead, lambda: robot.hold_while(read_key), MESSAGES,
            keep=setup.keep, poses=poses,
        )  # fmt: skip


def fit_by_eye(setup: CalibrationSetup, made_deg: Mapping[str, Array]) -> CalibrationResult:
    """Fit a calibration to poses that a person made. Raises CalibrationError for too few.

    Parameters
    ----------
    setup : CalibrationSetup
        Model and servos.
    made_deg : Mapping[str, Array]
        (n_servos,) degrees by the name of the pose.

    Returns
    -------
    CalibrationResult
        The calibration, without errors in mm, as none are measured.
    """
    calibration = fit_guided(setup.model, setup.servos, made_deg, date=today())
    return CalibrationResult(calibration)


def guide(
    model: FaceWithAnimPhos,
    joints: Sequence[JointRange],
    move: Move,
    read_key: Callable[[], str],
    console: Console,
    *,
    keep: Path | None = None,
    drawn: Drawn | None = None,
    poses: Sequence[LandmarkPose] = (),
) -> dict[str, Array]:
    """Let a person make poses by keys (the landmark poses: open, wide, ...), and return them.

    The robot is in neutral afterwards. Every finished pose is written to `keep` at once; a later
    session continues from that file.

    Parameters
    ----------
    model : FaceWithAnimPhos
        Model of the face, with the landmark poses.
    joints : Sequence[JointRange]
        Joints with their ranges.
    move : Move
        Moves the robot to joint angles.
    read_key : Callable[[], str]
        Returns the next key.
    console,drawn : Console
        Where poses are shown; computes the simulated robot's markers to show (None: not shown).
    keep : Path | None
        File of the poses; None: they are not written.
    poses : Sequence[LandmarkPose]
        Other poses to be made; empty: the landmark poses.

    Returns
    -------
    dict[str, Array]
        (n_servos,) degrees by the name of the pose.
    """
    names = [joint.name for joint in joints]
    kept = {} if keep is None else kept_poses(names, keep)
    session = start_session(joints, poses or landmark_poses(model), kept)
    try:
        while not session.done:
            move(session.positions_deg)
            ascii_only = console.options.ascii_only
            console.print(_page(model, session, drawn, ascii_only=ascii_only))
            after = session.press(read_key())
            if keep is not None and len(after.made_deg) != len(session.made_deg):
                keep_poses(after.made_deg, names, keep)
            session = after
    finally:
        move(np.zeros(len(joints)))
    return dict(session.made_deg)


def _page(
    model: FaceWithAnimPhos, session: GuidedSession, drawn: Drawn | None, *, ascii_only: bool
) -> Group:
    pose = session.poses[session.pose]
    wanted_mm = model.markers_mm(pose.coefficients[None])[0]
    mouths = Table.grid(padding=(0, 3))
    row = [_mouth(model, wanted_mm, "yellow", ascii_only=ascii_only)]
    if drawn is not None:
        made_mm = drawn(session.positions_deg)
        row.append(_mouth(model, made_mm, "red", ascii_only=ascii_only))
    mouths.add_row(*row)
    servos = Table.grid(padding=(0, 2))
    for index, joint in enumerate(session.joints):
        mark = (">" if ascii_only else "▶") if index == session.servo else " "
        servos.add_row(mark, joint.name, f"{session.positions_deg[index]:6.1f} deg")
    keys = Text("   ".join(f"{key}: {what}" for key, what in KEYS.items()), style="dim")
    title = f"{session.pose + 1} of {len(session.poses)}, {pose.name}: {pose.instruction}"
    return Group(Text(title, style="bold"), mouths, servos, keys)


def _mouth(model: FaceWithAnimPhos, markers_mm: Array, style: str, *, ascii_only: bool) -> Text:
    rest_mm = model.markers_mm(model.rest[None])[0]
    return Text(
        "\n".join(draw_mouth(markers_mm, rest_mm, model.layout, ascii_only=ascii_only)), style=style
    )
