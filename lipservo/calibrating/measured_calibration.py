"""`lipservo calibrate measure`: the face's own servos, and whoever sees the markers on them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture import Capture, Measure, Move
from calibration.capture.trackers import FileTracker, SeenByComputation, Tracker, TypedTracker
from calibration.simulated.face import marker_positions_mm, simulated_face
from calibration.simulated.robot import SENSOR_NOISE_MM
from lipservo.calibrating.calibration_result import CalibrationResult, fit_capture
from lipservo.calibrating.calibration_setup import CalibrationSetup, held_servos, progress_bar
from lipservo.calibrating.servo_lags import with_lags
from lipservo.face.held_face import HeldFace
from lipservo.face.servos import servo_memories
from lipservo.terminal.keys import read_line
from lipservo.terminal.output import MESSAGES
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: What a person who types is asked for: the least that says how open and how wide a mouth is, and
#: the chin.
TYPED_MARKERS = ("inner_lip_13", "inner_lip_14", "outer_lip_61", "outer_lip_291", "outer_lip_17")
TYPED = "typed"


def calibrate_on_servos(
    setup: CalibrationSetup,
    make_tracker: Callable[[HeldFace], Tracker],
    passed: Callable[[Array], object] = lambda _: None,
    seed: int = 0,
) -> CalibrationResult:
    """Capture, fit, then the servos' lags.

    passed: hears of every place that the encoders came to, measured or not.
    """
    memories = servo_memories(setup.settings)
    with held_servos(setup) as face:
        tracker = make_tracker(face)

        def move(goal_deg: Array) -> Array:
            reached_deg = face.move(goal_deg)
            passed(reached_deg)
            return reached_deg

        try:
            capture = capture_face(
                setup, tracker.marker_names, move, tracker.measure, tracker.arrived, seed=seed
            )
        finally:
            if isinstance(tracker, FileTracker):
                tracker.close()
        result = fit_capture(setup, capture).with_memories(memories)
        return with_lags(setup, face, result) if setup.lags else result


def calibrate_on_computed_skin(setup: CalibrationSetup) -> CalibrationResult:
    """A rehearsal: the servos are moved, and the markers computed from where they stand."""
    names = setup.servos.names
    face = simulated_face(setup.model.markers_mm(setup.model.rest[None])[0], names)
    noise = np.random.default_rng(0)

    def look(reached_deg: Array) -> Array:
        exact_mm = marker_positions_mm(face, reached_deg[None])[0]
        return np.asarray(exact_mm + noise.normal(0.0, SENSOR_NOISE_MM, exact_mm.shape))

    return calibrate_on_servos(setup, lambda _: SeenByComputation(MARKERS_47.names, look))


def tracker_of(setup: CalibrationSetup, source: str, axes: str) -> Callable[[HeldFace], Tracker]:
    """`typed`, or the path of a file or folder that another program fills."""
    if source == TYPED:
        return lambda face: TypedTracker(
            TYPED_MARKERS, lambda question: face.hold_while(lambda: read_line(question))
        )
    path = Path(source)
    if not path.is_dir() and path.suffix.lower() not in (".csv", ".json"):
        raise CalibrationError(
            f"--tracker {source}: expected `typed`, a .csv or .json file, or a folder"
        )
    names = setup.servos.names
    return lambda face: FileTracker(path, names, face.hold, _say, axes=axes)


def capture_face(
    setup: CalibrationSetup,
    marker_names: tuple[str, ...],
    move: Move,
    measure: Measure,
    arrived: Callable[[int, Array], None] = lambda *_: None,
    *,
    seed: int,
) -> Capture:
    """All poses of the face's procedure, with a progress bar."""
    with progress_bar(setup, "poses", setup.n_poses) as done:
        return setup.procedure(seed).capture(
            marker_names, move, measure, keep=setup.keep, arrived=arrived, progress=done
        )


def _say(line: str) -> None:
    MESSAGES.print(line, soft_wrap=True, highlight=False)
