"""Calibrations led by a web page: poses made with sliders, and the progress of measured ones."""

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from calibration.fit.guided import (
    GuidedSession,
    keep_poses,
    kept_poses,
    landmark_poses,
    start_session,
)
from calibration.simulated.practice_robot import markers_of_face
from lipservo.calibrating.calibration_setup import (
    CHIRPS_S,
    CalibrationSetup,
    Watch,
    held_servos,
)
from lipservo.calibrating.guided_calibration import fit_by_eye
from lipservo.calibrating.measured_calibration import CalibrationResult, with_lags
from lipservo.runtime.servos.assembly import servo_memories
from lipservo.runtime.servos.held_face import HeldFace
from lipservo.terminal.page_line import END, Order, PageLine
from lipservo.terminal.view import lip_loops_mm
from lipsync.arrays import Array
from lipsync.markers import INNER_LIP, OUTER_LIP

_S_A_MINUTE: Final = 60.0


class PageWatch:
    """Callbacks that send a web page the progress of `calibrate measure`; `watch` has them all."""

    def __init__(self, page: PageLine, setup: CalibrationSetup) -> None:
        self._page = page
        self._names = setup.servos.names
        self._setup = setup
        self._chirps_s = CHIRPS_S * len(self._names) if setup.lags and setup.has_place else 0.0
        self._began_s = time.monotonic()
        self.watch = Watch(self.progress, self.arrived, self.seen)

    @cached_property
    def _reckoned_poses(self) -> int:
        return self._setup.for_machine().reckoned_poses

    def progress(self, what: str, done: int, total: int) -> None:
        """Send the page how many of the `total` poses or chirps (`what`) are done; minutes left."""
        spent_s = time.monotonic() - self._began_s
        if not done:
            self._began_s, spent_s = time.monotonic(), 0.0
        if what == "poses":
            total = max(self._reckoned_poses, done + 1)
            left_s = spent_s / done * (total - done) + self._chirps_s if done else None
        else:
            left_s = (total - done) * CHIRPS_S
        left_min = None if left_s is None else round(left_s / _S_A_MINUTE, 2)
        self._page.tell("progress", what=what, done=done, total=total, left_min=left_min)

    def arrived(self, reached_deg: Array) -> None:
        """Send the page the encoders' positions.

        Parameters
        ----------
        reached_deg : Array
            (n_servos,) degrees.
        """
        self._page.tell("arrived", deg=_by_name(self._names, reached_deg))

    def seen(self, marker_names: tuple[str, ...], markers_mm: Array) -> None:
        """Send the page the markers' x and y, and the loops that they form round the lips.

        Parameters
        ----------
        marker_names : tuple[str, ...]
            Names of n_markers markers.
        markers_mm : Array
            (n_markers, 3) mm, NaN where one is not seen.
        """
        points = [
            None if np.isnan(place).any() else [round(float(v), 1) for v in place]
            for place in markers_mm[:, :2]
        ]
        loops = [_loop("outer_lip", OUTER_LIP, marker_names)]
        loops.append(_loop("inner_lip", INNER_LIP, marker_names))
        self._page.tell("seen", names=marker_names, points=points, loops=loops)


def _loop(group: str, landmarks: Sequence[int], marker_names: Sequence[str]) -> list[int]:
    """Return the indices of a lip's markers in `marker_names`, in order round the lip.

    A marker's name is `group` and one of the `landmarks`.
    """
    names = [f"{group}_{landmark}" for landmark in landmarks]
    return [marker_names.index(name) for name in names if name in marker_names]


def calibrate_by_eye_on_page(
    setup: CalibrationSetup, page: PageLine, *, simulated: bool
) -> CalibrationResult:
    """Let a person make poses with a page's sliders, on the face's servos; fit a calibration.

    simulated: the page shows the robot's mouth too, computed from the servos' goals. Raises
    CalibrationError for too few poses.
    """
    memories = servo_memories(setup.settings)
    with held_servos(setup) as robot:
        made_deg = _guide(setup, robot, page, simulated=simulated)
        result = robot.hold_while(lambda: fit_by_eye(setup, made_deg)).with_memories(memories)
        return with_lags(setup, robot, result) if setup.lags else result


def _guide(
    setup: CalibrationSetup, robot: HeldFace, page: PageLine, *, simulated: bool
) -> dict[str, Array]:
    """Return the poses that a person makes on the page, (n_servos,) degrees by name.

    The servos are in neutral afterwards. simulated: the page shows the robot's computed mouth too.
    """
    model, joints, names = setup.model, setup.servos.joints, setup.servos.names
    kept = {} if setup.keep is None else kept_poses(names, setup.keep)
    session = start_session(joints, landmark_poses(model), kept)
    rest_mm = model.markers_mm(model.rest[None])[0]
    seen_of = markers_of_face(rest_mm, setup.servos) if simulated else None

    def loops(markers_mm: Array) -> list[list[list[float]]]:
        found = lip_loops_mm(markers_mm, rest_mm, model.layout)
        return [np.round(loop_mm, 2).tolist() for loop_mm in found]

    def show(session: GuidedSession) -> None:
        if session.done:
            return
        pose = session.poses[session.pose]
        made_mm = None if seen_of is None else seen_of(session.positions_deg[None])[0]
        page.tell(
            "eye",
            pose=session.pose,
            name=pose.name,
            instruction=pose.instruction,
            poses=[each.name for each in session.poses],
            made=list(session.made_deg),
            wanted=loops(model.markers_mm(pose.coefficients[None])[0]),
            robot=None if made_mm is None else loops(made_mm),
            goals_deg=_by_name(names, session.positions_deg),
        )

    try:
        while not session.done:
            robot.hold_while(partial(show, session))
            robot.lead(session.positions_deg)
            order = robot.hold_while(lambda: page.next_order() or END)
            after = _after(session, order, page)
            if setup.keep is not None and len(after.made_deg) != len(session.made_deg):
                keep_poses(after.made_deg, names, setup.keep)
            session = after
    finally:
        robot.lead(np.zeros(len(joints)))
    page.tell("fitting")
    return dict(session.made_deg)


def _after(session: GuidedSession, order: Order, page: PageLine) -> GuidedSession:
    """Return the session after the page's `order`: a key, or joints moved.

    After a move, the orders that wait are applied too: all moves, and the first key.
    """
    while (moved := order.get("move")) is not None:
        session = _moved(session, moved)
        following = page.next_order(0.0)
        if following is None:
            return session
        order = following
    key = order.get("key")
    if key == "b" and session.pose:
        session = session.press("b")
        made_deg = session.made_deg.get(session.poses[session.pose].name)
        return session if made_deg is None else replace(session, positions_deg=made_deg.copy())
    return session.press(str(key))


def _moved(session: GuidedSession, moved: object) -> GuidedSession:
    """Return the session with joints at the degrees `moved`, {name: angle}, clipped to limits.

    Invalid angles are skipped; `moved` is unchecked JSON.
    """
    positions_deg = session.positions_deg.copy()
    wanted = moved if isinstance(moved, dict) else {}
    for n, joint in enumerate(session.joints):
        deg = wanted.get(joint.name)
        if isinstance(deg, (int, float)) and np.isfinite(deg):
            positions_deg[n] = np.clip(deg, joint.min_deg, joint.max_deg)
    return replace(session, positions_deg=positions_deg)


def _by_name(names: Sequence[str], deg: Array) -> dict[str, float | None]:
    return {
        name: round(float(each), 1) if np.isfinite(each) else None
        for name, each in zip(names, deg, strict=True)
    }
