"""Calibration without a tracker: a person moves the mouth to a dozen named poses by keys.

Each pose is a shape that the speaker of the model really made; the person moves the servos until
the robot has that shape. A linear map fitted to a dozen poses: usable, and coarser than a measured
map.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from sklearn.linear_model import RidgeCV

from calibration.calibration import Calibration, CalibrationError, Origin
from calibration.fit.run_time_map import rounded
from calibration.grade import HoldOutErrors
from calibration.mouth_servos import JointRange, MouthServos, linear_calibration
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47
from lipsync.output_file import write_whole

#: From a weak to a strong pull towards not moving; leave-one-out chooses among a dozen poses.
_STRENGTHS = np.logspace(-1, 4, 16)
#: Landmark poses are near the speaker's extremes, not at them, which are odd frames.
_QUANTILE = 0.97
CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class LandmarkPose:
    """One pose to make: its name, the instruction, and the speaker's frame, (n_components,)."""

    name: str
    instruction: str
    coefficients: Array


#: What is measured of a mouth: a weighted sum of coordinates, by landmark and axis.
_Measure = tuple[tuple[int, int, float], ...]
_OPENING: _Measure = ((13, 1, 1.0), (14, 1, -1.0))
_WIDTH: _Measure = ((291, 0, 1.0), (61, 0, -1.0))
_UPPER: _Measure = ((0, 1, 1.0),)
_LOWER: _Measure = ((17, 1, -1.0),)
_FORWARD: _Measure = ((0, 2, 0.5), (17, 2, 0.5))
_CORNERS: _Measure = ((61, 1, 0.5), (291, 1, 0.5))
#: Name, what the person is told, what is large there (each standardised, then added up).
_POSES: tuple[tuple[str, str, tuple[tuple[_Measure, float], ...]], ...] = (
    ("open", "open the mouth as for AH", ((_OPENING, 1.0),)),
    ("wide", "draw the corners apart as for EE", ((_WIDTH, 1.0),)),
    ("narrow", "draw the corners together as for OO", ((_WIDTH, -1.0),)),
    ("upper lip up", "raise the upper lip, teeth showing", ((_UPPER, 1.0),)),
    ("upper lip down", "lower the upper lip", ((_UPPER, -1.0),)),
    ("lower lip down", "lower the lower lip, teeth showing", ((_LOWER, 1.0),)),
    ("forward", "push the lips forward", ((_FORWARD, 1.0),)),
    ("back", "draw the lips back against the teeth", ((_FORWARD, -1.0),)),
    ("corners up", "raise the corners", ((_CORNERS, 1.0),)),
    ("corners down", "lower the corners", ((_CORNERS, -1.0),)),
    ("open and narrow", "a round open mouth as for AW", ((_OPENING, 1.0), (_WIDTH, -1.0))),
    ("open and wide", "open and wide as for A in cat", ((_OPENING, 1.0), (_WIDTH, 1.0))),
    ("closed and narrow", "nearly closed and round", ((_OPENING, -1.0), (_WIDTH, -1.0))),
)


def landmark_poses(model: FaceWithAnimPhos) -> tuple[LandmarkPose, ...]:
    """Return the closed mouth, then 13 extreme shapes, each with a frame of the speaker's."""
    frames = model.animphos.frames
    markers_mm = model.markers_mm(frames)
    poses = [LandmarkPose(CLOSED, "close the mouth, lips just touching", model.rest)]
    for name, instruction, measures in _POSES:
        score = np.zeros(len(frames))
        for measure, sign in measures:
            rows = [MARKERS_47.landmarks.index(landmark) for landmark, _, _ in measure]
            axes = [axis for _, axis, _ in measure]
            values = markers_mm[:, rows, axes] @ np.array([weight for _, _, weight in measure])
            # Standardised, so that several measures count alike.
            score += sign * (values - values.mean()) / (values.std() + 1e-12)
        wanted_score = np.quantile(score, _QUANTILE)
        # The frame nearest to the 97 % quantile: near the extreme, not an odd frame beyond it.
        poses.append(LandmarkPose(name, instruction, frames[np.abs(score - wanted_score).argmin()]))
    return tuple(poses)


def fit_guided(
    model: FaceWithAnimPhos,
    servos: MouthServos,
    made_deg: Mapping[str, Array],
    *,
    date: str = "",
) -> Calibration:
    """Fit a calibration to poses that a person set by keys, without a tracker.

    The closed mouth is exact; the rest is ridge regression. The calibration's errors contain only
    `joint_rms_deg`, the rms over poses of the distance from the map made without that pose; nothing
    is known in millimetres, and the errors are of 0 frames.

    Parameters
    ----------
    model : FaceWithAnimPhos
        The speaker's face.
    servos : MouthServos
        Servos of the robot's mouth.
    made_deg : Mapping[str, Array]
        (n_servos,) degrees for each landmark pose made, by its name.
    date : str
        Date of the calibration, ISO 8601.

    Returns
    -------
    Calibration
        With the joints' limits, in degrees.

    Raises
    ------
    CalibrationError
        Without the closed mouth, or with too few poses.
    """
    poses = [pose for pose in landmark_poses(model) if pose.name in made_deg]
    if CLOSED not in made_deg:
        raise CalibrationError(f"the pose {CLOSED!r} is missing; all others are measured from it")
    if len(poses) < model.n_components + 2:
        raise CalibrationError(
            f"{len(poses)} poses are too few; {model.n_components + 2} are needed: run `lipservo "
            "calibrate guided` again and make more of them"
        )
    closed_deg = made_deg[CLOSED]
    x = np.array([pose.coefficients - model.rest for pose in poses if pose.name != CLOSED])
    turned_deg = np.array([made_deg[p.name] - closed_deg for p in poses if p.name != CLOSED])
    weights, left_out_deg = _ridge(x, turned_deg)
    return linear_calibration(
        model,
        servos,
        weights,
        rest_deg=rounded(closed_deg),
        errors=HoldOutErrors(joint_rms_deg=tuple(left_out_deg.tolist())),
        origin=Origin("guided", date, len(poses), servos.models),
    )


def _ridge(x: Array, turned_deg: Array) -> tuple[Array, Array]:
    """Return weights (n_servos, n_components) and each servo's leave-one-out rms in degrees.

    x: (n, n_components), speaker's frames less the rest; turned_deg: (n, n_servos), the angles set
    for them. The error without a pose is its residual over 1 less its leverage.
    """
    ridge = RidgeCV(_STRENGTHS, fit_intercept=False).fit(x, turned_deg)
    weights = rounded(np.asarray(ridge.coef_, dtype=np.float64).reshape(turned_deg.shape[1], -1))
    regularised = x.T @ x + ridge.alpha_ * np.eye(x.shape[1])
    leverage = np.einsum("ni,ni->n", x, np.linalg.solve(regularised, x.T).T)
    left_out_deg = (turned_deg - x @ weights.T) / (1.0 - leverage)[:, None]
    return weights, np.asarray(np.sqrt(np.mean(left_out_deg**2, axis=0)))


#: Degrees of a key press: one is about the backlash of a printed gear train, five cross a
#: range soon.
_SMALL_DEG, _LARGE_DEG = 1.0, 5.0
KEEP_KEYS = ("\r", "\n", " ")
#: What each key is for, as shown to the person.
KEYS: Mapping[str, str] = {
    "w s or arrows up, down": "previous, next servo",
    "d a or arrows right, left": "one degree more, less",
    "D A": "five degrees more, less",
    "enter or space": "the pose is right: next one",
    "x": "leave this pose out",
    "b": "back to the pose before",
    "q": "stop; what was made is kept",
}


@dataclass(frozen=True, slots=True)
class GuidedSession:
    """The state of a guided calibration: current pose and servo, angles, and finished poses.

    made_deg: angles (n_servos,) of each finished pose, by its name; pose, servo: numbers of the
    current ones; positions_deg: (n_servos,), the current angles.
    """

    joints: tuple[JointRange, ...]
    poses: tuple[LandmarkPose, ...]
    made_deg: Mapping[str, Array]
    pose: int
    servo: int
    positions_deg: Array
    stopped: bool = False

    @property
    def done(self) -> bool:
        """Whether the person stopped the session or passed its last pose."""
        return self.stopped or self.pose >= len(self.poses)

    def press(self, key: str) -> "GuidedSession":
        """Return the session after the person pressed a key of `KEYS`; unchanged for others."""
        n_servos = len(self.joints)
        if key in ("w", "s"):
            return replace(self, servo=(self.servo + (1 if key == "s" else -1)) % n_servos)
        step_of_key = {"d": _SMALL_DEG, "a": -_SMALL_DEG, "D": _LARGE_DEG, "A": -_LARGE_DEG}
        if key in step_of_key:
            turned_deg = float(self.positions_deg[self.servo]) + step_of_key[key]
            return self.moved({self.joints[self.servo].name: turned_deg})
        if key in KEEP_KEYS:
            name = self.poses[self.pose].name
            return replace(
                self,
                made_deg={**self.made_deg, name: self.positions_deg.copy()},
                pose=self.pose + 1,
            )
        if key == "x":
            return replace(self, pose=self.pose + 1)
        if key == "b":
            previous = max(0, self.pose - 1)
            made_deg = self.made_deg.get(self.poses[previous].name, self.positions_deg)
            return replace(self, pose=previous, positions_deg=made_deg.copy())
        return replace(self, stopped=True) if key == "q" else self

    def moved(self, to_deg: Mapping[str, object]) -> "GuidedSession":
        """Return the session with joints at new angles, clipped to their limits.

        to_deg: finite angles in degrees by the joint's name; anything else is skipped.
        """
        positions_deg = self.positions_deg.copy()
        for n, joint in enumerate(self.joints):
            deg = to_deg.get(joint.name)
            if isinstance(deg, int | float) and np.isfinite(deg):
                positions_deg[n] = np.clip(deg, joint.min_deg, joint.max_deg)
        return replace(self, positions_deg=positions_deg)


def start_session(
    joints: Sequence[JointRange], poses: Sequence[LandmarkPose], kept: Mapping[str, Array]
) -> GuidedSession:
    """Return a session with all joints at 0, at the first pose that `kept` does not contain.

    Parameters
    ----------
    joints : Sequence[JointRange]
        Ranges of the joints.
    poses : Sequence[LandmarkPose]
        Poses to be made.
    kept : Mapping[str, Array]
        (n_servos,) degrees of finished poses, by the pose's name.

    Returns
    -------
    GuidedSession
        A session at 0 degrees.
    """
    first = next((i for i, pose in enumerate(poses) if pose.name not in kept), len(poses))
    return GuidedSession(tuple(joints), tuple(poses), dict(kept), first, 0, np.zeros(len(joints)))


def keep_poses(made_deg: Mapping[str, Array], servo_names: Sequence[str], path: Path) -> None:
    """Write the poses made so far to a file, whole or not at all. Raises OutputError.

    Parameters
    ----------
    made_deg : Mapping[str, Array]
        (n_servos,) degrees, by the pose's name.
    servo_names : Sequence[str]
        Names of the n_servos servos.
    path : Path
        JSON file to write.
    """
    content = {
        name: dict(zip(servo_names, degrees.tolist(), strict=True))
        for name, degrees in made_deg.items()
    }
    write_whole(path, json.dumps(content, indent=2) + "\n")


def kept_poses(servo_names: Sequence[str], path: Path | None) -> dict[str, Array]:
    """Read the poses that an earlier session wrote.

    Parameters
    ----------
    servo_names : Sequence[str]
        Names of the n_servos servos.
    path : Path | None
        JSON file of the poses; None: no file.

    Returns
    -------
    dict[str, Array]
        (n_servos,) degrees by the pose's name; {} without a file.

    Raises
    ------
    CalibrationError
        The file is damaged, or one of other servos.
    """
    if path is None or not path.exists():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return {
            str(name): np.array([float(pose[servo]) for servo in servo_names])
            for name, pose in content.items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OSError) as error:
        raise CalibrationError(
            f"{path}: not the poses of this face; name another file or delete this one"
        ) from error
