"""How a line becomes faces: the published method, ours, and the live strategy."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.expectation.context import contexts, track_of
from lipsync.expectation.expectation import Expectation
from lipsync.face.model import FaceModel
from lipsync.motion.expected_motion import LEAD, USED_LOOKAHEAD_S
from lipsync.motion.live_synthesizer import LONGEST_LOOKAHEAD_S, LiveSynthesizer, Style
from lipsync.motion.tick_plan import TICK_S
from lipsync.motion.wrapped_synthesizer import WrappedSynthesizer
from lipsync.offline.cepstra import at_times, cepstra
from lipsync.offline.offline_model import OfflineModel
from lipsync.offline.planned_motion import PlannedMotion
from lipsync.offline.wrapped_line import wrapped_line
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate

LineMethod = Literal["heard", "model-based", "live"]
METHODS: tuple[LineMethod, ...] = get_args(LineMethod)
#: Which of them `render` uses: the nearest to the recordings (docs/decisions/0029).
DEFAULT_METHOD: LineMethod = "heard"
#: The expectation of sound counts so much, the live one, of phonemes alone, the rest.
_SOUND_SHARE = 0.5
#: What `LEAD` is a share of: the step over so long.
_LEAD_OVER_S = 0.04


@dataclass(frozen=True, slots=True)
class Line:
    """What is said: phones in order without gaps from 0 to the end, and 16 kHz samples (n,)."""

    events: tuple[PhonemeEvent, ...]
    samples: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Speaker:
    """A face, what is expected of it live, and offline."""

    face: FaceModel
    expectation: Expectation
    offline: OfflineModel


@dataclass(frozen=True, slots=True)
class PlannedLine:
    """Faces (n, n_components) at even times, and in one line each what a person should know."""

    faces: Array
    frame_rate_hz: float
    notes: tuple[str, ...] = ()


def heard_line(speaker: Speaker, line: Line, n_frames: int) -> PlannedLine:
    """Ours: what is expected by the phonemes of the line and, of a known voice, by its sound.

    As live, the mean over neighbouring ticks, and a little more of where it is going.
    """
    rate_hz = speaker.offline.states.frame_rate_hz
    times_s = np.arange(n_frames) / rate_hz
    around_s = np.maximum(times_s + TICK_S * np.array([[-1.0], [0.0], [1.0]]), 0.0).ravel()
    phonemes, known_s = contexts(track_of(line.events), around_s, USED_LOOKAHEAD_S)
    ahead_s = np.full(len(around_s), USED_LOOKAHEAD_S)
    faces = speaker.expectation.faces(phonemes, known_s, ahead_s)
    notes: tuple[str, ...] = ("another voice: phonemes alone are believed",)
    if speaker.offline.voice.knows(line.samples):
        told = speaker.offline.sound.faces(line.events, cepstra(line.samples), around_s)
        faces, notes = faces + _SOUND_SHARE * (told - faces), ()
    before, there, after = faces.reshape(3, n_frames, -1)
    mean = (before + 2.0 * there + after) / 4.0
    # The last step, as long as 40 ms would be.
    steps = np.diff(mean, axis=0, prepend=mean[:1]) * (_LEAD_OVER_S * rate_hz)
    return PlannedLine(mean + LEAD * steps, rate_hz, notes)


def model_based_line(speaker: Speaker, line: Line, n_frames: int) -> PlannedLine:
    """The published method, projected on the components of the face."""
    from lipsync.offline.line_synthesis import model_line  # needs the extra `offline`

    states, face = speaker.offline.states, speaker.face
    times_s = np.arange(n_frames) / states.frame_rate_hz
    made = model_line(states, at_times(cepstra(line.samples), times_s), line.events)
    points_mm = states.mean_mm + made.motion @ states.basis
    faces = face.coefficients(points_mm.reshape(-1, *face.mean_mm.shape))
    notes: tuple[str, ...] = ()
    if made.path.n_breaks:
        notes = (f"{made.path.n_breaks} steps that no recording shows",)
    return PlannedLine(faces, states.frame_rate_hz, notes)


_PLANNED: dict[LineMethod, Callable[[Speaker, Line, int], PlannedLine]] = {
    "model-based": model_based_line,
    "heard": heard_line,
}
#: Those that need the whole line.
PLANNED_METHODS = tuple(_PLANNED)


def line_synthesizer(
    speaker: Speaker, line: Line, method: LineMethod, strength: float = 1.0
) -> tuple[WrappedSynthesizer, Sequence[str]]:
    """What plays a line, strength, rest and closures around it, and notes for a person."""
    duration_s = max((e.end_s or 0.0 for e in line.events), default=0.0)
    if method == "live":
        synthesizer = LiveSynthesizer(
            speaker.face, speaker.expectation, Style(LONGEST_LOOKAHEAD_S, strength)
        )
        synthesizer.push(PhonemeUpdate(0.0, np.inf, np.inf, line.events))
        return synthesizer, ()
    n_frames = int(np.ceil(duration_s * speaker.offline.states.frame_rate_hz)) + 1
    planned = _PLANNED[method](speaker, line, n_frames)
    motion = PlannedMotion(planned.faces, planned.frame_rate_hz, line.events)
    return wrapped_line(speaker.face, motion, strength), planned.notes
