"""The lips that a calibrated robot shows of a motion, by its encoders, on a virtual clock.

The robot is `face_sim`: calibration, targets, gate and bridge are those of a running face, its
servos are simulated to the byte, and its geometry is known, so encoders tell where its lips are.

Motion that is known beforehand, played as a synthesiser would.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from calibration.simulated.face import marker_positions_mm, simulated_face
from firmware_bridge.loop.life_cycle import LifeCycle
from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.measured_calibration import fit_simulated_face
from lipservo.runtime.servos.assembly import (
    Face,
    assemble_face,
    bridge_for,
    mouth_rules,
    simulated_wire,
)
from lipservo.runtime.speech.speech import Speech, SpeechOptions
from lipservo.runtime.speech.speech_side import SpeechSide, mouth_plan
from lipservo.runtime.street import Street
from lipservo_lab.evaluation.readability.readers import Motions
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.audio.playback_clock import SteadyClock
from lipsync.errors import UserError
from lipsync.face.frame import FaceWindow, Frame
from lipsync.face.model import FaceModel
from lipsync.markers import MARKERS_47
from lipsync.motion.finishing import lip_gap_of
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate
from lipsync.recognition.scripted import ScriptedPhonemes


class PlayedMotion:
    """A `Synthesizer` that plays given faces, linearly interpolated."""

    lookahead_s = 0.0
    phonemes_planned = 0

    def __init__(self, times_s: Array, faces: Array, model: FaceModel) -> None:
        """Play `faces`, (n, n_components) of the model, at ascending sound times (n,)."""
        self._times_s = times_s
        self._faces = faces
        self._gap = lip_gap_of(model)

    def reset(self) -> None:
        """Do nothing: no state is kept."""

    def push(self, update: PhonemeUpdate) -> None:
        """Ignore phonemes."""

    def frame_at(self, time_s: float) -> Frame:
        """Return the face at a sound time, s; the first or last face outside their times."""
        columns = [np.interp(time_s, self._times_s, column) for column in self._faces.T]
        return Frame(time_s, np.array(columns))

    def window_after(self, frame: Frame) -> FaceWindow:
        """Return the faces of the next 200 ms, and where their lips begin to touch."""
        times_s = frame.time_s + _AHEAD_S
        columns = [np.interp(times_s, self._times_s, column) for column in self._faces.T]
        faces = np.stack(columns, axis=1)
        closed = self._gap.begin_to_touch(faces)
        return FaceWindow(_AHEAD_S, faces, closed, self._gap.shut(frame.coefficients))

    def event_at(self, time_s: float) -> PhonemeEvent | None:  # noqa: ARG002 - knows no phonemes
        """Return None: the phonemes of the motion are not known."""
        return None


#: As a performance plays: `lipsync.offline.performed_motion`.
_AHEAD_S: Final[Array] = np.linspace(0.0, 0.2, 11)

ROBOT: Final = "face_sim"
#: From one sentence to the next the mouth goes so slowly that nothing is left of it.
_PAUSE_S: Final = 0.5
#: The face is brought up in this time, at rest.
_LEAD_IN_S: Final = 1.0

#: How one says how far it has got: number, of how many.
Progress = Callable[[int, int], None]


def calibrated_robot(model: FaceWithAnimPhos) -> Face:
    """Return `face_sim`, calibrated for the model as `lipservo calibrate fit` does it.

    The servos' lags are those of the shipped calibration. Raises UserError for a model of other
    points than the robot is measured at.
    """
    if model.layout.names != MARKERS_47.names:
        raise UserError(f"{ROBOT} needs a model of 47 markers, not {model.layout.name}")
    shipped_face = assemble_face(ROBOT, None)
    setup = CalibrationSetup(shipped_face.settings, model, quiet=True, lags=False)
    calibration = fit_simulated_face(setup).calibration
    following = shipped_face.calibration.following
    complete = replace(calibration, following=following, rules=mouth_rules(shipped_face.settings))
    return replace(shipped_face, model=model, calibration=complete)


@dataclass(frozen=True, slots=True)
class _Sequence:
    """Sentences one after the other as knots of one motion: times_s (n,), faces (n, n_components).

    begins_s: sound time at which each sentence begins.
    """

    times_s: Array
    faces: Array
    begins_s: Mapping[str, float]

    @property
    def end_s(self) -> float:
        return float(self.times_s[-1]) + _PAUSE_S


def shown_markers_mm(
    robot: Face, faces: Motions, rate_hz: float, seen_at_hz: float, progress: Progress
) -> dict[str, Array]:
    """Play sentences on the simulated robot, in one go; return the markers that it shows.

    Parameters
    ----------
    robot : Face
        A calibrated face.
    faces : Motions
        (n, n_components) at rate_hz, two at least, by sentence.
    rate_hz,seen_at_hz : float
        Rate of the faces, and of the markers returned.
    progress : Progress
        Called with the seconds played, and all seconds.

    Returns
    -------
    dict[str, Array]
        (n_frames, 47, 3) mm by sentence.
    """
    sequence = _join_sentences(robot, faces, rate_hz)
    sound_s, encoders_deg = _play_on_robot(robot, sequence, progress)
    neutral_mm = robot.model.markers_mm(robot.model.rest[None])[0]
    geometry = simulated_face(neutral_mm, robot.calibration.servo_names)
    shown = {}
    for name, sentence_faces in faces.items():
        times_s = np.arange(0.0, len(sentence_faces) / rate_hz, 1.0 / seen_at_hz)
        at_s = sequence.begins_s[name] + times_s
        columns = [np.interp(at_s, sound_s, column) for column in encoders_deg.T]
        shown[name] = marker_positions_mm(geometry, np.stack(columns, axis=1))
    return shown


def _join_sentences(robot: Face, faces: Motions, rate_hz: float) -> _Sequence:
    """Return all sentences one after the other, with pauses between, as knots 10 ms apart.

    Faces, (n, n_components) at `rate_hz`, are joined by cubic splines; each sentence begins and
    ends at its own first and last face.
    """
    knots_s, knot_faces = [np.zeros(1)], [robot.model.rest[None]]
    begins_s: dict[str, float] = {}
    begin_s = _LEAD_IN_S
    for name, sentence_faces in faces.items():
        begins_s[name] = begin_s
        times_s = np.arange(len(sentence_faces)) / rate_hz
        # Between recorded frames a mouth goes without corners: servos stumble over those.
        dense_s = np.arange(0.0, times_s[-1] + TICK_S / 2, TICK_S)
        knots_s.append(begin_s + dense_s)
        knot_faces.append(CubicSpline(times_s, sentence_faces)(dense_s))
        begin_s += len(sentence_faces) / rate_hz + _PAUSE_S
    return _Sequence(np.concatenate(knots_s), np.concatenate(knot_faces), begins_s)


def _play_on_robot(robot: Face, sequence: _Sequence, progress: Progress) -> tuple[Array, Array]:
    """Play motion on the simulated robot; return sound times (n,) and encoders (n, n_servos), deg.

    Times ascend; encoders are those of the mouth's servos.
    """
    bus, clock = simulated_wire(robot.settings)
    motion = PlayedMotion(sequence.times_s, sequence.faces, robot.model)
    names, channel = list(robot.settings.servos), MemoryTargetChannel()
    phonemes, sound = ScriptedPhonemes(()), SteadyClock()
    options = SpeechOptions(plan=mouth_plan(robot))
    speech = Speech(phonemes, sound, motion, robot.calibration, names, channel, options)
    bridge = bridge_for(robot.settings, bus, channel, rate_hz=1.0 / TICK_S)
    street = Street(SpeechSide(speech, rest=robot.model.rest), bridge, robot.model.rest)
    mouth = street.speech.mouth
    sound_s: list[float] = []
    encoders_deg: list[Array] = []
    with bus, LifeCycle(street.bridge, clock) as life:
        life.start()
        street.begin(clock.now())
        for time_s, late in life.ticks():
            street.tick(time_s, late)
            sound_s.append(street.speech.sound_time_s(clock.now()))
            encoders_deg.append(bus.feedback().positions_deg[mouth])
            progress(round(max(0.0, sound_s[-1])), round(sequence.end_s))
            if sound_s[-1] >= sequence.end_s:
                break
    return np.array(sound_s), np.array(encoders_deg)
