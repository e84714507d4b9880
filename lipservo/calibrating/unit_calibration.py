"""`calibrate unit`: a design's calibration on another unit of it, from at most 15 poses.

With a tracker all of the design's poses are taken over to the unit, and fitted with its own: shapes
count from the unit's own neutral and reach, as in a measured map. The design's map with its joints
turned was 1.2 to 1.7 times as far off as the unit's own on six elastic sisters, this .8 to 1.1. By
eye, for want of markers, the map is turned.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from calibration.calibration import Calibration, CalibrationError, Origin, check_calibration
from calibration.capture.capture import (
    NOT_KEPT,
    Capture,
    CapturedPose,
    KeptPoses,
    PosePlan,
    Robot,
    gather,
    joined,
    ladders_of,
    plan_around,
    plan_rows,
    take_poses,
)
from calibration.fit.guided import CLOSED, landmark_poses
from calibration.fit.retargeting import correspond
from calibration.fit.robot_face import RobotFace, fit_robot_face
from calibration.fit.touch import touch_plan
from calibration.mouth_servos import MouthServos
from calibration.unit import Unit, unit_by_eye, unit_by_markers
from lipservo.calibrating.calibration_setup import CalibrationSetup, progress_bar, today
from lipservo.calibrating.face_source import MeshOptions, calibrate_seen
from lipservo.calibrating.guided_calibration import poses_by_keys
from lipservo.calibrating.measured_calibration import CalibrationResult
from lipservo.calibrating.touching import touch_by_current
from lipservo.runtime.servos.assembly import servo_memories
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array

#: Poses spread over this share of the range, all joints at once; and steps of a ladder of 15 that
#: closes the lips, once horns are known: 15 poses in all.
_N_SPREAD, _SHARE = 10, 0.7
_STEPS: Final = (2, 5, 8, 11, 14)
#: Poses that a person makes, at least.
_LEAST_BY_EYE = 4


@dataclass(frozen=True, slots=True)
class Design:
    """A design's calibration, the capture that it was fitted to, and the face learnt from it."""

    calibration: Calibration
    capture: Capture
    face: RobotFace

    @classmethod
    def learnt(cls, calibration: Calibration, capture: Capture) -> "Design":
        """Return the design with the face learnt from its capture."""
        with threadpool_limits(limits=1):
            features = correspond(capture.marker_names).shape_features
            return cls(calibration, capture, fit_robot_face(capture, features))

    def unit(self, seen: Capture) -> tuple[Unit, Capture]:
        """Return the unit on which poses were seen, and all poses as if of the unit.

        These are the design's, as the unit would have shown them, and the seen ones. Raises
        CalibrationError if the design has no such unit.
        """
        with threadpool_limits(limits=1):
            face = self.face
            horns_deg = seen.goals_deg - seen.from_below * face.backlash_deg / 2
            noise_mm = face.left_out_rms_mm
            found = unit_by_markers(self._markers_mm, horns_deg, seen.markers_mm, noise_mm)
            design, later_mm = self.capture, found.unit.later_mm
            horns_deg = design.goals_deg - design.from_below * face.backlash_deg / 2
            # Lips that meet later are pushed less.
            moved_mm = self._markers_mm(horns_deg, later_mm) - self._markers_mm(horns_deg, 0.0)
        markers_mm = found.markers_mm(design.markers_mm + moved_mm)
        # The unit's ladder is one of its own.
        of_seen = np.where(ladders_of(seen) > 0, ladders_of(design).max() + 1, 0)
        of_unit = replace(
            seen,
            goals_deg=np.concatenate([found.unit.unit_deg(design.goals_deg), seen.goals_deg]),
            from_below=np.concatenate([design.from_below, seen.from_below]),
            markers_mm=np.concatenate([markers_mm, seen.markers_mm]),
            n_planned=design.n_planned + seen.n_planned,
            rows=(),
            ladders=np.concatenate([ladders_of(design), of_seen]),
        )
        return found.unit, of_unit

    def _markers_mm(self, horns_deg: Array, later_mm: float) -> Array:
        """Return the markers of poses, (n, n_markers, 3) mm, lips meeting `later_mm` later."""
        face, contact = self.face, self.face.contact
        if contact is not None:
            contact = replace(contact, closed_mm=contact.closed_mm - later_mm)
        return replace(face, contact=contact).markers_mm(horns_deg)


def spread_plan(servos: MouthServos) -> PosePlan:
    """Return a plan of neutral and nine poses in which all joints move (a Latin hypercube)."""
    low_deg, high_deg = servos.limits_deg
    shares = qmc.LatinHypercube(len(low_deg), rng=np.random.default_rng(0)).random(_N_SPREAD)
    shares[0] = low_deg / np.minimum(low_deg - high_deg, -1e-9)
    goals_deg = _SHARE * (low_deg + shares * (high_deg - low_deg))
    return plan_around(goals_deg, servos.joints, rules=servos.rules, seed=None)


def capture_unit(
    design: Design,
    model: FaceWithAnimPhos,
    servos: MouthServos,
    marker_names: tuple[str, ...],
    robot: Robot,
    kept: KeptPoses = NOT_KEPT,
    *,
    sees_forward: bool = True,
) -> Capture:
    """Return a capture of the unit `robot`: the design's poses, and those that are taken now.

    kept: file of poses, from which an interrupted capture goes on; sees_forward: depth is measured.
    Lips are closed only once the horns are known to be right. Raises CalibrationError for a unit
    that the design does not fit.
    """
    captured = design.capture
    if unknown := sorted({*marker_names} - {*captured.marker_names}):
        raise CalibrationError(f"the design was measured without the markers {', '.join(unknown)}")
    if marker_names != captured.marker_names:
        rows = [captured.marker_names.index(name) for name in marker_names]
        seen_mm = captured.markers_mm[:, rows]
        captured = replace(captured, marker_names=marker_names, markers_mm=seen_mm)
        design = Design.learnt(design.calibration, captured)
    poses: list[CapturedPose] = []

    def unit_at(plan: PosePlan) -> tuple[Unit, Capture]:
        earlier = {pose.index: pose for pose in (*kept.read(plan, marker_names), *poses)}
        pressing = range(_N_SPREAD, len(plan))
        poses[:] = take_poses(plan, marker_names, robot, [*earlier.values()], kept, pressing)
        seen = gather(plan, marker_names, poses)
        if not sees_forward:
            seen.markers_mm[..., 2] = np.nan
        unit, of_unit = design.unit(seen)
        unit.check_horns(servos.names)
        return unit, of_unit

    plan, known = spread_plan(servos), design.calibration
    unit, of_unit = unit_at(plan)
    if known.closure is None:
        return of_unit
    nearly = unit.calibration(known, servos.limits_deg)
    return unit_at(joined(plan, plan_rows(touch_plan(nearly, model, servos), _STEPS)))[1]


def check_design(setup: CalibrationSetup, design: Calibration, source: Path) -> None:
    """Raise CalibrationError unless the calibration from `source` is of this face's design."""
    names = setup.servos.names
    if design.servo_names != names:
        raise CalibrationError(
            f"{source}: is of another design, whose joints are {', '.join(design.servo_names)}; "
            f"this face's are {', '.join(names)}"
        )
    check_calibration(design, setup.model, names, design.face_checksum)


def design_capture(base: Path) -> Capture:
    """Return the poses that `measure` kept beside the calibration `base`.

    Raises CalibrationError without a file of them.
    """
    for end in ("poses", "poses.previous"):
        path = base.with_name(f"{base.name}.{end}")
        if path.exists():
            return KeptPoses(path).capture()
    raise CalibrationError(
        f"{path}: the poses that {base} was measured by are not there; get them with it, or leave "
        "out --tracker"
    )


def unit_of_tracker(
    setup: CalibrationSetup, design: Design, source: str | None, axes: str, mesh: MeshOptions
) -> CalibrationResult:
    """Move the unit's servos through 15 poses; fit a calibration to them and the design's.

    source, axes, mesh: as for `tracker_source`. Raises CalibrationError.
    """

    def take(at: CalibrationSetup, names: tuple[str, ...], robot: Robot) -> Capture:
        with progress_bar(at, "poses", _N_SPREAD + len(_STEPS)) as done:
            on, forward = replace(robot, progress=done), at.sees_forward
            return capture_unit(
                design, at.model, at.servos, names, on, at.kept, sees_forward=forward
            )

    result = calibrate_seen(setup, source, axes, mesh, take=take)
    fitted, known = result.calibration, design.calibration
    origin = replace(fitted.origin, method="unit", poses=_N_SPREAD + len(_STEPS))
    following = known.following or fitted.following
    calibration = replace(fitted, origin=origin, following=following, trim=known.trim)
    return replace(result, calibration=calibration)


def unit_of_eye(setup: CalibrationSetup, design: Calibration) -> CalibrationResult:
    """Let a person correct the design's poses by keys; contact is found by current, if measured.

    Raises CalibrationError for poses that do not fit, or without the closed mouth.
    """
    servos, poses = setup.servos, landmark_poses(setup.model)
    begin_deg = {pose.name: design.positions_deg(pose.coefficients) for pose in poses}
    made_deg = poses_by_keys(setup, poses, begin_deg)
    if CLOSED not in made_deg or len(made_deg) < _LEAST_BY_EYE:
        raise CalibrationError(f"make {CLOSED!r} and {_LEAST_BY_EYE - 1} other poses at least")
    names = sorted(made_deg, key=lambda name: name != CLOSED)
    of_design_deg, of_unit_deg = (np.array([d[n] for n in names]) for d in (begin_deg, made_deg))
    unit = unit_by_eye(design, of_design_deg, of_unit_deg)
    unit.check_horns(servos.names)
    calibration = replace(
        unit.calibration(design, servos.limits_deg),
        origin=Origin("unit by eye", today(), len(names), servos.models),
        face_checksum=servos.face_checksum,
        rules=servos.rules,
    )
    result = CalibrationResult(calibration).with_memories(servo_memories(setup.settings))
    if design.closure is None or not setup.has_load or setup.settings.capabilities.in_memory:
        return result
    try:
        return replace(result, calibration=touch_by_current(setup, result.calibration)[0])
    except CalibrationError as error:
        return replace(result, warnings=(f"contact is as you saw it: {error}",))
