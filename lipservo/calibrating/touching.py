"""`calibrate touch`: close the lips in steps, and set anew where a calibration has them meet."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from calibration.calibration import (
    Calibration,
    CalibrationError,
    check_calibration,
    check_servo_memories,
)
from calibration.capture.capture import (
    CapturedPose,
    PosePlan,
    Robot,
    gather,
    ladders_of,
    take_poses,
)
from calibration.capture.trackers import FileTracker, Tracker
from calibration.fit.touch import touch_plan, touched_by_current, touched_by_eye, touched_by_markers
from lipservo.calibrating.calibration_setup import CalibrationSetup, held_servos, progress_bar
from lipservo.calibrating.measured_calibration import strained_servo
from lipservo.runtime.servos.assembly import servo_memories
from lipservo.runtime.servos.held_face import HeldFace
from lipservo.terminal.output import MESSAGES
from lipsync.arrays import Array


@dataclass(slots=True)
class _Efforts:
    """A tracker without markers that records the mouth servos' loads in each pose of a capture."""

    face: HeldFace
    seen: list[Array] = field(default_factory=list)
    marker_names: tuple[str, ...] = ()

    def arrived(self, _pose: int, _reached_deg: Array) -> None:
        """Do nothing: loads are read by `measure`."""

    def measure(self) -> Array:
        """Record the servos' present loads, in stall torques; return no markers, (0, 3)."""
        self.seen.append(self.face.effort)
        return np.zeros((0, 3))


def touch_by_markers(
    setup: CalibrationSetup,
    calibration: Calibration,
    make_tracker: Callable[[HeldFace], Tracker],
) -> tuple[Calibration, float]:
    """Close the lips in steps; correct by markers the contact of the lips in the calibration.

    make_tracker: makes the source of markers from held servos. Returns the new calibration, and how
    many mm later its lips meet than before. Raises CalibrationError.
    """
    plan = _checked_touch_plan(setup, calibration)
    with held_servos(setup) as face:
        tracker = make_tracker(face)
        try:
            poses = _take_pressing_poses(setup, face, plan, tracker)
        finally:
            if isinstance(tracker, FileTracker):
                tracker.close()
    return touched_by_markers(calibration, gather(plan, tracker.marker_names, poses))


def touch_by_current(
    setup: CalibrationSetup, calibration: Calibration
) -> tuple[Calibration, float]:
    """Close the lips in steps; correct by motor current the contact of the lips in the calibration.

    Returns the new calibration, and how many mm later its lips meet than before. Raises
    CalibrationError for servos that measure no current, or if one reaches its `max_current_ma`.
    """
    plan = _checked_touch_plan(setup, calibration)
    with held_servos(setup) as face:
        efforts = _Efforts(face)
        poses = _take_pressing_poses(setup, face, plan, efforts)
    if len(poses) < len(plan):
        raise CalibrationError("the lips did not close: a servo drew its max_current_ma before")
    return touched_by_current(calibration, plan, np.array(efforts.seen))


def touch_by_eye(
    setup: CalibrationSetup, calibration: Calibration, read_key: Callable[[], str]
) -> tuple[Calibration, float]:
    """Close the lips until a person sees them meet; correct the contact in the calibration.

    Enter: the lips just meet; `q`: give up; any other key: close by a step. Returns the new
    calibration, and how many mm later its lips meet than before. Raises CalibrationError unless the
    lips met in every shape.
    """
    plan = _checked_touch_plan(setup, calibration)
    ladder_numbers, touching_rows = ladders_of(plan), []
    MESSAGES.print("any key: close by a step; Enter: now the lips just meet; q: give up")
    with held_servos(setup) as face:
        for shape, number in enumerate(np.unique(ladder_numbers), start=1):
            rows = np.flatnonzero(ladder_numbers == number)
            face.move(plan.start_deg[rows[0]])
            for row in rows.tolist():
                face.move(plan.goals_deg[row])
                MESSAGES.print(f"shape {shape}, step {row - rows[0] + 1} of {len(rows)}: meet?")
                key = face.hold_while(read_key)
                face.check_sent_whole()
                if key == "q":
                    raise CalibrationError("stopped with q; the calibration stays as it is")
                if key in ("\r", "\n"):
                    touching_rows.append(row)
                    break
    if len(touching_rows) < shape:
        raise CalibrationError(
            "the lips did not meet in every shape; measure the face anew with `lipservo calibrate "
            "measure`"
        )
    return touched_by_eye(calibration, plan, touching_rows)


def _checked_touch_plan(setup: CalibrationSetup, calibration: Calibration) -> PosePlan:
    """Return the plan of poses that close the lips in steps, from 2 mm open to past contact.

    Raises CalibrationError if the calibration is of another face or face model, or has no contact
    of lips, or if its servos were set up anew since.
    """
    names, checksum = setup.servos.names, setup.settings.checksum
    check_calibration(calibration, setup.model, names, checksum)
    if not setup.settings.capabilities.in_memory:
        check_servo_memories(calibration, servo_memories(setup.settings))
    return touch_plan(calibration, setup.model, setup.servos)


def _take_pressing_poses(
    setup: CalibrationSetup, face: HeldFace, plan: PosePlan, tracker: Tracker | _Efforts
) -> list[CapturedPose]:
    """Move the held face through the poses of a plan; return what the tracker measured at each.

    The remaining poses are left out once a servo draws 90 % of its `max_current_ma`.
    """

    def measure() -> Array:
        seen_mm = tracker.measure()
        face.check_sent_whole()
        return seen_mm

    with progress_bar(setup, "steps", len(plan)) as done:
        robot = Robot(
            face.move,
            measure,
            tracker.arrived,
            done,
            lambda: strained_servo(setup, face.effort),
        )
        return take_poses(plan, tracker.marker_names, robot, [], pressing=range(len(plan)))
