"""The making of a requested film: one motion on a face, or two side by side."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lipservo.display.film import Display, write_film
from lipservo.display.filmed_motion import FilmedMotion, SpeechRequest, filmed, filmed_trace
from lipservo.display.photo_display import PhotoDisplay
from lipservo.display.photo_face import PhotoError, PhotoFace, photo_face
from lipservo.display.photo_file import framed, read_landmarks, read_photo, tracked
from lipservo.display.robot_display import RobotDisplay
from lipservo.display.shipped_faces import twin_face
from lipservo.runtime.motion_options import ChosenMotion, motion_options
from lipservo.runtime.servos.assembly import assemble_face, load_settings
from lipservo.settings.motion_names import ON_STAGE, STRATEGIES
from lipservo.terminal.output import Advance
from lipsync.errors import UserError
from lipsync.face.model import FaceModel, load_face
from lipsync.offline.performance import SUFFIX
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.video.face_detection import Picture
from lipsync.video.face_tracker import open_tracker

#: The shipped face by whose expression settings head and eyes move, unless they are to be still.
_HEAD = "face_head"


@dataclass(frozen=True, slots=True)
class FilmRequest:
    """The options of a film as they were typed; `lipservo film --help` explains them."""

    speech: str | None
    output: Path
    face: str
    size: tuple[int, int]
    rate_hz: int
    config: str
    model: Path | None
    landmarks: Path | None = None
    landmarker: Path | None = None
    beside: str | None = None
    trace: Path | None = None
    script: LabelFile | None = None
    text: str = ""
    still_head: bool = False
    channel: str = ""


def make_film(request: FilmRequest, chosen: ChosenMotion, advance: Advance) -> dict[str, float]:
    """Make the film; return its number of pictures, its duration and the time spent, in s.

    chosen: options of the motion from the command line. advance: called with the name of the step,
    the number done and the number in all. Raises UserError.
    """
    began_s = time.perf_counter()
    # First the faces, so that an error in them is raised before the sound is recognised.
    displays = [_display(request)]
    if request.beside is not None:
        displays.append(_display(request))
    with ExitStack() as stack:
        advance("listening", 0, 1)
        if request.trace is not None:
            sound = None if request.speech is None else Path(request.speech)
            motions = [filmed_trace(request.trace, sound, request.model, request.rate_hz)]
        else:
            assert request.speech is not None
            speech = _speech_request(request, chosen)
            motions = [stack.enter_context(filmed(request.speech, speech, request.rate_hz))]
            if request.beside is not None:
                motions.append(_right_motion(request, chosen, motions[0], stack))
        advance("listening", 1, 1)
        n_all = len(motions[0].frames)
        n = write_film(
            _pictures(motions, displays),
            (sum(each.size[0] for each in displays), displays[0].size[1]),
            motions[0].sound,
            request.output,
            request.rate_hz,
            lambda n_done: advance("filming", n_done, n_all),
        )
    seconds = time.perf_counter() - began_s
    return {"pictures": n, "duration_s": n / request.rate_hz, "seconds": round(seconds, 3)}


class Beside:
    """Two displays of one frame, drawn side by side."""

    def __init__(self, left: Display, right: Display) -> None:
        self._displays = left, right

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels of both pictures side by side."""
        return sum(each.size[0] for each in self._displays), self._displays[0].size[1]

    def draw(self, frame: object) -> Picture:
        """Return the pictures of both displays side by side, (height, width, 3)."""
        return np.hstack([each.draw(frame) for each in self._displays])  # type: ignore[arg-type]


def photograph(
    path: Path,
    landmarks: Path | None,
    landmarker: Path | None,
    size: tuple[int, int],
    face: FaceModel,
) -> PhotoFace:
    """Read a photograph, cut it to a film's size and fit a head to it. Raises UserError.

    landmarks: file of the face's points; None: they are detected by the network in `landmarker`.
    size: width and height in px. face: the model that will move the head.
    """
    picture, share = read_photo(path)
    if landmarks is not None:
        points = read_landmarks(landmarks, share)
    else:
        points = tracked(picture, open_tracker(landmarker), str(path))
    try:
        return photo_face(*framed(picture, points, size), face)
    except PhotoError as error:
        raise PhotoError(f"{path}: {error}") from error


def _display(request: FilmRequest) -> Display:
    """Return the display of the requested face: the twin, the robot, both, or a photograph.

    The twin is the program's own head. Raises UserError.
    """
    face = load_face(request.model)
    if request.face == "twin":
        return PhotoDisplay(twin_face(face, request.size))
    if request.face == "robot":
        return RobotDisplay(
            assemble_face(request.config, request.model), request.size, 1 / request.rate_hz
        )
    if request.face == "beside":
        return Beside(
            _display(replace(request, face="twin")), _display(replace(request, face="robot"))
        )
    return PhotoDisplay(
        photograph(Path(request.face), request.landmarks, request.landmarker, request.size, face)
    )


def _speech_request(request: FilmRequest, chosen: ChosenMotion) -> SpeechRequest:
    """Return the request for the motion of the film's speech, completed by the face's YAML."""
    settings, folder = load_settings(request.config)
    # A robot is filmed as it would move; other faces move enough for viewers at 3 m.
    stage = 0.0 if request.face in ("robot", "beside") else ON_STAGE
    return SpeechRequest(
        motion_options(chosen, settings.motion, folder, stage),
        request.config,
        request.model,
        request.script,
        request.text,
        None if request.still_head else _HEAD,
        request.channel or settings.sound.channel,
    )


def _right_motion(
    request: FilmRequest, chosen: ChosenMotion, first: FilmedMotion, stack: ExitStack
) -> FilmedMotion:
    """Return the motion of the right face: of a performance, or by another strategy.

    `request.beside` names performance or strategy. The motion is cut, or its last frame held, to
    the length of `first`, the motion of the left face. Its sound file exists until `stack` is
    closed. chosen: options of the motion. Raises UserError.
    """
    assert request.beside is not None
    if Path(request.beside).suffix == SUFFIX:
        speech = _speech_request(request, chosen)
        right = stack.enter_context(filmed(request.beside, speech, request.rate_hz))
    else:
        if first.heard is None:
            raise UserError(f"--beside {request.beside}: needs a performance, as the first is one")
        strategy = next((each for each in STRATEGIES if each == request.beside), None)
        if strategy is None:
            raise UserError(
                f"--beside {request.beside}: name a performance (.perf), or {', '.join(STRATEGIES)}"
            )
        other = _speech_request(request, replace(chosen, strategy=strategy))
        speech = replace(first.heard, motion=other.motion)
        right = stack.enter_context(filmed(str(first.sound), speech, request.rate_hz))
    frames = right.frames[: len(first.frames)]
    frames += (frames[-1],) * (len(first.frames) - len(frames))
    return replace(right, frames=frames)


def _pictures(motions: Sequence[FilmedMotion], displays: Sequence[Display]) -> Iterator[Picture]:
    """Yield for each frame one picture, with the faces of all motions side by side."""
    drawers = [_drawer(motion, display) for motion, display in zip(motions, displays, strict=True)]
    for n in range(len(motions[0].frames)):
        yield np.hstack([draw(n) for draw in drawers])


def _drawer(motion: FilmedMotion, display: Display) -> Callable[[int], Picture]:
    """Return a function that draws picture n of a motion.

    A robot alone is drawn at the goals that a traced run sent to its servos, if there are any.
    """
    if isinstance(display, RobotDisplay) and motion.sent_deg is not None:
        robot, sent = display, motion.sent_deg
        return lambda n: robot.draw_angles(motion.servos, sent[n])
    return lambda n: display.draw(motion.frames[n])
