"""Poses made in a terminal: by keys on held servos, or with the fingers on limp ones."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from calibration.fit.guided import KEEP_KEYS, KEYS, GuidedSession, LandmarkPose, landmark_poses
from calibration.mouth_servos import MouthServos
from calibration.simulated.practice_robot import markers_of_face
from firmware_bridge.stopping import named_by_reason
from lipservo.calibrating.calibration_setup import CalibrationSetup, held_servos
from lipservo.calibrating.hand_poses import HAND_POSES, ROUNDED, WIDEST, beyond_limits
from lipservo.calibrating.measured_calibration import CalibrationResult, Save
from lipservo.calibrating.posing import calibrate_by_eye, fit_by_eye, make_poses
from lipservo.runtime.servos.limp_servos import READ_EVERY_S, LimpServos
from lipservo.terminal.keys import PressedKeys, read_key
from lipservo.terminal.output import MESSAGES
from lipservo.terminal.view import draw_mouth
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array

#: Joint degrees (n_servos,) -> markers (47, 3), where the robot's face can be drawn.
Drawn = Callable[[Array], Array]


def calibrate_by_keys(setup: CalibrationSetup, save: Save = lambda _: None) -> CalibrationResult:
    """Let a person make poses by keys, on the face's servos or simulated ones; fit a calibration.

    save: called with the calibration before the servos' lags are measured. Raises CalibrationError
    for too few poses.
    """
    model = setup.model
    if not setup.settings.capabilities.in_memory:
        return calibrate_by_eye(
            setup, lambda face: KeysFront(model, lambda: face.hold_while(read_key), MESSAGES), save
        )
    markers_of = markers_of_face(model.markers_mm(model.rest[None])[0], setup.servos)

    def drawn(positions_deg: Array) -> Array:
        return np.asarray(markers_of(positions_deg[None])[0])

    front = KeysFront(model, read_key, MESSAGES, drawn)
    poses, joints = landmark_poses(model), setup.servos.joints
    return fit_by_eye(setup, make_poses(joints, poses, front, lambda deg: deg, setup.keep))


def hand_poses_by_keys(setup: CalibrationSetup) -> dict[str, Array]:
    """Let a person make the hand poses by keys, for servos that report no position.

    Returns (n_servos,) degrees of each pose made, by its name.
    """
    model = setup.model
    speaker_frames = {pose.name: pose.coefficients for pose in landmark_poses(model)}
    frame_of_pose = {WIDEST: speaker_frames["open"], ROUNDED: speaker_frames["narrow"]}
    poses = [replace(p, coefficients=frame_of_pose.get(p.name, model.rest)) for p in HAND_POSES]
    return poses_by_keys(setup, poses)


def poses_by_keys(
    setup: CalibrationSetup,
    poses: Sequence[LandmarkPose],
    begin_deg: Mapping[str, Array] = MappingProxyType({}),
) -> dict[str, Array]:
    """Let a person make poses by keys, on the face's servos; begin_deg: as for `make_poses`.

    Returns
    -------
    dict[str, Array]
        (n_servos,) degrees of each pose made, by its name.
    """
    joints = setup.servos.joints
    with held_servos(setup) as robot:
        front = KeysFront(setup.model, lambda: robot.hold_while(read_key), MESSAGES)
        return make_poses(joints, poses, front, robot.lead, setup.keep, begin_deg=begin_deg)


class KeysFront:
    """A front of a terminal: the wanted mouth is drawn, and keys turn the joints.

    drawn: markers by angles, to draw the robot's mouth; None: it is not drawn.
    """

    def __init__(
        self,
        model: FaceWithAnimPhos,
        read_key: Callable[[], str],
        console: Console,
        drawn: Drawn | None = None,
    ) -> None:
        """Store where to draw mouths and from where keys come.

        model: of the speaker, whose mouth is drawn; drawn: from joint degrees (n_servos,) to the
        robot's markers (47, 3) in mm, None: its mouth is not drawn.
        """
        self._model, self._read_key = model, read_key
        self._console, self._robot_markers_of = console, drawn

    def show(self, session: GuidedSession) -> None:
        """Print the speaker's mouth, the robot's if it can be drawn, the joints and the keys."""
        ascii_only, pose = self._console.options.ascii_only, session.poses[session.pose]
        mouths = Table.grid(padding=(0, 3))
        row = [self._mouth(self._model.markers_mm(pose.coefficients[None])[0], "yellow")]
        if self._robot_markers_of is not None:
            row.append(self._mouth(self._robot_markers_of(session.positions_deg), "red"))
        mouths.add_row(*row)
        cursor = ">" if ascii_only else "\u25b6"
        joints = [
            (
                cursor if n == session.servo else " ",
                joint.name,
                f"{session.positions_deg[n]:6.1f} deg",
            )
            for n, joint in enumerate(session.joints)
        ]
        keys = Text("   ".join(f"{key}: {what}" for key, what in KEYS.items()), style="dim")
        self._console.print(_pose_screen(session, mouths, joints, keys))

    def after_order(self, session: GuidedSession) -> GuidedSession:
        """Return the session after the next key."""
        return session.press(self._read_key())

    def _mouth(self, markers_mm: Array, style: str) -> Text:
        model, ascii_only = self._model, self._console.options.ascii_only
        rest_mm = model.markers_mm(model.rest[None])[0]
        lines = draw_mouth(markers_mm, rest_mm, model.layout, ascii_only=ascii_only)
        return Text("\n".join(lines), style=style)


_LIMP_KEYS = "space or Enter: keep   x: leave this pose out   b: back   q: stop"
_BAR_LENGTH = 31


class LimpFront:
    """A front of a terminal for limp servos, whose pose under the fingers is read until a key.

    mouth: the joints of the servos. live: shows the joints. undivided: a context in which no signal
    interrupts.
    """

    def __init__(
        self,
        servos: LimpServos,
        mouth: MouthServos,
        keys: PressedKeys,
        live: Live,
        undivided: Callable[[], AbstractContextManager[object]],
    ) -> None:
        """Store the limp servos, and how their poses are shown and kept.

        mouth: the joints of the servos; keys: what the person presses; live: shows the joints;
        undivided: a context in which no signal interrupts.
        """
        self._servos, self._mouth, self._keys = servos, mouth, keys
        self._live, self._undivided = live, undivided
        self._note = ""

    def show(self, session: GuidedSession) -> None:
        """Show where the joints are, and why the last pose was not kept."""
        with self._undivided():
            read = self._servos.read_pose()
        outside = beyond_limits(self._mouth, read.positions_deg)
        rows = []
        for n, joint in enumerate(self._mouth.joints):
            angle_deg, is_outside = float(read.positions_deg[n]), joint.name in outside
            why = read.obstacles.get(joint.name, "outside its limits" if is_outside else "")
            bar = _position_bar(angle_deg, joint.min_deg, joint.max_deg)
            rows.append((joint.name, f"{angle_deg:7.1f} deg", bar, Text(why, style="bold yellow")))
        note, keys = Text(self._note, style="yellow"), Text(_LIMP_KEYS, "dim")
        self._live.update(_pose_screen(session, None, rows, note, keys), refresh=True)

    def after_order(self, session: GuidedSession) -> GuidedSession:
        """Return the session after the next key, with the steady pose of the servos if kept.

        A pose that is unsteady, unread or outside limits is not kept; the reason is printed.
        """
        key = self._keys.next_key(READ_EVERY_S)
        if key is None or key not in (*KEEP_KEYS, "x", "b", "q"):
            return session
        self._note = ""
        if key in KEEP_KEYS:
            with self._undivided():
                steady = self._servos.steady_pose()
            obstacles = steady.obstacles | beyond_limits(self._mouth, steady.positions_deg)
            if obstacles:
                name = session.poses[session.pose].name
                self._note = f"{name} is not kept: {named_by_reason(obstacles)}"
                self._live.console.print(self._note, soft_wrap=True, highlight=False)
                return session
            session = replace(session, positions_deg=steady.positions_deg)
        return session.press(key)


def _pose_screen(
    session: GuidedSession,
    mouths: RenderableType | None,
    joints: Iterable[Sequence[RenderableType]],
    *last_lines: Text,
) -> Group:
    """Return the pose to make, pictures of mouths, a row for each joint, and the last lines.

    mouths: None: no pictures. joints: cells of each row.
    """
    pose = session.poses[session.pose]
    table = Table.grid(padding=(0, 2))
    for row in joints:
        table.add_row(*row)
    title = f"{session.pose + 1} of {len(session.poses)}, {pose.name}: {pose.instruction}"
    pictures = () if mouths is None else (mouths,)
    return Group(Text(title, style="bold"), *pictures, table, *last_lines)


def _position_bar(angle_deg: float, min_deg: float, max_deg: float) -> str:
    """Return an ASCII bar from `min_deg` to `max_deg` with a mark at `here_deg`; NaN: no mark."""
    if not np.isfinite(angle_deg) or max_deg <= min_deg:
        return "." * _BAR_LENGTH
    share = (angle_deg - min_deg) / (max_deg - min_deg)
    position = round(float(np.clip(share, 0.0, 1.0)) * (_BAR_LENGTH - 1))
    return "." * position + "o" + "." * (_BAR_LENGTH - 1 - position)
