"""The figures of `lipservo bench calibration`: whole procedures on simulated robots, scored.

Every seed draws a robot (geometry, backlash, lags). What fits sees `move` and `measure` only; the
score is taken on markers without noise, with the backlash as it lies.

How far the mouth is from its sound on servos that are late, with and without compensation.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from calibration.calibration import Calibration, CalibrationError, Following
from calibration.capture.capture import Robot
from calibration.closure import CLOSED_GAP_MM
from calibration.fit.guided import CLOSED, fit_guided, landmark_poses
from calibration.fit.measured import MeasuredFit, fit_measured, lips_apart_mm
from calibration.fit.procedure import Procedure
from calibration.fit.retargeting import MOST_EXAGGERATION, PRESS_MM, RobotMouth
from calibration.fit.servo_response import identify, lag_between_s
from calibration.mouth_servos import JointRange, MouthServos
from calibration.run.compensation import BacklashCompensation, LagCompensation
from calibration.simulated.face import JAW
from calibration.simulated.robot import RobotDraw, SimulatedRobot, draw_robot, true_markers_mm
from calibration.simulated.servos import SimulatedServos
from lipservo.calibrating.within_speeds import spoken_frames
from lipservo.settings.settings import FaceSettings, load_shipped_face
from lipservo_lab.bench.calibration.hard_captures import (
    FaultCount,
    count_faults,
    count_measured_faults,
    fault_figures,
)
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

_RATE_HZ = 100.0
LOOK_AHEAD_S = 0.200
#: The error is taken in windows of this length, twice as many as fit end to end.
_WINDOW_S = 2.0


@dataclass(frozen=True, slots=True)
class SyncErrors:
    """Delay of the robot's lip gap behind the speaker's, rms over windows.

    before, after: without and with compensation of lag and backlash.
    """

    before_rms_ms: float
    after_rms_ms: float


def sync_errors(
    model: FaceWithAnimPhos,
    calibration: Calibration,
    following: Following,
    draw: RobotDraw,
    servos: SimulatedServos,
    seed: int,
) -> SyncErrors:
    """Return how late a robot's lips are in 20 s of speech, with and without compensation.

    The motion is made of recorded pieces (AnimPhos), drawn by `seed`. following: the lags and
    backlash that are compensated, as identified; servos: the late servos of the robot `draw`.
    """
    frames = spoken_frames(model, np.random.default_rng([seed, 3]))
    wanted_mm = np.array([model.lip_gap_mm(frame) for frame in frames])
    poses_deg = calibration.poses_deg(frames)
    plain_mm = _gap_mm(draw, servos, poses_deg)
    backlash = BacklashCompensation(following.backlash_deg)
    lag = LagCompensation(following.lag_s, 1.0 / _RATE_HZ, look_ahead_s=LOOK_AHEAD_S)
    goals_deg = np.array([lag.feed(backlash.feed(pose[None])[0]) for pose in poses_deg])
    compensated_mm = _gap_mm(draw, servos, goals_deg)
    # Goals are fed to the compensation in advance: a gap is due so much after its frame was fed.
    lags_s = _window_lags_s(wanted_mm, compensated_mm) - lag.advance_s
    return SyncErrors(_rms(_window_lags_s(wanted_mm, plain_mm)) * 1e3, _rms(lags_s) * 1e3)


def _gap_mm(draw: RobotDraw, servos: SimulatedServos, goals_deg: Array) -> Array:
    """Return the robot's lip gap, (n,) mm, for goals (n, n_servos): shafts are late, with slack."""
    shafts_deg = servos.shafts_deg(goals_deg, _RATE_HZ)
    horns_deg = np.empty_like(shafts_deg)
    horn_deg, half_deg = shafts_deg[0], draw.backlash_deg / 2
    for n, shaft_deg in enumerate(shafts_deg):
        # A horn moves only once the shaft has taken up the slack.
        horn_deg = np.clip(horn_deg, shaft_deg - half_deg, shaft_deg + half_deg)
        horns_deg[n] = horn_deg
    markers_mm = true_markers_mm(draw, horns_deg)
    return np.asarray(
        markers_mm[:, MARKERS_47.upper_lip, 1] - markers_mm[:, MARKERS_47.lower_lip, 1]
    )


def _window_lags_s(wanted: Array, seen: Array) -> Array:
    """Return how much later `seen` is than `wanted`, s, window by window, (n_windows,)."""
    length = round(_WINDOW_S * _RATE_HZ)
    starts = range(0, len(wanted) - length, length // 2)
    return np.array(
        [lag_between_s(wanted[s : s + length], seen[s : s + length], _RATE_HZ) for s in starts]
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


N_POSES = 60
#: A shape counts as reachable when the best pose is within this, rms over the lips.
REACHABLE_MM = 0.5
#: A person who puts a mouth into a pose by eye, with keys of one degree: off by so much, rms
#: (assumed, not observed: three key presses, one for a jaw, which moves the lip by 1.6 mm).
_PERSON_DEG, _PERSON_JAW_DEG = 3.0, 1.0
_LARGE_IS_GOOD = ("reachable", "gap_r", "closure_touch")


@dataclass(frozen=True, slots=True)
class SeedFigures:
    """The scores of one robot, named as in docs/benchmarks.md; rms over frames and lip markers.

    heldout_rms_mm: the measured calibration; guided_rms_mm: one by a person's eye. reachable: share
    of shapes that the true robot can reach. closure_touch: share of closures in which lips touch.
    map_us: processor time of a frame. procedure_s: computing time of the procedure.
    """

    heldout_rms_mm: float
    reachable: float
    guided_rms_mm: float
    gap_r: float
    closure_touch: float
    map_us: float
    procedure_s: float
    sync_error_rms_ms: float
    sync_error_before_rms_ms: float


def measure_seed(model: FaceWithAnimPhos, settings: FaceSettings, seed: int) -> SeedFigures:
    """Calibrate the simulated robot of a seed, from capture to lags; return its scores."""
    servos = _mouth_servos(settings)
    joints = servos.joints
    rest_mm = model.markers_mm(model.rest[None])[0]
    draw = draw_robot(rest_mm, servos.names, seed)
    robot = SimulatedRobot(draw, noise_seed=seed)
    late_servos = SimulatedServos.drawn(len(joints), seed)

    began_s = time.perf_counter()
    procedure = Procedure(model, joints, N_POSES, seed=seed)
    capture = procedure.capture(MARKERS_47.names, Robot(robot.move, robot.measure))
    fit = fit_measured(model, capture, servos)
    following = identify(late_servos.encoders_deg, joints, fit.face.backlash_deg)
    procedure_s = time.perf_counter() - began_s

    shapes = _score_shapes(model, fit, draw, servos, seed)
    sync = sync_errors(model, fit.calibration, following, draw, late_servos, seed)
    return _seed_figures(shapes, sync, _map_time_us(model, fit), procedure_s)


def _mouth_servos(settings: FaceSettings) -> MouthServos:
    """Return what calibration knows of a face's servos: names, limits, directions."""
    return MouthServos(
        joints=tuple(JointRange(j.name, j.min_deg, j.max_deg) for j in settings.joints()),
        face_checksum=settings.checksum,
        positive=tuple(servo.positive for servo in settings.servos.values()),
    )


@dataclass(frozen=True, slots=True)
class OwnRobot:
    """The result for one robot: its figures or why calibration refused it, and counts of faults.

    refused: the error's text; empty: it was calibrated. faults: by name of the fault that was put
    into it, whether that was named.
    """

    seed: int
    figures: SeedFigures | None
    refused: str
    faults: dict[str, FaultCount]


def own_robot(model: FaceWithAnimPhos, seed: int) -> OwnRobot:
    """Calibrate the healthy robot of a seed, then put every fault into it; return the results."""
    settings = load_shipped_face("face_sim")
    servos, rest_mm = _mouth_servos(settings), model.markers_mm(model.rest[None])[0]
    figures, refused = None, ""
    try:
        figures = measure_seed(model, settings, seed)
    except CalibrationError as error:
        refused = str(error)
    draw = draw_robot(rest_mm, servos.names, seed)
    faults = count_faults(model, draw, servos, seed)
    faults |= count_measured_faults(model, draw, servos, seed)
    return OwnRobot(seed, figures, refused, faults)


def own_figures(robots: Sequence[OwnRobot]) -> dict[str, object]:
    """Return medians over the robots, and under `worst_...` the worst of each figure.

    A healthy robot that is refused counts in `refused`, and in no median.
    """
    scored = [robot.figures for robot in robots if robot.figures is not None]
    figures: dict[str, object] = {}
    for figure in fields(SeedFigures):
        values = [float(getattr(each, figure.name)) for each in scored] or [math.nan]
        figures[figure.name] = float(np.median(values))
        figures[f"worst_{figure.name}"] = (min if figure.name in _LARGE_IS_GOOD else max)(values)
    figures["worst_rms_mm"] = figures.pop("worst_heldout_rms_mm")
    refused = {str(robot.seed): robot.refused for robot in robots if robot.refused}
    return {
        **figures,
        "robots": len(robots),
        "refused": len(refused),
        "refused_why": refused,
        **fault_figures([robot.faults for robot in robots]),
    }


def _map_time_us(model: FaceWithAnimPhos, fit: MeasuredFit) -> float:
    """Return the processor time of one `positions_deg`, us: the median of ten blocks of 100."""
    frames = model.animphos.frames[:100]
    times_s = []
    for _ in range(10):
        began_s = time.thread_time()
        for frame in frames:
            fit.calibration.positions_deg(frame)
        times_s.append((time.thread_time() - began_s) / len(frames))
    return float(np.median(times_s)) * 1e6


@dataclass(frozen=True, slots=True)
class _ShapeScores:
    """How near a robot's lips come to their targets on held-out frames, (n_frames,) each.

    apart_mm, guided_apart_mm: rms over the lips, by the measured calibration and by a person's eye.
    reachable: whether the best pose is near enough. gap_mm, human_gap_mm: of robot and speaker.
    """

    apart_mm: Array
    guided_apart_mm: Array
    reachable: NDArray[np.bool_]
    gap_mm: Array
    human_gap_mm: Array


def _seed_figures(
    shapes: _ShapeScores, sync: SyncErrors, map_us: float, procedure_s: float
) -> SeedFigures:
    """Return a robot's figures: errors (mm) of reachable shapes only, closures of all shapes."""
    closed = shapes.human_gap_mm <= CLOSED_GAP_MM
    reachable = shapes.reachable
    return SeedFigures(
        heldout_rms_mm=_rms(shapes.apart_mm[reachable]),
        reachable=float(reachable.mean()),
        guided_rms_mm=_rms(shapes.guided_apart_mm[reachable]),
        gap_r=float(np.corrcoef(shapes.gap_mm, shapes.human_gap_mm)[0, 1]),
        closure_touch=float((shapes.gap_mm[closed] <= 0.0).mean()),
        map_us=map_us,
        procedure_s=procedure_s,
        sync_error_rms_ms=sync.after_rms_ms,
        sync_error_before_rms_ms=sync.before_rms_ms,
    )


def _score_shapes(
    model: FaceWithAnimPhos, fit: MeasuredFit, draw: RobotDraw, servos: MouthServos, seed: int
) -> _ShapeScores:
    """Return how far the calibrated robot's lips are from their targets on held-out frames.

    Frames are sent one after another, with backlash compensated as in a running face. draw: the
    true robot. seed: of the person's errors in the guided calibration.
    """

    def truth(output_deg: Array) -> Array:
        return true_markers_mm(draw, output_deg)

    targets_mm = fit.retargeting.targets_mm(fit.held_out - model.rest)
    shape_features, lips = fit.names.shape_features, list(MARKERS_47.lips)

    mouth = RobotMouth(truth, fit.names, servos.limits_deg)
    nearest_deg = mouth.nearest_deg(shape_features.of(targets_mm))
    robot = SimulatedRobot(draw)
    backlash = BacklashCompensation(fit.face.backlash_deg)
    shown_mm = np.empty_like(targets_mm)
    for frame, coefficients in enumerate(fit.held_out):
        robot.move(backlash.feed(fit.calibration.poses_deg(coefficients[None]))[0])
        shown_mm[frame] = robot.true_markers_mm()
    guided_apart_mm = _guided_apart_mm(model, fit, draw, servos, targets_mm, seed)
    return _ShapeScores(
        apart_mm=lips_apart_mm(shown_mm, targets_mm, lips),
        guided_apart_mm=guided_apart_mm,
        reachable=lips_apart_mm(truth(nearest_deg), targets_mm, lips) <= REACHABLE_MM,
        gap_mm=shown_mm[:, MARKERS_47.upper_lip, 1] - shown_mm[:, MARKERS_47.lower_lip, 1],
        human_gap_mm=np.array([model.lip_gap_mm(frame) for frame in fit.held_out]),
    )


def _guided_apart_mm(
    model: FaceWithAnimPhos,
    fit: MeasuredFit,
    draw: RobotDraw,
    servos: MouthServos,
    targets_mm: Array,
    seed: int,
) -> Array:
    """Return lip errors of a robot calibrated by a person's eye, (n_frames,) mm rms.

    The simulated person copies the speaker's mouth, scaled to the robot's width and exaggerated by
    `MOST_EXAGGERATION`. targets_mm: those of the measured fit, for its held-out frames.
    """

    def truth(output_deg: Array) -> Array:
        return true_markers_mm(draw, output_deg)

    shown_mm = model.markers_mm(np.array([pose.coefficients for pose in landmark_poses(model)]))
    neutral_mm, closed_mm = truth(np.zeros((1, len(servos.joints))))[0], shown_mm[0]
    right, left = fit.names.corners
    # The width of the robot's mouth over that of the speaker's.
    size = (neutral_mm[left, 0] - neutral_mm[right, 0]) / (closed_mm[left, 0] - closed_mm[right, 0])
    scale = np.full(3, MOST_EXAGGERATION * size)
    gaps_mm = scale * fit.names.shape_features.gaps_mm(shown_mm)
    gaps_mm[..., 1] -= scale[1] * CLOSED_GAP_MM + PRESS_MM
    wanted = fit.names.shape_features.of(neutral_mm + scale * (shown_mm - closed_mm), gaps_mm)
    nearest_deg = RobotMouth(truth, fit.names, servos.limits_deg).nearest_deg(wanted)
    is_jaw = np.array([joint.name == JAW for joint in servos.joints])
    calibration = guided_by_eye(model, servos, nearest_deg, is_jaw, seed)
    angles_deg = np.array([calibration.positions_deg(frame) for frame in fit.held_out])
    return lips_apart_mm(truth(angles_deg), targets_mm, list(MARKERS_47.lips))


def guided_by_eye(
    model: FaceWithAnimPhos,
    servos: MouthServos,
    nearest_deg: Array,
    is_jaw: NDArray[np.bool_],
    seed: int,
) -> Calibration:
    """Return the guided fit of a person who errs by a few key presses, but closes the lips exactly.

    Parameters
    ----------
    model : FaceWithAnimPhos
        The speaker's.
    servos : MouthServos
        Of the robot.
    nearest_deg : Array
        (n_poses, n_servos) degrees, what looks most like each of the landmark poses.
    is_jaw : Array
        (n_servos,), which servos move a jaw: a person sets them more exactly.
    seed : int
        Of the key presses.

    Returns
    -------
    Calibration
        As `fit_guided` makes it.
    """
    error_deg = np.where(is_jaw, _PERSON_JAW_DEG, _PERSON_DEG)
    noise = np.random.default_rng([seed, 2]).normal(size=nearest_deg.shape)
    posed_deg = np.clip(np.rint(nearest_deg + error_deg * noise), *servos.limits_deg)
    names = [pose.name for pose in landmark_poses(model)]
    posed_deg[[name == CLOSED for name in names]] = nearest_deg[0]
    return fit_guided(model, servos, dict(zip(names, posed_deg, strict=True)))
