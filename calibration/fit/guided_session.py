"""A person making landmark poses with keys: what each key does, and what has been made so far."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.calibration import CalibrationError
from calibration.fit.guided import LandmarkPose
from calibration.joint_range import JointRange
from lipsync.arrays import Array
from lipsync.output_file import write_whole

#: Degrees of a key press: one is about the backlash of a printed gear train, five cross a
#: range soon.
_SMALL_DEG, _LARGE_DEG = 1.0, 5.0
#: What each key is for, as shown to the person.
KEYS: Mapping[str, str] = {
    "w s or arrows up, down": "previous, next servo",
    "d a or arrows right, left": "one degree more, less",
    "D A": "five degrees more, less",
    "enter": "the pose is right: next one",
    "x": "leave this pose out",
    "b": "back to the pose before",
    "q": "stop; what was made is kept",
}


@dataclass(frozen=True, slots=True)
class GuidedSession:
    """Where the person is. made_deg: for each finished pose, angles (n_servos,)."""

    joints: tuple[JointRange, ...]
    poses: tuple[LandmarkPose, ...]
    made_deg: Mapping[str, Array]
    pose: int
    servo: int
    positions_deg: Array
    stopped: bool = False

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.stopped or self.pose >= len(self.poses)

    def press(self, key: str) -> "GuidedSession":
        """The session after a key; one that means nothing changes nothing."""
        n_servos = len(self.joints)
        if key in ("w", "s"):
            return replace(self, servo=(self.servo + (1 if key == "s" else -1)) % n_servos)
        steps = {"d": _SMALL_DEG, "a": -_SMALL_DEG, "D": _LARGE_DEG, "A": -_LARGE_DEG}
        if key in steps:
            return self._turned(steps[key])
        if key in ("\r", "\n"):
            name = self.poses[self.pose].name
            return replace(
                self,
                made_deg={**self.made_deg, name: self.positions_deg.copy()},
                pose=self.pose + 1,
            )
        if key == "x":
            return replace(self, pose=self.pose + 1)
        if key == "b":
            return replace(self, pose=max(0, self.pose - 1))
        return replace(self, stopped=True) if key == "q" else self

    def _turned(self, by_deg: float) -> "GuidedSession":
        joint = self.joints[self.servo]
        positions_deg = self.positions_deg.copy()
        positions_deg[self.servo] = np.clip(
            positions_deg[self.servo] + by_deg, joint.min_deg, joint.max_deg
        )
        return replace(self, positions_deg=positions_deg)


def start_session(
    joints: Sequence[JointRange], poses: Sequence[LandmarkPose], kept: Mapping[str, Array]
) -> GuidedSession:
    """At neutral, before the first pose that was not made yet."""
    first = next((i for i, pose in enumerate(poses) if pose.name not in kept), len(poses))
    return GuidedSession(tuple(joints), tuple(poses), dict(kept), first, 0, np.zeros(len(joints)))


def keep_poses(made_deg: Mapping[str, Array], servo_names: Sequence[str], path: Path) -> None:
    """Write what was made so far, whole or not at all. Raises OutputError."""
    content = {
        name: dict(zip(servo_names, degrees.tolist(), strict=True))
        for name, degrees in made_deg.items()
    }
    write_whole(path, json.dumps(content, indent=2) + "\n")


def kept_poses(servo_names: Sequence[str], path: Path) -> dict[str, Array]:
    """What an earlier session made; nothing where there is no file.

    Raises CalibrationError for a damaged file or one of other servos.
    """
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return {
            str(name): np.array([float(pose[servo]) for servo in servo_names])
            for name, pose in content.items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OSError) as error:
        raise CalibrationError(
            f"{path}: not the poses of this face; name another file or remove this one"
        ) from error
