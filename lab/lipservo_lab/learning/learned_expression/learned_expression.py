"""Head, gaze and lids by a learned model, live: causal, seeded, one `Expression` every 10 ms.

Involuntary blinks: log-normal intervals, and how far a lid is shut in the course of one.

Log-normal intervals: Le, Ma and Deng 2012. Down 90 ms, shut 20 ms, up 240 ms: VanderWerf and
others, J. Neurophysiology 89(5), 2003, after a second source.

Motion learned from tracks while there is a conversation; everything else as without it.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from lipservo_lab.learning.learned_expression.expression_model import (
    GAZE_POSES,
    HEAD_POSES,
    RATE_HZ,
    ExpressionModel,
    gaze_inputs,
    lid_inputs,
    load_expression,
)
from lipservo_lab.learning.learned_expression.pose_mixture import N_AXES, solve_upper
from lipsync.expression.cue import (
    CUE_PERIOD_S,
    ExpressionCue,
    ExpressionSource,
    WholeExpression,
    smoothstep,
    toward,
)
from lipsync.face.frame import Expression
from lipsync.prosody.voice_frame import VoiceFrame

_CLOSE_S, _SHUT_S, _OPEN_S = 0.090, 0.020, 0.240
BLINK_S = _CLOSE_S + _SHUT_S + _OPEN_S
#: From the start of one blink to the next.
LEAST_INTERVAL_S = 0.4
_MOST_INTERVAL_S = 60.0


def shut_share(since_s: float) -> float:
    """How far the lid is shut (0 to 1) so long after a blink began; smooth at both ends."""
    if not 0.0 < since_s < BLINK_S:
        return 0.0
    if since_s < _CLOSE_S:
        return _smooth(since_s / _CLOSE_S)
    return 1.0 - _smooth(max(0.0, since_s - _CLOSE_S - _SHUT_S) / _OPEN_S)


def _smooth(share: float) -> float:
    return share * share * (3.0 - 2.0 * share)


class BlinkTiming:
    """When blinks begin. log_mean, log_sd: of the natural logarithm of intervals in seconds."""

    def __init__(self, log_mean: float, log_sd: float, rng: np.random.Generator) -> None:
        self._log_mean, self._log_sd, self._rng = log_mean, log_sd, rng
        self._began_s = -math.inf
        self._next_s: float | None = None

    def shut(self, time_s: float) -> float:
        """How far the lids are shut at a time; ask in order."""
        if self._next_s is None:
            # In the middle of an interval: nobody begins by blinking.
            self._next_s = time_s + 0.5 * self._interval_s()
        if time_s >= self._next_s:
            self._began_s = self._next_s
            # Time may have jumped over many blinks.
            self._next_s = max(time_s, self._began_s + self._interval_s())
        return shut_share(time_s - self._began_s)

    def _interval_s(self) -> float:
        drawn = math.exp(min(10.0, self._log_mean + self._log_sd * self._rng.standard_normal()))
        return min(_MOST_INTERVAL_S, max(LEAST_INTERVAL_S, drawn))


#: What the mixture takes for loudness where nobody speaks.
SILENT_Z: Final = -3.0
_CUES_PER_POSE = round(1.0 / (RATE_HZ * CUE_PERIOD_S))
#: Of somebody to look at so much is the head's part, the rest is the eyes'; within this time.
_HEAD_PART = 0.25
_LOOK_TIME_S = 0.3
_MOST_EYE_DEG = 25.0
#: Head motion of an excited voice: 1 + 0.6 times arousal (design note).
_AROUSAL_GAIN = 0.6
_WIDEST, _MOST_FOLLOWED = -0.2, 0.5


def prosody_of(voice: VoiceFrame) -> tuple[float, float]:
    """The mixture's input for 10 ms: pitch and loudness in standard deviations."""
    return (voice.pitch_z, max(SILENT_Z, voice.loudness_z)) if voice.is_speech else (0.0, SILENT_Z)


class LearnedExpression:
    """An `ExpressionSource` that moves as the tracks did that it was trained on.

    Poses are made 25 times a second and interpolated: 40 ms late. variety: 0 gives the likeliest
    motion, which is smooth and small, 1 (usual) moves as much as the recorded head.
    """

    def __init__(
        self, model: ExpressionModel, rng: np.random.Generator, *, variety: float = 1.0
    ) -> None:
        self._model, self._rng, self._variety = model, rng, variety
        self._prosody = np.zeros(2)
        self._n_cues = 0
        #: Newest first.
        self._poses = np.zeros((HEAD_POSES + 1, N_AXES))
        self._gazes = np.zeros((GAZE_POSES + 1, 2))
        self._follow = self._last_follow = 0.0
        self._look = np.zeros(2)
        self._look_weight = 0.0
        self._blinks = None if model.blinks is None else BlinkTiming(*model.blinks, rng)

    def step(self, cue: ExpressionCue) -> Expression:
        """The expression of the cue's moment; call it once for each, in order."""
        part = self._n_cues % _CUES_PER_POSE
        if part == 0 and self._n_cues:
            self._advance()
        pitch_z, loudness_z = prosody_of(cue.voice)
        self._prosody[0] += pitch_z
        self._prosody[1] += loudness_z
        self._n_cues += 1
        share = (part + 1) / _CUES_PER_POSE
        self._turn_to(cue.look_at_deg)
        gain = cue.amount * (1.0 + _AROUSAL_GAIN * cue.arousal)
        return self._shown(cue, share, gain)

    def _shown(self, cue: ExpressionCue, share: float, gain: float) -> Expression:
        """share: of the way from the last pose but one to the last."""
        (pitch, yaw, roll), (pitch_0, yaw_0, roll_0) = self._poses[:2].tolist()
        weight = self._look_weight
        look_yaw, look_pitch = self._look.tolist()
        pitch = gain * (pitch_0 + share * (pitch - pitch_0)) + weight * _HEAD_PART * look_pitch
        yaw = gain * (yaw_0 + share * (yaw - yaw_0)) + weight * _HEAD_PART * look_yaw
        roll = gain * (roll_0 + share * (roll - roll_0))
        eye_yaw = eye_pitch = lid = None
        if self._model.gaze is not None:
            (eye_yaw, eye_pitch), (eye_yaw_0, eye_pitch_0) = self._gazes[:2].tolist()
            free = (1.0 - weight) * gain
            eye_yaw = free * (eye_yaw_0 + share * (eye_yaw - eye_yaw_0))
            eye_pitch = free * (eye_pitch_0 + share * (eye_pitch - eye_pitch_0))
            # Who looks at somebody keeps them in view while the head moves.
            eye_yaw = _within(eye_yaw + weight * (look_yaw - yaw), _MOST_EYE_DEG)
            eye_pitch = _within(eye_pitch + weight * (look_pitch - pitch), _MOST_EYE_DEG)
        if self._model.lids is not None or self._blinks is not None:
            lid = cue.amount * (self._last_follow + share * (self._follow - self._last_follow))
            if self._blinks is not None and cue.amount > 0.0:
                shut = self._blinks.shut(cue.time_s)
                lid += shut * (1.0 - lid)
        return Expression(pitch, yaw, roll, eye_pitch, eye_yaw, lid, lid)

    def _turn_to(self, look_at_deg: tuple[float, float] | None) -> None:
        step = CUE_PERIOD_S / _LOOK_TIME_S
        if look_at_deg is None:
            self._look_weight -= step * self._look_weight
            return
        self._look_weight += step * (1.0 - self._look_weight)
        self._look[0] += step * (look_at_deg[0] - self._look[0])
        self._look[1] += step * (look_at_deg[1] - self._look[1])

    def _advance(self) -> None:
        """Advance by one pose."""
        prosody = self._prosody / _CUES_PER_POSE
        self._prosody[:] = 0.0
        pose, factor = self._model.head.next_pose(self._poses[1], self._poses[0], prosody)
        if self._variety > 0.0:
            # A deviation with the covariance that the curvature is the inverse of.
            drawn = self._rng.standard_normal(N_AXES).tolist()
            pose += self._variety * np.array(solve_upper(factor, drawn))
        self._poses[1:] = self._poses[:-1]
        farthest = self._model.farthest_deg
        self._poses[0] = np.minimum(np.maximum(pose, -farthest), farthest)
        if self._model.gaze is not None and self._model.farthest_gaze_deg is not None:
            gaze = self._model.gaze @ gaze_inputs(self._poses[:HEAD_POSES], prosody)
            self._gazes[1:] = self._gazes[:-1]
            farthest = self._model.farthest_gaze_deg
            self._gazes[0] = np.minimum(np.maximum(gaze, -farthest), farthest)
        if self._model.lids is not None:
            inputs = lid_inputs(self._gazes[:GAZE_POSES, 1], float(self._poses[0, 0]))
            self._last_follow = self._follow
            self._follow = min(_MOST_FOLLOWED, max(_WIDEST, float(self._model.lids @ inputs)))


def _within(value: float, farthest: float) -> float:
    return min(farthest, max(-farthest, value))


#: What tracks tell; brow and smile they do not.
_LEARNED: Final = (
    "neck_pitch_deg", "neck_yaw_deg", "neck_roll_deg", "eye_pitch_deg", "eye_yaw_deg",
    "lid_left", "lid_right",
)  # fmt: skip
#: A conversation is over after so long a silence.
_CONVERSATION_S: Final = 4.0
#: From one to the other: slower than any motion of either.
_OVER_S: Final = 1.0


class LearnedHead:
    """A `WholeExpression` of two: `learned` in conversation, `otherwise` in all else.

    Idle motion, rest and looking at a person are not in the tracks of a talking head.
    """

    def __init__(self, learned: ExpressionSource, otherwise: WholeExpression) -> None:
        self._learned = learned
        self._otherwise = otherwise
        self._share = 0.0

    @property
    def is_resting(self) -> bool:
        """Whether it is at neutral, and stays there until a person speaks or moves."""
        return self._share == 0.0 and self._otherwise.is_resting

    def step(self, cue: ExpressionCue) -> Expression:
        """The expression of the cue's moment; call it once for each, in order."""
        plain, learned = self._otherwise.step(cue), self._learned.step(cue)
        is_talk = cue.silent_s < _CONVERSATION_S and cue.look_at_deg is None
        self._share = toward(self._share, float(is_talk), CUE_PERIOD_S / _OVER_S)
        share = smoothstep(self._share)
        if share == 0.0:
            return plain
        mixed = {}
        for name in _LEARNED:
            ours, theirs = getattr(plain, name), getattr(learned, name)
            if ours is not None and theirs is not None:
                mixed[name] = ours + share * (theirs - ours)
        return replace(plain, **mixed)


def learned_expression(path: Path, seed: int, otherwise: WholeExpression) -> WholeExpression:
    """What a face plays whose YAML names a learned model: the entry point `lipservo.expressions`.

    Raises
    ------
    ExpressionModelError
        For a file that holds no such model.

    """
    return LearnedHead(
        LearnedExpression(load_expression(path), np.random.default_rng(seed)), otherwise
    )
