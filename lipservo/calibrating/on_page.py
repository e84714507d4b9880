"""Calibrations led by a web page: poses made with sliders, and the progress of measured ones."""

import time
from collections.abc import Sequence

import numpy as np

from calibration.fit.guided import GuidedSession
from calibration.simulated.practice_robot import markers_of_face
from lipservo.calibrating.calibration_setup import CHIRPS_S, CalibrationSetup, Watch
from lipservo.runtime.servos.held_face import HeldFace
from lipservo.terminal.page_line import END, Order, PageLine
from lipservo.terminal.view import lip_loops_mm
from lipsync.arrays import Array
from lipsync.markers import INNER_LIP, OUTER_LIP


class PageWatch:
    """Callbacks that send a web page the progress of `calibrate measure`; `watch` has them all."""

    def __init__(self, page: PageLine, setup: CalibrationSetup) -> None:
        self._page = page
        self._names = setup.servos.names
        machine = setup.for_machine()
        self._estimated_poses, self._pose_s = machine.estimated_poses, machine.pose_s
        self._chirps_s = machine.chirps_s
        self._began_s = time.monotonic()
        self._done = self._n_kept = 0
        self.watch = Watch(self.progress, self.arrived, self.seen)

    def progress(self, what: str, done: int, total: int) -> None:
        """Send the page how many of the `total` poses or chirps (`what`) are done; minutes left."""
        if not done or done > self._done + 1:  # poses of the file took no time
            self._began_s, self._n_kept = time.monotonic(), done
        self._done = done
        if what == "poses":
            total = max(self._estimated_poses, done + 1)
            n_new = done - self._n_kept
            pose_s = (time.monotonic() - self._began_s) / n_new if n_new else self._pose_s
            left_s = pose_s * (total - done) + self._chirps_s if done else None
        else:
            left_s = (total - done) * CHIRPS_S
        left_min = None if left_s is None else round(left_s / 60.0, 2)
        self._page.tell("progress", what=what, done=done, total=total, left_min=left_min)

    def arrived(self, reached_deg: Array) -> None:
        """Send the page the encoders' positions.

        Parameters
        ----------
        reached_deg : Array
            (n_servos,) degrees.
        """
        self._page.tell("arrived", deg=_rounded_by_name(self._names, reached_deg))

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
        loops = [_lip_loop_rows("outer_lip", OUTER_LIP, marker_names)]
        loops.append(_lip_loop_rows("inner_lip", INNER_LIP, marker_names))
        self._page.tell("seen", names=marker_names, points=points, loops=loops)


def _lip_loop_rows(group: str, landmarks: Sequence[int], marker_names: Sequence[str]) -> list[int]:
    """Return the indices of a lip's markers in `marker_names`, in order round the lip.

    A marker's name is `group` and one of the `landmarks`.
    """
    names = [f"{group}_{landmark}" for landmark in landmarks]
    return [marker_names.index(name) for name in names if name in marker_names]


class PageFront:
    """A front on a web page, whose sliders move the joints that `robot` holds.

    simulated: the page shows the robot's mouth too, computed from the servos' goals.
    """

    def __init__(
        self, setup: CalibrationSetup, page: PageLine, robot: HeldFace, *, simulated: bool
    ) -> None:
        self._model, self._page, self._robot = setup.model, page, robot
        self._names = setup.servos.names
        self._rest_mm = self._model.markers_mm(self._model.rest[None])[0]
        self._markers_of = markers_of_face(self._rest_mm, setup.servos) if simulated else None

    def show(self, session: GuidedSession) -> None:
        """Send the page the wanted mouth, the robot's, the poses made and the servos' goals."""
        self._robot.hold_while(lambda: self._send_pose(session))

    def after_order(self, session: GuidedSession) -> GuidedSession:
        """Return the session after the page's next order: a key, or joints moved.

        After a move, the orders that wait are applied too: all moves, and the first key.
        """
        order: Order | None = self._robot.hold_while(lambda: self._page.next_order() or END)
        while order is not None and (moved := order.get("move")) is not None:
            session = session.moved(moved if isinstance(moved, dict) else {})
            order = self._page.next_order(0.0)
        if order is not None:
            session = session.press(str(order.get("key")))
        if session.done:
            self._page.tell("fitting")
        return session

    def _send_pose(self, session: GuidedSession) -> None:
        """Send the page the present pose.

        Sent are its name, instruction, wanted mouth and servo goals in degrees, and the names of
        the poses that are made. The robot's own mouth is sent only if it is simulated, else None.
        """
        pose, goals_deg = session.poses[session.pose], session.positions_deg
        robot_mm = None if self._markers_of is None else self._markers_of(goals_deg[None])[0]
        self._page.tell(
            "eye",
            pose=session.pose,
            name=pose.name,
            instruction=pose.instruction,
            poses=[each.name for each in session.poses],
            made=list(session.made_deg),
            wanted=self._loops(self._model.markers_mm(pose.coefficients[None])[0]),
            robot=None if robot_mm is None else self._loops(robot_mm),
            goals_deg=_rounded_by_name(self._names, goals_deg),
        )

    def _loops(self, markers_mm: Array) -> list[list[list[float]]]:
        found = lip_loops_mm(markers_mm, self._rest_mm, self._model.layout)
        return [np.round(loop_mm, 2).tolist() for loop_mm in found]


def _rounded_by_name(names: Sequence[str], deg: Array) -> dict[str, float | None]:
    return {
        name: round(float(each), 1) if np.isfinite(each) else None
        for name, each in zip(names, deg, strict=True)
    }
