"""The figures of `lipservo bench speeds`: a mouth that asks of its joints what they can do.

Motion goes from phonemes, or from recorded frames, through calibration, plan and last gate to
shafts that turn no faster than their joint may. What the lips of a robot do at these shafts is
compared with the same motion at shafts without limits.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from calibration.closure import CLOSED_GAP_MM
from calibration.mouth_servos import MouthServos
from calibration.run.compensation import BacklashCompensation
from calibration.simulated.elastic_family import elastic_robot_of
from calibration.simulated.elastic_robot import N_PAIRS, ElasticFace
from calibration.simulated.practice_robot import USUAL_SEED, family_of, markers_of_face
from calibration.simulated.robot_family import RobotFamily
from firmware_bridge.clock import ManualClock
from firmware_bridge.gate.joint_plan import JointPlan, TargetWindow
from firmware_bridge.gate.limits import Limiter
from firmware_bridge.joints import Joint
from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.run_request import RunRequest, Sound
from lipservo.runtime.servos.assembly import Face, assemble_face
from lipservo.runtime.sound import open_sound
from lipservo.runtime.speech.speech import PUBLISH_PERIOD_S, Speech, SpeechOptions
from lipservo.runtime.speech.speech_side import mouth_plan
from lipservo_lab.bench.calibration.shown_motion import wanted_shapes
from lipservo_lab.bench.readability.robot_lips import PlayedMotion
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.evaluation.readability.reading_scores import reading_parts
from lipsync.animpho.units import FaceWithAnimPhos, load_face_with_animphos
from lipsync.arrays import Array
from lipsync.audio.playback_clock import SteadyClock
from lipsync.face.frame import Synthesizer
from lipsync.markers import MARKERS_47
from lipsync.motion.finishing import BILABIALS, LONGEST_LOOKAHEAD_S, Style
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate
from lipsync.recognition.scripted import ScriptedPhonemes

#: Degrees a second that every joint of the robot may do.
SPEEDS_DEG_S: Final = (400.0, 300.0, 200.0, 150.0)
#: Those that ship with a calibration.
FACES: Final = ("face_sim", "face_lips", "face_eight", "face_four", "face_jaw")
#: Those that are run, at this rate.
RUN: Final = ("face_head", *FACES)
_RUN_HZ: Final = 100.0
#: Their robots have lips: a foreign one, whose lips stop each other, and our own.
ROBOTS: Final = ("face_eight", "face_lips", "face_sim")
_TOUCH_MM: Final = 0.02
_WINDOW_S: Final = 0.040
#: Rounding of float64 is no violation.
_SAME_DEG: Final = 1e-6
#: Shapes are compared at every so manieth tick, 25 a second, as they were recorded.
_SPARSE: Final = 4
#: A mouth begins and ends a sentence at rest.
_AFTER_S: Final = 0.3
#: The largest shift in time that is looked for.
_MOST_SHIFT_S: Final = 0.1
_FINEST_S: Final = 0.001

#: How one says how far it has got: what, number, of how many.
Advance = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Sentence:
    """A spoken sentence, and the recorded faces (n, n_components) at 100 Hz from sound time 0."""

    phones: tuple[PhonemeEvent, ...]
    faces: Array

    @property
    def end_s(self) -> float:
        """When the last recorded face is shown."""
        return (len(self.faces) - 1) * PUBLISH_PERIOD_S


@dataclass(frozen=True, slots=True)
class Shafts:
    """What joints of a mouth did, (n, n_servos) degrees, at sound times k / 100 s from 0.

    goals_deg: the plan's goals; horn_deg: where it brought the horns, behind the play of
    the gears. n_rate_hits: goals that the last gate slowed down.
    """

    goals_deg: Array
    horn_deg: Array
    n_rate_hits: int


def sentences_of(corpus: Path, model: FaceWithAnimPhos, most: int) -> list[Sentence]:
    """The labelled sentences of a folder's `random_test`, `most` of them. Raises CorpusError."""
    recorded = read_grid(corpus, model.layout).labelled()
    test = reading_parts(corpus, recorded)[0].test
    found: list[Sentence] = []
    for utterance in recorded.utterances:
        if utterance.name in test and utterance.phones and len(found) < most:
            faces = model.coefficients(utterance.markers_mm)
            times_s = np.arange(len(faces)) / utterance.frame_rate_hz
            # Between recorded frames a mouth goes without corners: servos stumble over those.
            dense_s = np.arange(0.0, times_s[-1], PUBLISH_PERIOD_S)
            found.append(Sentence(utterance.phones, CubicSpline(times_s, faces)(dense_s)))
    return found


def shafts_of(
    face: Face,
    sentence: Sentence,
    synthesizer: Synthesizer,
    plan: JointPlan | None,
    speeds_deg_s: Array,
    play_deg: Array,
) -> Shafts:
    """Return the motion of a mouth's joints while a synthesiser follows a sentence's phonemes.

    Parameters
    ----------
    face : Face
        The robot.
    sentence : Sentence
        Its phonemes.
    synthesizer : Synthesizer
        The motion.
    plan : JointPlan | None
        Of the joints; None: the gate alone.
    speeds_deg_s : Array
        (n_servos,), of the shafts, infinite for those without limits.
    play_deg : Array
        (n_servos,), of their gears.

    Returns
    -------
    Shafts
        Goals and horns, (n, n_servos) degrees.
    """
    names = face.calibration.servo_names
    channel = MemoryTargetChannel(4096)
    phonemes = ScriptedPhonemes(sentence.phones)
    options = SpeechOptions(plan=plan)
    speech = Speech(phonemes, SteadyClock(), synthesizer, face.calibration, names, channel, options)
    speech.begin(0.0)
    goals: list[Array] = []
    n_ticks = round((sentence.end_s + _AFTER_S + speech.delay.total_s) / PUBLISH_PERIOD_S)
    for n in range(n_ticks):
        speech.advance(n * PUBLISH_PERIOD_S)
        for targets in channel.drain():
            if targets.time_s - speech.delay.total_s > -PUBLISH_PERIOD_S / 2:
                goals.append(targets.positions_deg)
    goals_deg = np.array(goals)
    if np.isinf(speeds_deg_s).all():
        return Shafts(goals_deg, goals_deg, 0)
    servos = [face.settings.servos[name] for name in names]
    joints = [
        Joint(name, n, servo.min_deg, servo.max_deg, float(speed_deg_s))
        for n, (name, servo, speed_deg_s) in enumerate(
            zip(names, servos, speeds_deg_s, strict=True)
        )
    ]
    gate = Limiter(joints, PUBLISH_PERIOD_S)
    gate.start_from(goals_deg[0], -PUBLISH_PERIOD_S)
    sent = [gate.apply(goal_deg, n * PUBLISH_PERIOD_S) for n, goal_deg in enumerate(goals_deg)]
    n_hits = int(gate.counts.rate_hits.sum())
    return Shafts(goals_deg, _behind(play_deg, [each.positions_deg for each in sent]), n_hits)


def _behind(play_deg: Array, shafts_deg: Sequence[Array]) -> Array:
    """Where horns stand whose shafts (n_servos,) turn so; in the middle of their play at first."""
    horn_deg, horns_deg = shafts_deg[0], []
    for shaft_deg in shafts_deg:
        horn_deg = np.clip(horn_deg, shaft_deg - play_deg / 2, shaft_deg + play_deg / 2)
        horns_deg.append(horn_deg)
    return np.array(horns_deg)


def exact(face: Face) -> Face:
    """The same with servos that are neither late nor loose, and nothing made up for."""
    return replace(face, calibration=replace(face.calibration, following=None))


def in_time(face: Face) -> Face:
    """The same with servos that are loose, but not late: the shafts of `shafts_of` are not."""
    following = face.calibration.following
    if following is None:
        return face
    following = replace(following, lag_s=np.zeros_like(following.lag_s))
    return replace(face, calibration=replace(face.calibration, following=following))


def plan_at(speeds_deg_s: Array) -> JointPlan:
    """Return the plan of joints whose acceleration is not limited.

    Parameters
    ----------
    speeds_deg_s : Array
        (n_joints,) degrees per second.

    Returns
    -------
    JointPlan
        The plan.
    """
    return JointPlan(speeds_deg_s, np.full(len(speeds_deg_s), math.inf), PUBLISH_PERIOD_S)


def _grid_s(n: int) -> Array:
    return np.asarray(np.arange(n) * PUBLISH_PERIOD_S, dtype=np.float64)


def no_plan(_: Array) -> None:
    """Return no plan: the gate alone limits speeds.

    Parameters
    ----------
    _ : Array
        (n_joints,), not used.

    Returns
    -------
    None
        None.
    """


def recorded_motion(sentence: Sentence, model: FaceWithAnimPhos) -> PlayedMotion:
    """What was recorded, as a scripted line plays it: all of it is known beforehand."""
    times_s = _grid_s(len(sentence.faces))
    return PlayedMotion(times_s, sentence.faces, model)


def scripted_motion(sentence: Sentence, model: FaceWithAnimPhos) -> PlayedMotion:
    """The sentence rendered from its phonemes, as a scripted line plays it."""
    events = sentence.phones
    line = make_synthesizer(model, MotionOptions(style=Style(LONGEST_LOOKAHEAD_S)))
    line.push(PhonemeUpdate(0.0, math.inf, math.inf, events))
    times_s = _grid_s(round((sentence.end_s + _AFTER_S) / PUBLISH_PERIOD_S))
    faces = np.array([line.frame_at(time_s).coefficients for time_s in times_s.tolist()])
    return PlayedMotion(times_s, faces, model)


def live_motion(_: Sentence, model: FaceWithAnimPhos) -> Synthesizer:
    """The default live method at its default look-ahead."""
    return make_synthesizer(model, MotionOptions())


Motion = Callable[[Sentence, FaceWithAnimPhos], Synthesizer]
METHODS: Final[dict[str, Motion]] = {"live": live_motion, "scripted": scripted_motion}


def over_speed_share(shafts: Sequence[Shafts], speeds_deg_s: Array) -> float:
    """Share of ticks at which a joint should go faster than its speed.

    Parameters
    ----------
    shafts : Sequence[Shafts]
        Of sentences.
    speeds_deg_s : Array
        (n_servos,) per second.

    Returns
    -------
    float
        0 to 1.
    """
    over = [
        (np.abs(np.diff(each.goals_deg, axis=0)) > speeds_deg_s * PUBLISH_PERIOD_S + _SAME_DEG)
        for each in shafts
    ]
    return float(np.concatenate(over).any(axis=1).mean())


class RobotLips:
    """The lips of a shipped face's robot at given shafts."""

    def __init__(self, face: Face, model: FaceWithAnimPhos) -> None:
        self.servos: MouthServos = CalibrationSetup(face.settings, model, quiet=True).servos
        self._model = model
        neutral_mm = model.markers_mm(model.rest[None])[0]
        self._elastic = None
        #: Of the gears, which the calibration knows as it has measured them, (n_servos,).
        self.play_deg = np.zeros(len(self.servos.names))
        if family_of(self.servos) is RobotFamily.ELASTIC:
            self._elastic = ElasticFace(elastic_robot_of(neutral_mm, self.servos, USUAL_SEED))
            self.play_deg = self._elastic.backlash_deg
        self._markers_mm = markers_of_face(neutral_mm, self.servos)

    def touch(self, shafts: Shafts) -> NDArray[np.bool_]:
        """Return whether the lips touch in their middle.

        Parameters
        ----------
        shafts : Shafts
            n ticks.

        Returns
        -------
        NDArray[np.bool_]
            (n,).
        """
        if self._elastic is None:
            return self.gap_mm(shafts) <= CLOSED_GAP_MM
        return self.gap_mm(shafts) <= _TOUCH_MM

    def gap_mm(self, shafts: Shafts) -> Array:
        """Return the gap between the edges of the lips in their middle.

        Parameters
        ----------
        shafts : Shafts
            n ticks.

        Returns
        -------
        Array
            (n,) mm.
        """
        if self._elastic is None:
            return self._model.lip_gaps_mm(self._markers_mm(shafts.horn_deg))
        return self._elastic.state(shafts.horn_deg).gaps_mm[:, N_PAIRS // 2]

    def wanted_mm(self, sentence: Sentence) -> Array:
        """Return the shapes of the nearest poses to every `_SPARSE`th recorded face.

        Parameters
        ----------
        sentence : Sentence
            Its faces.

        Returns
        -------
        Array
            (n, 47, 3) mm.

        Raises
        ------
        ValueError
            The robot is not elastic.
        """
        if self._elastic is None:
            raise ValueError("what an elastic robot should show is defined, and of no other")
        frames = sentence.faces[::_SPARSE]
        return wanted_shapes(self._model, self._elastic, self.servos, frames).shapes_mm

    def error_mm(self, wanted_mm: Array, shafts: Shafts) -> Array:
        """Return the distance of the lips' markers from wanted shapes.

        Parameters
        ----------
        wanted_mm : Array
            (n, 47, 3).
        shafts : Shafts
            Of the same sentence.

        Returns
        -------
        Array
            (n, n_lips) mm.
        """
        shown_mm = self._markers_mm(shafts.horn_deg[::_SPARSE][: len(wanted_mm)])
        off_mm = (shown_mm - wanted_mm)[:, list(MARKERS_47.lips)]
        return np.asarray(np.linalg.norm(off_mm, axis=2))


def reached_closures(sentence: Sentence, touch: NDArray[np.bool_]) -> list[bool]:
    """Return for each P B M whether lips touch around it.

    Parameters
    ----------
    sentence : Sentence
        Its phones.
    touch : NDArray[np.bool_]
        (n,), one a tick.

    Returns
    -------
    list[bool]
        One a closure.
    """
    times_s = np.arange(len(touch)) * PUBLISH_PERIOD_S
    found = []
    for phone in sentence.phones:
        if phone.phoneme in BILABIALS and phone.end_s is not None:
            near = (times_s >= phone.start_s - _WINDOW_S) & (times_s <= phone.end_s + _WINDOW_S)
            found.append(bool(touch[near].any()))
    return found


def shift_s(gap_mm: Array, free_mm: Array) -> float:
    """Return how much later one motion of the lips is than another, by their correlation.

    Parameters
    ----------
    gap_mm,free_mm : Array
        (n,), one a tick.

    Returns
    -------
    float
        Seconds.
    """
    n_most = round(_MOST_SHIFT_S / _FINEST_S)
    times_s = np.arange(len(gap_mm)) * PUBLISH_PERIOD_S
    fine_s = np.arange(_MOST_SHIFT_S, times_s[-1] - _MOST_SHIFT_S, _FINEST_S)
    still = np.interp(fine_s, times_s, free_mm)
    shifts_s = np.arange(-n_most, n_most + 1) * _FINEST_S
    alike = [np.corrcoef(np.interp(fine_s + s, times_s, gap_mm), still)[0, 1] for s in shifts_s]
    return float(shifts_s[int(np.argmax(alike))])


def speed_figures(corpus: Path, n_sentences: int, advance: Advance) -> dict[str, object]:
    """All of them. Raises CorpusError."""
    model = load_face_with_animphos()
    sentences = sentences_of(corpus, model, n_sentences)
    n_steps = len(FACES) + len(ROBOTS) * len(METHODS) + 1
    figures: dict[str, object] = {"sentences": len(sentences)}
    by_face: dict[str, object] = {}
    figures["faces"] = by_face
    for n, name in enumerate(FACES):
        advance(name, n, n_steps)
        by_face[name] = _goals_of(assemble_face(name, None), sentences, model)
    figures["rate_limits_per_s_run"] = {name: _limits_per_s(name) for name in RUN}
    robots = [assemble_face(name, None) for name in ROBOTS]
    lips = [RobotLips(face, model) for face in robots]
    step = len(FACES)
    for method, make in METHODS.items():
        found = []
        for face, its_lips in zip(robots, lips, strict=True):
            advance(f"{face.settings.name}, {method}", step, n_steps)
            step += 1
            found.append(_at_speeds(face, its_lips, sentences, model, make))
        for name, _ in found[0].items():
            mean = np.mean([of_one[name] for of_one in found], axis=0)
            figures[f"{name}_{method}"] = np.round(mean, 4).tolist()
            for robot, of_one in zip(ROBOTS, found, strict=True):
                figures[f"{name}_{method}_{robot}"] = np.round(of_one[name], 4).tolist()
    advance("lips' error", step, n_steps)
    figures |= _error_ratios(robots[0], lips[0], sentences, model)
    return figures | _plan_times(robots[0], sentences[0], model)


def _at_speeds(
    face: Face,
    lips: RobotLips,
    sentences: Sequence[Sentence],
    model: FaceWithAnimPhos,
    make: "Motion",
) -> dict[str, Array]:
    """For each of `SPEEDS_DEG_S`, with the plan and with the gate alone."""
    n_servos = len(face.calibration.servo_names)
    unlimited, ideal, loose = np.full(n_servos, math.inf), exact(face), in_time(face)
    play_deg = lips.play_deg
    free = [shafts_of(ideal, s, make(s, model), None, unlimited, play_deg) for s in sentences]
    free_gaps_mm = [lips.gap_mm(each) for each in free]
    n_free = _n_reached(sentences, [lips.touch(each) for each in free])
    rows: dict[str, list[float]] = {}
    for speed_deg_s in SPEEDS_DEG_S:
        speeds = np.full(n_servos, speed_deg_s)
        for way in ("", "_gate_alone"):
            shafts = []
            for s in sentences:
                plan = None if way else plan_at(speeds)
                shafts.append(shafts_of(loose, s, make(s, model), plan, speeds, play_deg))
            n_reached = _n_reached(sentences, [lips.touch(each) for each in shafts])
            gaps_mm = zip(shafts, free_gaps_mm, strict=True)
            late_s = float(np.median([shift_s(lips.gap_mm(a), b) for a, b in gaps_mm]))
            rows.setdefault(f"closures_at_shaft{way}", []).append(n_reached / n_free)
            rows.setdefault(f"lips_late_ms{way}", []).append(1e3 * late_s)
    return {name: np.array(values) for name, values in rows.items()}


def _n_reached(sentences: Sequence[Sentence], touch: Sequence[NDArray[np.bool_]]) -> int:
    pairs = zip(sentences, touch, strict=True)
    return sum(sum(reached_closures(sentence, each)) for sentence, each in pairs)


def _error_ratios(
    face: Face, lips: RobotLips, sentences: Sequence[Sentence], model: FaceWithAnimPhos
) -> dict[str, object]:
    """Error of the lips of recorded motion at `SPEEDS_DEG_S`, over that without limits."""
    n_servos = len(face.calibration.servo_names)
    wanted_mm = [lips.wanted_mm(sentence) for sentence in sentences]

    def error_mm(plan_of: Callable[[Array], JointPlan | None], speeds: Array, shown: Face) -> float:
        made = [
            shafts_of(shown, s, recorded_motion(s, model), plan_of(speeds), speeds, lips.play_deg)
            for s in sentences
        ]
        off_mm = [lips.error_mm(w, each) for w, each in zip(wanted_mm, made, strict=True)]
        return float(np.sqrt(np.mean(np.concatenate(off_mm) ** 2)))

    free_mm, loose = error_mm(no_plan, np.full(n_servos, math.inf), exact(face)), in_time(face)
    found: dict[str, object] = {"lip_error_mm": round(free_mm, 3)}
    limits = [np.full(n_servos, speed_deg_s) for speed_deg_s in SPEEDS_DEG_S]
    found["lip_error_ratio"] = [
        round(error_mm(plan_at, each, loose) / free_mm, 3) for each in limits
    ]
    alone = [error_mm(no_plan, each, loose) / free_mm for each in limits]
    found["lip_error_ratio_gate_alone"] = np.round(alone, 3).tolist()
    return found


def _goals_of(
    face: Face, sentences: Sequence[Sentence], model: FaceWithAnimPhos
) -> dict[str, float]:
    """What a face's plan asks of joints that have the speeds of its YAML."""
    servos = [face.settings.servos[name] for name in face.calibration.servo_names]
    speeds = np.array([servo.max_speed_deg_s for servo in servos])
    tight_deg = np.zeros(len(servos))
    figures = {}
    motions: dict[str, Motion] = {"recorded": recorded_motion, "live": live_motion}
    for method, make in motions.items():
        for way in ("", "_gate_alone"):
            shafts = []
            for sentence in sentences:
                plan = None if way else mouth_plan(face)
                motion = make(sentence, model)
                shafts.append(shafts_of(face, sentence, motion, plan, speeds, tight_deg))
            seconds = sum(len(each.goals_deg) for each in shafts) * PUBLISH_PERIOD_S
            hits = sum(each.n_rate_hits for each in shafts)
            figures[f"over_speed_share_{method}{way}"] = round(over_speed_share(shafts, speeds), 4)
            figures[f"rate_limits_per_s_{method}{way}"] = round(hits / seconds, 3)
    return figures


def _limits_per_s(face: str) -> float:
    """Goals that the gate slows in a second of the bundled clip, replayed as users run it."""
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        request = RunRequest(face, Sound("file", str(clip)), rate_hz=_RUN_HZ, quiet=True)
        with open_sound(request.sound) as source:
            summary = run_face(request, source, ManualClock()).summary
    return round(summary.rate_limits_hit / summary.duration_s, 3)


def _plan_times(face: Face, sentence: Sentence, model: FaceWithAnimPhos) -> dict[str, float]:
    """What one tick's window, its poses, backlash and plan take together."""
    synthesizer = live_motion(sentence, model)
    phonemes = ScriptedPhonemes(sentence.phones)
    n_servos, following = len(face.calibration.servo_names), face.calibration.following
    plan = plan_at(np.full(n_servos, SPEEDS_DEG_S[0]))
    backlash = BacklashCompensation(
        np.zeros(n_servos) if following is None else following.backlash_deg
    )
    elapsed_ms = []
    for n in range(round(sentence.end_s / PUBLISH_PERIOD_S)):
        for update in phonemes.updates(n * PUBLISH_PERIOD_S + synthesizer.lookahead_s):
            synthesizer.push(update)
        frame = synthesizer.frame_at(n * PUBLISH_PERIOD_S)
        began_s = time.perf_counter()
        window = synthesizer.window_after(frame)
        *poses_deg, shut_deg = face.calibration.poses_deg(
            np.concatenate([window.faces, window.shut[None]])
        )
        goals_deg = backlash.feed(np.array(poses_deg))
        plan.step(TargetWindow(window.times_s, goals_deg, window.closed, shut_deg))
        elapsed_ms.append(1e3 * (time.perf_counter() - began_s))
    p50, p99 = np.percentile(elapsed_ms, [50, 99])
    return {"plan_ms_p50": round(float(p50), 3), "plan_ms_p99": round(float(p99), 3)}
