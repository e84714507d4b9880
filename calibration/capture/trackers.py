"""Sources of markers while a robot holds a pose: a file or folder that is being filled.

A tracker gets the number of every pose (`arrived`) and then returns its markers (`measure`). It
waits by a function that the caller passes, so that the servos are held meanwhile.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.marker_files import Reading, median_place, read_readings
from lipsync.arrays import Array
from lipsync.output_file import write_whole

#: Seconds pass, servos held.
Wait = Callable[[float], None]
#: A line for a person.
Say = Callable[[str], None]

#: The readings of one pose: pose, marker, place (3,) in mm.
ReadPose = Callable[[int], list[Reading]]

_LOOK_EVERY_S = 0.1
#: Readings of a pose are whole when all markers are there, or nothing new came for so long.
_QUIET_S = 0.5
#: Longer than a person takes for a photograph.
PATIENCE_S = 300.0
#: What tells another program which pose stands, beside the file or in the folder.
POSE_FILE = "pose.json"
#: A pose that was read twice is the same within the digits in which it is kept; a tracker's noise
#: is ten times as much.
_SAME_POSE_MM = 0.05
_NOTHING_KEPT: Mapping[int, Mapping[str, Array]] = MappingProxyType({})


class Tracker(Protocol):
    """The interface of a source of markers for a capture."""

    @property
    def marker_names(self) -> tuple[str, ...]:
        """The names of the markers, in the order in which `measure` returns them."""

    def arrived(self, pose: int, reached_deg: Array, /) -> None:
        """Receive the number of the pose that the robot now holds, and its angles.

        Parameters
        ----------
        pose : int
            Counted from 0.
        reached_deg : Array
            (n_servos,) degrees, by the encoders.
        """

    def measure(self) -> Array:
        """Return the markers of the pose that the robot holds.

        Returns
        -------
        Array
            (n_markers, 3) mm, NaN for lost points.
        """


class FileTracker:
    """A tracker that reads a CSV or JSON file, or a folder, to which another program adds markers.

    Poses count from 1, as in a plan; pose 0 is neutral, which defines the names of the markers.
    `pose.json` in a folder, `FILE.pose.json` beside a file, contains the pose that the robot holds,
    for the recording program.
    """

    def __init__(
        self,
        path: Path,
        servo_names: tuple[str, ...],
        wait: Wait,
        say: Say,
        *,
        axes: str = "x y z",
        read: ReadPose | None = None,
        kept: Mapping[int, Mapping[str, Array]] = _NOTHING_KEPT,
    ) -> None:
        """Wait until pose 0, the neutral, is recorded. Raises CalibrationError after 300 s.

        Also raised if the poses recorded in `path` are not those of `kept`.

        wait: lets seconds pass, servos held; say: called with lines for the user; axes: of C3D
        files, to left, up, forward. read: function that returns the readings of one pose; None:
        `path` is read as file or folder. kept: markers (3,) mm of the poses that an interrupted
        capture kept, by their numbers from 0 and the markers' names.
        """
        self._path = path
        self._servo_names = servo_names
        self._wait, self._say = wait, say
        self._axes, self._read = axes, read
        self._names: tuple[str, ...] = ()
        self._pose = 0
        self._requested = {number + 1 for number in kept}
        try:
            self._check_same_capture(kept)
            if not self._read_medians(0):
                self._announce_pose(0, np.zeros(len(servo_names)))
            self._names = tuple(self._wait_for_pose(0))
        except BaseException:  # nobody can close what was never made
            self.close()
            raise

    @property
    def marker_names(self) -> tuple[str, ...]:
        """The names of the markers, as recorded in pose 0."""
        return self._names

    def arrived(self, pose: int, reached_deg: Array) -> None:
        """Announce a pose to the recorder in `pose.json`, and to the user.

        A pose that the robot holds a second time, or that was recorded just before a capture was
        interrupted, is not announced again. Raises CalibrationError where the file contains poses
        that this capture never asked for.

        Parameters
        ----------
        pose : int
            Counted from 0.
        reached_deg : Array
            (n_servos,) degrees, by the encoders.
        """
        if pose + 1 in self._requested:
            self._pose = pose + 1
            return
        self._requested.add(pose + 1)
        if not self._read_medians(pose + 1):
            self._announce_pose(pose + 1, reached_deg)
            return
        if self._read_medians(pose + 2):
            raise self._other_capture_error(f"it already has pose {pose + 1}")
        self._pose = pose + 1
        self._say(f"pose {pose + 1} is in {self._path} already, and is read from there")

    def measure(self) -> Array:
        """Wait until the pose is recorded; return its markers. Raises CalibrationError after 300 s.

        Returns
        -------
        Array
            (n_markers, 3) mm, NaN for lost points.
        """
        markers = self._wait_for_pose(self._pose)
        return np.array([markers.get(name, np.full(3, np.nan)) for name in self._names])

    def close(self) -> None:
        """Delete `pose.json`, which contains the pose that the robot holds."""
        self._pose_file.unlink(missing_ok=True)

    def _check_same_capture(self, kept: Mapping[int, Mapping[str, Array]]) -> None:
        """Raise CalibrationError if the last kept pose differs from that pose in the recorded file.

        kept: markers (3,) mm by pose number, from 0, and by name. The median distance of the
        markers is compared, so two exchanged names do no harm.
        """
        if not kept:
            return
        last = max(kept)
        recorded = self._read_medians(last + 1)
        apart_mm = [
            float(np.linalg.norm(recorded[name] - place_mm))
            for name, place_mm in kept[last].items()
            if name in recorded and np.isfinite(place_mm).all()
        ]
        # A median: two names may have been exchanged since, and a marker read anew has another
        # median.
        if apart_mm and np.median(apart_mm) > _SAME_POSE_MM:
            raise self._other_capture_error(f"its pose {last + 1} differs from the captured one")

    def _other_capture_error(self, why: str) -> CalibrationError:
        return CalibrationError(
            f"{self._path}: {why}, so it is of another capture; name a new file, or continue that "
            "capture with its --keep and -o"
        )

    @property
    def _pose_file(self) -> Path:
        if self._path.is_dir():
            return self._path / POSE_FILE
        return self._path.with_name(f"{self._path.name}.{POSE_FILE}")

    def _announce_pose(self, pose: int, reached_deg: Array) -> None:
        """Write a pose's number (0: neutral) and angles to `pose.json`; ask for its recording."""
        self._pose = pose
        angles_deg = dict(zip(self._servo_names, np.round(reached_deg, 3).tolist(), strict=True))
        write_whole(self._pose_file, json.dumps({"pose": pose, "servos_deg": angles_deg}))
        self._say(f"pose {pose} stands: record it in {self._path}")

    def _wait_for_pose(self, pose: int) -> Mapping[str, Array]:
        """Wait until a pose is recorded; return the median place, (3,) mm, of each of its markers.

        pose: from 1; 0 is neutral. A pose is complete once it has all markers of neutral, or some
        and no new one for 0.5 s. Raises CalibrationError after 300 s.
        """
        markers_before: Mapping[str, Array] = {}
        waited_s = quiet_s = 0.0
        while waited_s < PATIENCE_S:
            markers = self._read_medians(pose)
            quiet_s = quiet_s + _LOOK_EVERY_S if markers.keys() == markers_before.keys() else 0.0
            if markers and (quiet_s >= _QUIET_S or set(self._names) == set(markers)):
                return markers
            markers_before = markers
            self._wait(_LOOK_EVERY_S)
            waited_s += _LOOK_EVERY_S
        raise CalibrationError(
            f"{self._path}: no pose {pose} was recorded in {PATIENCE_S:.0f} s; is the tracker "
            "running? Earlier poses are kept in the --keep file"
        )

    def _read_medians(self, pose: int) -> Mapping[str, Array]:
        """Return the median place, (3,) mm, of each marker in a pose, by name.

        Empty if the pose is not recorded, or the file or folder is still being written. Raises
        CalibrationError for a malformed CSV file.
        """
        if not self._path.exists() or self._is_in_mid_line():
            return {}
        try:
            readings = self._read(pose) if self._read else read_readings(self._path, self._axes)
        except CalibrationError:
            if self._path.suffix.lower() == ".csv":
                raise
            return {}  # a folder or a JSON value of which a part is there
        places_mm: dict[str, list[Array]] = {}
        for number, name, place_mm in readings:
            if number == pose:
                places_mm.setdefault(name, []).append(place_mm)
        return {name: median_place(seen) for name, seen in places_mm.items()}

    def _is_in_mid_line(self) -> bool:
        """Return whether the file is CSV and its last line is still being written."""
        return self._path.suffix.lower() == ".csv" and not self._path.read_bytes().endswith(b"\n")


@dataclass(slots=True)
class SeenByComputation:
    """A tracker whose markers are computed from the encoders' angles, for a simulated face.

    look: from angles (n_servos,) degrees to markers (n_markers, 3) mm.
    """

    marker_names: tuple[str, ...]
    look: Callable[[Array], Array]
    reached_deg: Array = field(default_factory=lambda: np.zeros(0), init=False)

    def arrived(self, _pose: int, reached_deg: Array) -> None:
        """Store the angles of the pose that the robot holds, by the encoders.

        Parameters
        ----------
        reached_deg : Array
            (n_servos,) degrees.
        """
        self.reached_deg = reached_deg

    def measure(self) -> Array:
        """Return the markers computed from the stored angles.

        Returns
        -------
        Array
            (n_markers, 3) mm.
        """
        return self.look(self.reached_deg)
