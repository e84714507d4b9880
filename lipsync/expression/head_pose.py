"""Where the head is: with gaze and voice in conversation, and holding still in idle."""

from random import Random

from lipsync.expression.alertness import Alertness
from lipsync.expression.bounded import bounded
from lipsync.expression.cue import ExpressionCue
from lipsync.expression.damped_follower import DampedFollower
from lipsync.expression.eye_head import (
    MOST_PITCH_DEG,
    MOST_ROLL_DEG,
    MOST_YAW_DEG,
    head_part_deg,
)
from lipsync.expression.gaze import STRAIGHT_AHEAD, Gaze
from lipsync.expression.head_drift import HeadDrift
from lipsync.expression.idle_posture import IdlePosture
from lipsync.expression.prosody_accents import ProsodyAccents

#: Where a head turns and drifts it is slow; with accents, quick: through 1.6 Hz a nod would come
#: 0.2 s late, and people's heads lag their voices by some 30 ms.
_TURNING_HZ, _HEAD_HZ, _MOST_DEG_S = 1.6, 4.0, 120.0
#: The head stays for a partner who moves it less than this: eyes follow, the neck need not.
_STEADY_DEG = 1.0


class HeadPose:
    """Pitch, yaw and roll: conversation and idle, each by its share, and what gaze asks for."""

    def __init__(self, seed: int) -> None:
        self._drift = HeadDrift(Random(f"{seed} head"))
        self._accents = ProsodyAccents(Random(f"{seed} accents"))
        self._idle = IdlePosture(Random(f"{seed} idle"))
        self._turning_pitch, self._turning_yaw, self._turning_roll = (
            DampedFollower(_TURNING_HZ, _MOST_DEG_S) for _ in range(3)
        )
        self._pitch, self._yaw, self._roll = (
            DampedFollower(_HEAD_HZ, _MOST_DEG_S) for _ in range(3)
        )
        self._aim_deg = self._aim_part_deg = self._partner_part_deg = STRAIGHT_AHEAD

    def settle(self) -> None:
        """Leave idle's small moves behind: rest begins."""
        self._idle.settle()

    def step(
        self, cue: ExpressionCue, alertness: Alertness, gaze: Gaze, amount: float, gain: float
    ) -> tuple[float, float, float]:
        """(pitch, yaw, roll) one cue later. gain: of the drift, by arousal."""
        awake = alertness.awake
        turn_yaw_deg, turn_pitch_deg = self._turn_deg(gaze)
        held_yaw_deg, held_pitch_deg = self._partner_part_deg
        if amount > 0.0 and alertness.is_idle and not alertness.wants_rest:
            idle_pitch, idle_yaw, idle_roll = self._idle.step((turn_yaw_deg, turn_pitch_deg))
        else:
            idle_pitch, idle_yaw, idle_roll = self._idle.follow()
        pitch, yaw, roll = self._drift.step(alertness.talking)
        accent_deg = self._accents.step(cue.voice, cue.is_speaking)
        drift, idle = awake * amount * gain, (1.0 - awake) * min(1.0, amount)
        pitch_deg = held_pitch_deg + awake * turn_pitch_deg + drift * pitch + idle * idle_pitch
        yaw_deg = held_yaw_deg + awake * turn_yaw_deg + drift * yaw + idle * idle_yaw
        roll_deg = self._turning_roll.follow(drift * roll + idle * idle_roll)
        pitch_deg = self._turning_pitch.follow(pitch_deg) + awake * amount * accent_deg
        yaw_deg = self._turning_yaw.follow(yaw_deg)
        return (
            self._pitch.follow(bounded(pitch_deg, -MOST_PITCH_DEG, MOST_PITCH_DEG)),
            self._yaw.follow(bounded(yaw_deg, -MOST_YAW_DEG, MOST_YAW_DEG)),
            self._roll.follow(bounded(roll_deg, -MOST_ROLL_DEG, MOST_ROLL_DEG)),
        )

    def _turn_deg(self, gaze: Gaze) -> tuple[float, float]:
        """(yaw, pitch) of the head's part of a look away, on top of its part for the partner."""
        if gaze.aim_deg is not self._aim_deg:
            self._aim_deg = gaze.aim_deg
            self._aim_part_deg = head_part_deg(gaze.aim_deg)
        aim_yaw_deg, aim_pitch_deg = self._aim_part_deg
        held_yaw_deg, held_pitch_deg = self._partner_part_deg
        turn_deg = (aim_yaw_deg - held_yaw_deg, aim_pitch_deg - held_pitch_deg)
        if gaze.is_mutual:
            off_deg = abs(turn_deg[0]) + abs(turn_deg[1])
            if off_deg > _STEADY_DEG or self._aim_deg == STRAIGHT_AHEAD:
                self._partner_part_deg = self._aim_part_deg
                return STRAIGHT_AHEAD
        return turn_deg
