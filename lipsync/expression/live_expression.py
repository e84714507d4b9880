"""Head, gaze, lids, brows and smile of a face, live: all generators together.

Brows rise with the voice, and arousal scales what the generators do. Arousal alone comes from a
voice: anger and joy sound equally excited (Bone, Lee and Narayanan, "Robust unsupervised arousal
rating", IEEE Trans. Affective Computing 5(2), 2014), so that nothing here smiles or frowns. The
sizes are design choices, not measured on people.
"""

from random import Random
from typing import Final

from lipsync.expression.alertness import Alertness
from lipsync.expression.blinks import Blinks, BrowFlashes, lid_position
from lipsync.expression.cue import (
    CUE_PERIOD_S,
    DampedFollower,
    ExpressionCue,
    bounded,
    toward,
)
from lipsync.expression.gaze import Gaze, eyes_deg, listening_habit, talking_habit
from lipsync.expression.head_pose import HeadPose
from lipsync.face.frame import Expression


def head_gain(arousal: float) -> float:
    """Return the factor of the head's drift for an arousal of -1 to 1: 0.4 to 1.6."""
    return 1.0 + 0.6 * bounded(arousal, -1.0, 1.0)


def blink_gain(arousal: float) -> float:
    """Return the factor of the blink rate for an arousal of -1 to 1: 0.85 to 1.15."""
    return 1.0 + 0.15 * bounded(arousal, -1.0, 1.0)


def gaze_pace(arousal: float) -> float:
    """Return the factor of the rate of fixations for an arousal of -1 to 1: 0.8 to 1.2."""
    return 1.0 + 0.2 * bounded(arousal, -1.0, 1.0)


def brow_raise(arousal: float) -> float:
    """Return how far an arousal of -1 to 1 raises the brows: 0 to 0.2; 0 for a negative one."""
    return 0.2 * max(0.0, bounded(arousal, -1.0, 1.0))


def lid_offset(arousal: float) -> float:
    """Return the lids' offset for an arousal of -1 to 1: 0.15 (drooping) to -0.25 (widened)."""
    arousal = bounded(arousal, -1.0, 1.0)
    return -0.25 * arousal if arousal > 0.0 else -0.15 * arousal


#: The amount of motion changes by 1 in so many seconds, as in `PerformedExpression`.
_AMOUNT_S: Final = 1.0
_BROW_HZ, _BROW_PER_S = 4.0, 12.0
_MOOD_HZ, _MOOD_PER_S = 0.6, 4.0
#: Spontaneous blinks a minute; with those at saccades and ends of speech there are 24 in talk and
#: 15 in silence (docs/expression.md).
_TALKING_BLINKS, _SILENT_BLINKS, _IDLE_BLINKS = 21.0, 13.0, 11.0
#: Fixations last so much longer where nobody speaks.
_IDLE_PACE = 0.4
_MOST_AMOUNT = 1.5
_NEUTRAL: Final = Expression(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class LiveExpression:
    """Parametric generators of everything but the mouth; an `ExpressionSource`.

    Causal; state and a seeded generator only, so that equal cues give equal motion. Values of a cue
    beyond their bounds count as the bound, and NaN as 0.
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
        """Create the generators. Raises ValueError for a share that is not allowed.

        seed: of all random generators. Shares: of the time, 0.05 to 1, for which gaze is on the
        partner. idle_after_s, rest_after_s: seconds of silence after which idle motion replaces
        conversation motion, and after which the face goes to neutral and stays there.
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
        self._was_resting = False
        self._amount = 0.0
        self.is_resting = False

    def step(self, cue: ExpressionCue) -> Expression:
        """Return the expression at the cue's time; call it once for each cue, every CUE_PERIOD_S.

        After the call `is_resting` tells whether the face is at neutral and stays there until a
        person speaks or moves, so that torque may be released without a jump.
        """
        alertness = self._alertness
        alertness.update(cue)
        # As rest begins, head and gaze set out for neutral.
        is_rest, was_rest = alertness.wants_rest, self._was_resting
        self._was_resting = is_rest
        if is_rest and not was_rest:
            self._head.settle()
            self._gaze.look_at_partner()
        target_amount = 0.0 if is_rest else bounded(cue.amount, 0.0, _MOST_AMOUNT)
        self._amount = amount = toward(self._amount, target_amount, CUE_PERIOD_S / _AMOUNT_S)
        arousal = 0.0 if is_rest else bounded(cue.arousal, -1.0, 1.0)
        size = min(1.0, amount)
        blink = self._advance_eyes(arousal, target_amount)
        # The eyes turn against the head, so that gaze stays where it is.
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
        self.is_resting = is_rest and expression == _NEUTRAL
        return expression

    def _advance_eyes(self, arousal: float, amount: float) -> float:
        """Advance gaze and blinks by one cue, 10 ms; return how far a blink shuts the lids, 0 to 1.

        arousal: -1 to 1, changes their pace. amount: size of all motion; 0: no blink, gaze on the
        partner.
        """
        alertness, gaze = self._alertness, self._gaze
        gaze.set_talking(alertness.is_speaking)
        if alertness.has_turned:
            gaze.look_at_partner()
        pace = _IDLE_PACE if alertness.is_idle else gaze_pace(arousal)
        gaze.step(alertness.partner_deg, pace, amount)
        rate_per_min = 0.0
        if amount > 0.0:
            # Between the rates in idle, in silence and in talk.
            silent = _SILENT_BLINKS + (_IDLE_BLINKS - _SILENT_BLINKS) * (1.0 - alertness.awake)
            rate_per_min = silent + (_TALKING_BLINKS - silent) * alertness.talking
            rate_per_min *= blink_gain(arousal)
        return self._blinks.step(rate_per_min, alertness.turn_ended, gaze.saccade_deg)
