"""`lipservo calibrate measure`: the face's own servos, and whoever sees the markers on them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture import Capture, Robot
from calibration.capture.trackers import FileTracker, SeenByComputation, Tracker, TypedTracker
from calibration.simulated.practice_robot import markers_of_face
from calibration.simulated.robot import SENSOR_NOISE_MM
from firmware_bridge.dynamixel.control_table import servo_models
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
#: Share of its current cap from which a servo counts as pressing: what it measures is noisy.
_STRAINED = 0.9


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
                setup,
                tracker.marker_names,
                Robot(
                    move,
                    tracker.measure,
                    tracker.arrived,
                    strained=lambda: strained_servo(setup, face.effort),
                ),
                seed=seed,
            )
            result = fit_capture(setup, capture).with_memories(memories)
            # Poses to grade by go on where the numbers of the others end.
            n_taken = capture.n_planned
            result = result.graded_by(
                setup,
                Robot(
                    move,
                    tracker.measure,
                    lambda pose, reached_deg: tracker.arrived(n_taken + pose, reached_deg),
                ),
            )
        finally:
            if isinstance(tracker, FileTracker):
                tracker.close()
        return with_lags(setup, face, result) if setup.lags else result


def calibrate_on_computed_skin(setup: CalibrationSetup) -> CalibrationResult:
    """A rehearsal: the servos are moved, and the markers computed from where they stand."""
    markers_of = markers_of_face(setup.model.markers_mm(setup.model.rest[None])[0], setup.servos)
    noise = np.random.default_rng(0)

    def look(reached_deg: Array) -> Array:
        exact_mm = markers_of(reached_deg[None])[0]
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
    setup: CalibrationSetup, marker_names: tuple[str, ...], on: Robot, *, seed: int
) -> Capture:
    """All poses of the face's procedure, with a progress bar."""
    with progress_bar(setup, "poses", setup.n_poses) as done:
        return setup.procedure(seed).capture(
            marker_names,
            on.move,
            on.measure,
            keep=setup.keep,
            arrived=on.arrived,
            progress=done,
            strained=on.strained,
            told=_say,
        )


def strained_servo(setup: CalibrationSetup, effort: Array) -> str | None:
    """Who draws nearly all of its `max_current_ma`; None where no model measures, or none does.

    effort: (n_servos,), of the mouth, in stall torques.
    """
    models = servo_models()
    for (name, servo), share in zip(setup.settings.mouth_servos.items(), effort, strict=True):
        model = models[servo.model]
        if servo.max_current_ma is None or not model.measures_current:
            continue
        if share * model.stall_a * 1e3 >= _STRAINED * servo.max_current_ma:
            _say(f"{name} draws its max_current_ma: lips are closed no farther than this")
            return name
    return None


def _say(line: str) -> None:
    MESSAGES.print(line, soft_wrap=True, highlight=False)
