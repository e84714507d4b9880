"""Head, gaze, lids, brows and smile of a face, live: all generators together.

Brows go up with the voice, and arousal scales what the generators do. Arousal alone comes from a
voice: anger and joy sound equally excited (Bone, Lee and Narayanan, "Robust unsupervised arousal
rating", IEEE Trans. Affective Computing 5(2), 2014), so that nothing here smiles or frowns. The
sizes are design choices, not measured on people.

The head and eyes of a performance take the place of the live ones (`PerformedExpression`).
"""

from dataclasses import replace
from random import Random
from typing import Final

from lipsync.expression.alertness import Alertness
from lipsync.expression.blinks import Blinks, BrowFlashes, lid_position
from lipsync.expression.cue import (
    CUE_PERIOD_S,
    DampedFollower,
    ExpressionCue,
    bounded,
    smoothstep,
    toward,
)
from lipsync.expression.gaze import Gaze, eyes_deg, listening_habit, talking_habit
from lipsync.expression.head_pose import HeadPose
from lipsync.face.frame import NO_EXPRESSION, Expression

_LEAST_MOUTH_GAIN, _MOST_MOUTH_GAIN = 0.85, 1.2


def mouth_gain(arousal: float) -> float:
    """How far the mouth's coefficients go, 0.85 to 1.2; for all but closures of the lips."""
    return bounded(1.0 + 0.2 * bounded(arousal, -1.0, 1.0), _LEAST_MOUTH_GAIN, _MOST_MOUTH_GAIN)


def head_gain(arousal: float) -> float:
    """How far the head drifts, 0.4 to 1.6."""
    return 1.0 + 0.6 * bounded(arousal, -1.0, 1.0)


def blink_gain(arousal: float) -> float:
    """Return the factor of the blink rate, 0.85 to 1.15."""
    return 1.0 + 0.15 * bounded(arousal, -1.0, 1.0)


def gaze_pace(arousal: float) -> float:
    """Return the factor of the rate of fixations, 0.8 to 1.2."""
    return 1.0 + 0.2 * bounded(arousal, -1.0, 1.0)


def brow_raise(arousal: float) -> float:
    """How far excitement raises the brows, 0 to 0.2."""
    return 0.2 * max(0.0, bounded(arousal, -1.0, 1.0))


def lid_offset(arousal: float) -> float:
    """Eyes widened by excitement, to -0.25; lids drooping without any, to 0.15."""
    arousal = bounded(arousal, -1.0, 1.0)
    return -0.25 * arousal if arousal > 0.0 else -0.15 * arousal


#: How long each takes to go over: a neck as in a slow turn, eyes as in a large saccade, lids as in
#: a blink, so that none is left half shut.
_OVER_S: Final = {
    "neck_pitch_deg": 0.8, "neck_yaw_deg": 0.8, "neck_roll_deg": 0.8,
    "eye_pitch_deg": 0.2, "eye_yaw_deg": 0.2,
    "lid_left": 0.1, "lid_right": 0.1, "brow": 0.3,
}  # fmt: skip
#: A changed amount is there after as long a time for each 1 of change, as in `LiveExpression`.
_AMOUNT_S: Final = 1.0


class PerformedExpression:
    """`step` once for every 10 ms that are shown."""

    def __init__(self) -> None:
        self._shares = dict.fromkeys(_OVER_S, 0.0)
        self._held = dict.fromkeys(_OVER_S, 0.0)
        self._amount = 0.0

    def step(self, live: Expression, stored: Expression, amount: float) -> Expression:
        """What is shown. stored: what the performance says, `NO_EXPRESSION` where there is none.

        amount: how lively the face is to be; at 0 it is still, as without a performance. Where a
        performance ends or is cut off, its last pose is left for the live one.
        """
        self._amount = toward(self._amount, amount, CUE_PERIOD_S / _AMOUNT_S)
        is_still = amount <= 0.0
        mixed = {}
        for name, over_s in _OVER_S.items():
            value = None if is_still or stored is NO_EXPRESSION else getattr(stored, name)
            if value is not None:
                self._held[name] = value if name.startswith("lid") else self._amount * value
            wanted = float(value is not None)
            share = toward(self._shares[name], wanted, CUE_PERIOD_S / over_s)
            self._shares[name] = share
            if share > 0.0:
                ours = getattr(live, name) or 0.0
                mixed[name] = ours + smoothstep(share) * (self._held[name] - ours)
        return replace(live, **mixed) if mixed else live


_BROW_HZ, _BROW_PER_S = 4.0, 12.0
_MOOD_HZ, _MOOD_PER_S = 0.6, 4.0
#: Blinks of their own accord; with those at saccades and ends of speech there are 24 a minute
#: in talk and 15 in silence (docs/expression.md).
_TALKING_BLINKS, _SILENT_BLINKS, _IDLE_BLINKS = 21.0, 13.0, 11.0
#: Fixations last so much longer where nobody speaks.
_IDLE_PACE = 0.4
_MOST_AMOUNT = 1.5
_NEUTRAL: Final = Expression(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class LiveExpression:
    """Parametric generators of everything but the mouth; an `ExpressionSource`.

    Causal; state and a seeded generator only, so that the same cues give the same motion. What a
    cue says beyond its bounds counts as the bound, and what is not a number as 0.
    """

    def __init__(
        self,
        seed: int,
        *,
        talking_mutual_share: float = 0.41,
        listening_mutual_share: float = 0.75,
        idle_after_s: float = 4.0,
        rest_after_s: float = 600.0,
    ) -> None:
        """Shares: of the time, 0.05 to 1, for which gaze is on the partner.

        idle_after_s, rest_after_s: after how much silence conversation motion gives way
        to idle motion, and when the face goes to neutral and stays there. Raises ValueError for a
        share that is not allowed.
        """
        self._alertness = Alertness(idle_after_s, rest_after_s)
        self._head = HeadPose(seed)
        talking = talking_habit(talking_mutual_share)
        self._gaze = Gaze(Random(f"{seed} gaze"), talking, listening_habit(listening_mutual_share))
        self._blinks = Blinks(Random(f"{seed} blinks"))
        self._flashes = BrowFlashes(Random(f"{seed} brows"))
        self._brow = DampedFollower(_BROW_HZ, _BROW_PER_S)
        self._lid_offset = DampedFollower(_MOOD_HZ, _MOOD_PER_S)
        self._smile = DampedFollower(_MOOD_HZ, _MOOD_PER_S)
        self._rests = False
        self._amount = 0.0
        self.is_resting = False

    def step(self, cue: ExpressionCue) -> Expression:
        """The expression of the cue's moment; call it once for each, every CUE_PERIOD_S.

        `is_resting` says afterwards whether the face is at neutral and stays there until a person
        speaks or moves: then torque may be released without a jump.
        """
        alertness = self._alertness
        alertness.hear(cue)
        rests, rested = alertness.wants_rest, self._rests
        self._rests = rests
        if rests and not rested:
            self._head.settle()
            self._gaze.look()
        wanted = 0.0 if rests else bounded(cue.amount, 0.0, _MOST_AMOUNT)
        self._amount = amount = toward(self._amount, wanted, CUE_PERIOD_S / _AMOUNT_S)
        arousal = 0.0 if rests else bounded(cue.arousal, -1.0, 1.0)
        size = min(1.0, amount)
        blink = self._look(arousal, wanted)
        pitch_deg, yaw_deg, roll_deg = self._head.step(
            cue, alertness, self._gaze, amount, head_gain(arousal)
        )
        eye_yaw_deg, eye_pitch_deg = eyes_deg(self._gaze.direction_deg, yaw_deg, pitch_deg)
        offset = self._lid_offset.follow(size * lid_offset(arousal))
        lid = lid_position(eye_pitch_deg, offset, size, blink)
        brow = self._flashes.step(cue.voice, cue.is_speaking, alertness.is_idle)
        brow = self._brow.follow(bounded(amount * (brow + brow_raise(arousal)), 0.0, 1.0))
        smile = self._smile.follow(size * bounded(cue.valence, -1.0, 1.0))
        expression = Expression(
            pitch_deg, yaw_deg, roll_deg, eye_pitch_deg, eye_yaw_deg, lid, lid, brow, smile
        )
        self.is_resting = rests and expression == _NEUTRAL
        return expression

    def _look(self, arousal: float, amount: float) -> float:
        """Moves gaze; how far the lids are shut by blinking."""
        alertness, gaze = self._alertness, self._gaze
        gaze.turn(alertness.is_speaking)
        if alertness.has_turned:
            gaze.look()
        pace = _IDLE_PACE if alertness.is_idle else gaze_pace(arousal)
        gaze.step(alertness.partner_deg, pace, amount)
        rate_per_min = 0.0
        if amount > 0.0:
            silent = _SILENT_BLINKS + (_IDLE_BLINKS - _SILENT_BLINKS) * (1.0 - alertness.awake)
            rate_per_min = silent + (_TALKING_BLINKS - silent) * alertness.talking
            rate_per_min *= blink_gain(arousal)
        return self._blinks.step(rate_per_min, alertness.turn_ended, gaze.saccade_deg)
