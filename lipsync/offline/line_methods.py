"""The methods that turn a spoken line into faces: model-based, heard and live.

"model-based" is that of Edge, Hilton and Jackson, "heard" our own. Both plan the whole line; the
plan is a synthesiser too, and passes the same finishing step as live motion. "live" moves the mouth
as a running face does.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from lipsync.arrays import Array, in_blocks
from lipsync.expectation.expectation import Expectation, PhonemeTrack, contexts, track_of
from lipsync.expectation.soft_expectation import SoftExpectation, softened_line
from lipsync.face.frame import Frame
from lipsync.face.model import FaceModel
from lipsync.motion.finishing import (
    LONGEST_LOOKAHEAD_S,
    USED_LOOKAHEAD_S,
    FinishedSynthesizer,
    Style,
)
from lipsync.motion.live_synthesizer import LEAD, LiveSynthesizer
from lipsync.motion.tick_plan import TICK_S
from lipsync.offline.offline_model import OfflineModel, at_times, cepstra
from lipsync.phonemes import FramePosteriors, PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline


class PlannedMotion:
    """A synthesiser that plays planned faces, by a cubic spline through them, and their phonemes.

    faces: (n, n_components) at `frame_rate_hz`, the first at sound time 0; before the first and
    after the last face, that face stays. events: the phonemes.
    """

    def __init__(
        self, faces: Array, frame_rate_hz: float, events: tuple[PhonemeEvent, ...]
    ) -> None:
        """Lay a spline through the faces and join the phonemes; parameters: see the class."""
        self._last_s = (len(faces) - 1) / frame_rate_hz
        times_s = np.arange(len(faces)) / frame_rate_hz
        self._spline = CubicSpline(times_s, faces) if len(faces) > 1 else None
        self._faces = faces
        self._timeline = PhonemeTimeline(math.inf)
        self._timeline.apply(PhonemeUpdate(0.0, math.inf, math.inf, events))
        self._track = track_of(events)

    @property
    def phonemes_planned(self) -> int:
        """The number of phonemes of the line, silences included; all of them are planned."""
        return len(self._timeline.events)

    @property
    def lookahead_s(self) -> float:
        """Seconds of sound needed after a frame's time: 0, as the whole line is known before."""
        return 0.0

    @property
    def track(self) -> PhonemeTrack:
        """The phonemes of the whole line, end to end."""
        return self._track

    def reset(self) -> None:
        """Do nothing: a planned line is the same for every stream."""

    def push(self, update: PhonemeUpdate) -> None:
        """Raise ValueError: a planned line accepts no revision of its phonemes."""
        raise ValueError(f"a planned line accepts no later phonemes ({update})")

    def frame_at(self, time_s: float) -> Frame:
        """Return the planned frame at sound time `time_s`; times may come in any order."""
        at_s = min(max(time_s, 0.0), self._last_s)
        face = self._faces[0] if self._spline is None else self._spline(at_s)
        return Frame(time_s, np.asarray(face))

    def faces_after(self, frame: Frame, times_s: Array) -> Array:  # noqa: ARG002 - a contract
        """Return the planned faces at the sound times `times_s`.

        Parameters
        ----------
        frame : Frame
            The newest frame; not used.
        times_s : Array
            (k,) sound times.

        Returns
        -------
        Array
            (k, n_components).
        """
        return np.array([self.frame_at(time_s).coefficients for time_s in times_s.tolist()])

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """Return the phoneme of the line at sound time `time_s`, or None outside the line."""
        return self._timeline.event_at(time_s)


def shown_faces(line: FinishedSynthesizer, times_s: Sequence[float] | Array) -> Array:
    """Return a line's faces at `times_s`; compute one every 10 ms in between, as on a robot.

    Parameters
    ----------
    line : FinishedSynthesizer
        The synthesiser of the line.
    times_s : Sequence[float] | Array
        (n,) sound times in s, ascending.

    Returns
    -------
    Array
        (n, n_components).
    """
    faces, n_ticks = [], 0
    for time_s in times_s:
        # The finishing step decides ticks in order, so each must be computed once.
        while n_ticks * TICK_S < time_s - 1e-6:
            line.frame_at(n_ticks * TICK_S)
            n_ticks += 1
        faces.append(line.frame_at(float(time_s)).coefficients)
    return np.array(faces)


LineMethod = Literal["heard", "model-based", "live"]
#: Which of them `render` uses: the nearest to the recordings (docs/decisions/scripted-lines.md).
DEFAULT_METHOD: LineMethod = "heard"
#: The faces expected from sound count so much in `heard_line`, those from phonemes alone the rest.
_SOUND_SHARE = 0.5
#: `LEAD` is the share of the motion over so long, s, by which faces are moved on.
_LEAD_OVER_S = 0.04


@dataclass(frozen=True, slots=True)
class Line:
    """A spoken line: phones in order without gaps from 0 to the end, and 16 kHz samples (n,).

    posteriors: the recogniser's phoneme probabilities, if it recognised the phones; None where the
    phones were given.
    """

    events: tuple[PhonemeEvent, ...]
    samples: NDArray[np.float32]
    posteriors: FramePosteriors | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Speaker:
    """The models that predict a speaker's face.

    face: the face model whose coefficients they predict. expectation: predicts mean faces from
    decided phonemes. offline: the model for rendered lines. soft: predicts mean faces from the
    recogniser's probabilities of phonemes; None: decided phonemes alone move the face.
    """

    face: FaceModel
    expectation: Expectation
    offline: OfflineModel
    soft: SoftExpectation | None = None


@dataclass(frozen=True, slots=True)
class PlannedLine:
    """The planned faces (n, n_components) of a line at `frame_rate_hz`, and notes to the user."""

    faces: Array
    frame_rate_hz: float
    notes: tuple[str, ...] = ()


def heard_line(speaker: Speaker, line: Line, n_frames: int) -> PlannedLine:
    """Return the first `n_frames` faces of a line by our own method, from its phonemes and sound.

    Faces are at the offline model's frame rate. The sound is used for a known voice only; for
    another one the result has a note. Where the line has posteriors (the recogniser's probabilities
    of phonemes), doubted phonemes count with their probability, as live. Faces are averaged over
    three ticks and then moved on by a share of their last step.
    """
    rate_hz = speaker.offline.states.frame_rate_hz
    times_s = np.arange(n_frames) / rate_hz
    # Each time with the ticks before and after it, (3 n_frames,), for the average below.
    ticks_s = np.maximum(times_s + TICK_S * np.array([[-1.0], [0.0], [1.0]]), 0.0).ravel()
    phonemes, border_s = contexts(track_of(line.events), ticks_s, USED_LOOKAHEAD_S)
    lookahead_s = np.full(len(ticks_s), USED_LOOKAHEAD_S)
    # The faces expected from phonemes.
    faces = in_blocks(
        lambda rows: speaker.expectation.faces(phonemes[rows], border_s[rows], lookahead_s[rows]),
        len(ticks_s),
    )
    if speaker.soft is not None and line.posteriors is not None:
        faces = softened_line(speaker.soft, faces, line.events, line.posteriors, ticks_s)
    notes: tuple[str, ...] = ("unknown voice: only phonemes are used",)
    if speaker.offline.voice.knows(line.samples):
        # Half-way from these to the faces expected from phonemes and sound.
        sound, line_cepstra = speaker.offline.sound, cepstra(line.samples)
        sound_faces = in_blocks(
            lambda rows: sound.faces(line.events, line_cepstra, ticks_s[rows]), len(ticks_s)
        )
        faces, notes = faces + _SOUND_SHARE * (sound_faces - faces), ()
    # The weighted mean of the three ticks.
    before, at_time, after = faces.reshape(3, n_frames, -1)
    mean = (before + 2.0 * at_time + after) / 4.0
    # The last step, as long as 40 ms would be.
    steps = np.diff(mean, axis=0, prepend=mean[:1]) * (_LEAD_OVER_S * rate_hz)
    return PlannedLine(mean + LEAD * steps, rate_hz, notes)


def model_based_line(speaker: Speaker, line: Line, n_frames: int) -> PlannedLine:
    """Return the first `n_frames` faces of a line by the method of Edge, Hilton and Jackson.

    Faces are coefficients of the speaker's face model, at the offline model's frame rate. A note
    gives the number of steps between states that no recording contains, if there are any.
    """
    from lipsync.offline.line_synthesis import model_line  # needs the extra `offline`

    states, face = speaker.offline.states, speaker.face
    times_s = np.arange(n_frames) / states.frame_rate_hz
    modelled = model_line(states, at_times(cepstra(line.samples), times_s), line.events)
    points_mm = states.mean_mm + modelled.motion @ states.basis
    faces = face.coefficients(points_mm.reshape(-1, *face.mean_mm.shape))
    notes: tuple[str, ...] = ()
    if modelled.path.n_breaks:
        notes = (f"{modelled.path.n_breaks} steps that no recording shows",)
    return PlannedLine(faces, states.frame_rate_hz, notes)


_PLANNED: dict[LineMethod, Callable[[Speaker, Line, int], PlannedLine]] = {
    "model-based": model_based_line,
    "heard": heard_line,
}
#: The methods that need the whole line beforehand.
PLANNED_METHODS = tuple(_PLANNED)


def line_synthesizer(
    speaker: Speaker, line: Line, method: LineMethod, strength: float = 1.0
) -> tuple[FinishedSynthesizer, Sequence[str]]:
    """Return a synthesiser that plays a spoken line by `method`, and notes to the user.

    The synthesiser adds rest in pauses and lip closures, and scales the motion by `strength`: 0
    keeps the mouth at rest, 1 changes nothing.
    """
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
    # Rest and closures ask for the next pause and onset, and so much look-ahead shows both.
    finished = FinishedSynthesizer(speaker.face, motion, strength, known_s=USED_LOOKAHEAD_S)
    return finished, planned.notes
