"""`lipservo calibrate measure`, killed at random times and started again by the same command.

Counted is how often a whole calibration came of it, graded and with lags, without a pose that was
requested again after it was kept. The servos are simulated behind a pseudo-terminal; the markers
are computed, or another program adds them to a CSV or JSON file when it sees a new pose.
"""

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from calibration.calibration import CalibrationError
from calibration.files.calibration_file import load_calibration
from calibration.simulated.face import SimulatedFace, marker_positions_mm, simulated_face
from lipservo.runtime.servos.sim_process import simulated_port
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

TRACKERS: Final = ("computed", "csv", "json")
_FACE, _JOINT = "face_jaw", "jaw"
_LOOK_S: Final = 0.02
_NOISE_MM: Final = 0.3


@dataclass(frozen=True, slots=True)
class KilledCapture:
    """A capture that was killed `at_s` after its start. why: what went wrong; empty: nothing."""

    tracker: str
    at_s: float
    why: str


@dataclass(slots=True)
class _ExternalTracker:
    """Stands for a tracking program of a user's, which only sees the request file of poses.

    path: the CSV or JSON file that it writes. requested: numbers of the poses seen in requests.
    """

    path: Path
    face: SimulatedFace
    requested: list[int] = field(default_factory=list)
    over: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        """Add a reading for each newly requested pose until `over` is set."""
        request = self.path.with_name(f"{self.path.name}.pose.json")
        seen_ns: object = None
        while not self.over.wait(_LOOK_S):
            try:
                # The request tells its pose and the angles at which the servos stand, degrees.
                now_ns, stands = request.stat().st_mtime_ns, json.loads(request.read_text())
            except (OSError, ValueError):
                continue
            if now_ns != seen_ns:
                seen_ns = now_ns
                self.requested.append(stands["pose"])
                self._record(stands["pose"], np.array([[stands["servos_deg"][_JOINT]]]))

    def _record(self, pose: int, stands_deg: Array) -> None:
        """Append a row for each marker of a pose to the CSV or JSON file, with noise.

        stands_deg: (1, 1), angle of the one servo. The noise depends on the pose alone. A JSON file
        is replaced whole, a CSV file is appended to.
        """
        noise = np.random.default_rng([pose, 7]).normal(0.0, _NOISE_MM, (47, 3))
        places = (marker_positions_mm(self.face, stands_deg)[0] + noise).round(3).tolist()
        rows = [
            {"pose": pose, "marker": name, "x_mm": x, "y_mm": y, "z_mm": z}
            for name, (x, y, z) in zip(MARKERS_47.names, places, strict=True)
        ]
        if self.path.suffix == ".json":
            before = json.loads(self.path.read_text()) if self.path.exists() else []
            partial = self.path.with_suffix(".new")
            partial.write_text(json.dumps(before + rows))
            partial.replace(self.path)
            return
        with self.path.open("a") as file:
            if not file.tell():
                file.write(",".join(rows[0]) + "\n")
            file.writelines(",".join(map(str, row.values())) + "\n" for row in rows)


def killed_captures(
    model: FaceWithAnimPhos, seed: int, n_kills: int, trackers: Sequence[str] = TRACKERS
) -> list[KilledCapture]:
    """Kill `n_kills` captures with each of `trackers` at drawn times, and resume them.

    Returns one result for each; if a capture fails that is not killed at all, only that one.
    """
    captures = []
    for tracker in trackers:
        began_s = time.monotonic()
        failure = _resume_failure(model, tracker, None)
        whole_s = time.monotonic() - began_s
        if failure:
            return [KilledCapture(tracker, 0.0, f"not killed at all: {failure}")]
        rng = np.random.default_rng([seed, TRACKERS.index(tracker), 71])
        for at_s in rng.uniform(0.0, whole_s, n_kills).tolist():
            captures.append(KilledCapture(tracker, at_s, _resume_failure(model, tracker, at_s)))
    return captures


def resumed_figures(captures: Sequence[KilledCapture]) -> dict[str, object]:
    """Return the share of killed captures that ended in a whole calibration; list the others."""
    return {
        "resumed": sum(not each.why for each in captures) / max(len(captures), 1),
        "resumed_of": len(captures),
        "not_resumed": [f"{c.tracker}, {c.at_s:.1f} s: {c.why}" for c in captures if c.why],
    }


def _resume_failure(model: FaceWithAnimPhos, tracker: str, at_s: float | None) -> str:
    """Return what went wrong with a capture that is killed at `at_s` and resumed; empty: nothing.

    at_s: seconds after its start; None: it is not killed.
    """
    rest_mm = model.markers_mm(model.rest[None])[0]
    with (
        tempfile.TemporaryDirectory() as name,
        simulated_port(["--config", _FACE, "--on-time"]) as port,
    ):
        folder = Path(name)
        out, markers = folder / "jaw.calibration.yaml", folder / f"markers.{tracker}"
        computed = tracker == "computed"
        program = _ExternalTracker(markers, simulated_face(rest_mm, [_JOINT]))
        seen_by = ["--sim", "pty"] if computed else ["--port", port, "--tracker", str(markers)]
        command = [
            sys.executable, "-m", "lipservo", "calibrate", "measure", "--config", _FACE, *seen_by,
            "--poses", "9", "--speed", "400", "--accept", "--quiet", "-o", str(out),
        ]  # fmt: skip
        with _run_beside(None if computed else program):
            if at_s is not None:
                _run(command, at_s)
            done = _run(command, None)
        if done.returncode:
            return done.stderr.strip().splitlines()[-1][:200]
        try:
            made = load_calibration(out)
        except CalibrationError as error:
            return str(error)
        if made.grade is None or made.following is None or not made.following.lag_s.any():
            return "the calibration has no grade, or no lags"
        twice = [pose for pose in set(program.requested) if program.requested.count(pose) > 1]
        # The pose that stood when it was killed may be requested again: it was not recorded.
        return f"poses {twice} were requested twice" if len(twice) > 1 else ""


@contextmanager
def _run_beside(tracker: _ExternalTracker | None) -> Iterator[None]:
    """Run an external tracker in a thread until the block ends; None: run nothing."""
    if tracker is None:
        yield
        return
    thread = threading.Thread(target=tracker.run, name="tracker", daemon=True)
    thread.start()
    try:
        yield
    finally:
        tracker.over.set()
        thread.join()


def _run(command: Sequence[str], kill_at_s: float | None) -> "subprocess.CompletedProcess[str]":
    """Run a command to its end, or kill it after `kill_at_s` with SIGKILL; None: to its end."""
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            _, stderr = process.communicate(timeout=kill_at_s)
        except subprocess.TimeoutExpired:
            process.kill()
            _, stderr = process.communicate()
    return subprocess.CompletedProcess(list(command), process.returncode, "", stderr)
