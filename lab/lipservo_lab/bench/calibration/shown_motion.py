"""What poses look like on a true elastic robot, against the shapes that were wanted."""

from dataclasses import dataclass

import numpy as np

from calibration.calibration import Calibration
from calibration.hold_out import CLOSED_GAP_MM
from calibration.run.backlash import BacklashCompensation
from calibration.simulated.elastic_robot import ElasticFace, ElasticRobot
from calibration.simulated.elastic_skin import N_PAIRS
from lipservo_lab.bench.calibration.wanted_shapes import WantedShapes
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: Lips whose edges are this near touch.
_TOUCH_MM = 0.02
_SMALL_MM = (2.0, 4.0)
#: The force that suffices closes a slit that is so much too wide all along.
_ENOUGH_MM = 0.15


@dataclass(frozen=True, slots=True)
class Motion:
    """Millimetres rms over frames and lips; shares 0..1."""

    off_mm: float
    gap_r: float
    gap_slope: float
    shut: float
    touch: float
    force_ratio: float


def played(face: ElasticFace, calibration: Calibration, frames: Array) -> Array:
    """(n, n_servos): where the horns stand, one frame after another, play made up for as live."""
    following = calibration.following
    n_servos = len(calibration.servo_names)
    backlash = BacklashCompensation(
        np.zeros(n_servos) if following is None else following.backlash_deg
    )
    goals = [backlash.feed(calibration.positions_deg(frame)) for frame in frames]
    return behind_play(face, np.array(goals))


def behind_play(face: ElasticFace, goals_deg: Array) -> Array:
    """(n, n_servos): where the horns stand at these goals, one after another."""
    robot = ElasticRobot(face)
    stands = []
    for goal_deg in goals_deg:
        robot.move(goal_deg)
        stands.append(robot.output_deg)
    return np.array(stands)


def shown(face: ElasticFace, output_deg: Array, wanted: WantedShapes) -> Motion:
    """output_deg: (n, n_servos), of the wanted frames."""
    state = face.state(output_deg)
    off_mm = (state.markers_mm - wanted.shapes_mm)[:, list(MARKERS_47.lips)]
    gap_mm = state.gaps_mm[:, N_PAIRS // 2]
    touches = gap_mm <= _TOUCH_MM
    closed = wanted.human_gap_mm <= CLOSED_GAP_MM
    small = (wanted.human_gap_mm >= _SMALL_MM[0]) & (wanted.human_gap_mm <= _SMALL_MM[1])
    moves = gap_mm.std() > 0.0
    return Motion(
        off_mm=float(np.sqrt(np.mean(np.sum(off_mm**2, axis=2)))),
        gap_r=float(np.corrcoef(wanted.gap_mm, gap_mm)[0, 1]) if moves else 0.0,
        gap_slope=float(np.polyfit(wanted.gap_mm, gap_mm, 1)[0]),
        shut=float(touches[small].mean()),
        touch=float(touches[closed].mean()),
        force_ratio=float(np.median(state.force_n[closed]) / face.closing_force_n(_ENOUGH_MM)),
    )
