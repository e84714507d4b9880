"""Pose of the head: moving with gaze and voice in conversation, mostly still in idle.

In talk it nods to accents of the voice and drifts slowly about its pose. In idle it holds, makes a
small move, and holds: a gear train that always moves is heard in a silent room and wears. So idle
motion is no drift but moves with rests between them, each paid for out of a budget of degrees of
travel that grows with time (docs/expression.md).
"""

import math
from random import Random
from typing import Final

from lipsync.expression.alertness import Alertness
from lipsync.expression.cue import CUE_PERIOD_S, DampedFollower, ExpressionCue, bounded, smoothstep
from lipsync.expression.gaze import (
    MOST_PITCH_DEG,
    MOST_ROLL_DEG,
    MOST_YAW_DEG,
    STRAIGHT_AHEAD,
    Gaze,
    head_part_deg,
)
from lipsync.prosody.voice_frame import VoiceFrame

_FAST_S, _SLOW_S = 0.06, 0.6
#: An accent stands out by so many standard deviations, and comes so long after the last one.
_PROMINENCE = 0.8
_APART_S = 0.45
#: Not every accent is nodded to.
_NODDED = 0.7
_LEAST_NOD_DEG, _NOD_PER_EXCESS_DEG, _MOST_NOD_DEG = 2.0, 1.2, 6.0
_NOD_DECAY_S = 0.18
#: The head rises with a phrase's loudness and pitch, by so much for 1 of slow prominence. With
#: less, the head's motion correlates best with loudness 0.2 s late: by its way back from nods
#: (docs/expression.md).
_PHRASE_DEG = 1.8
#: Beyond this a standard score is a fault or a shout; both count as a shout.
MOST_Z = 4.0


class ProsodyAccents:
    """A generator of head pitch from prosody: a nod to an accent, and the course of the phrase.

    Prominence is loudness + pitch / 2, in standard deviations; an accent is where the fast average
    of prominence exceeds its slow average by 0.8. The head is some 30 ms later than prosody in
    people (Fotedar and Ghosh, Interspeech 2017), so that nothing need be known beforehand.
    """

    def __init__(self, random: Random) -> None:
        """Create the generator at rest: averages 0, no nod."""
        self._random = random
        self._fast_share = -math.expm1(-CUE_PERIOD_S / _FAST_S)
        self._slow_share = -math.expm1(-CUE_PERIOD_S / _SLOW_S)
        self._decay = math.exp(-CUE_PERIOD_S / _NOD_DECAY_S)
        self._fast = 0.0
        self._slow = 0.0
        self._since_s = _APART_S
        self._stands_out = False
        self._nod_deg = 0.0

    def step(self, voice: VoiceFrame, is_speaking: bool) -> float:
        """Advance by one cue, 10 ms; return the head's pitch in degrees, positive upwards.

        voice: counts only while the robot speaks (`is_speaking`).
        """
        prominence = 0.0
        if is_speaking and voice.is_speech:
            loudness = bounded(voice.loudness_z, -MOST_Z, MOST_Z)
            prominence = loudness + 0.5 * bounded(voice.pitch_z, -MOST_Z, MOST_Z)
        self._fast += self._fast_share * (prominence - self._fast)
        self._slow += self._slow_share * (prominence - self._slow)
        self._nod_deg *= self._decay
        self._since_s += CUE_PERIOD_S
        excess = self._fast - self._slow
        # Not every accent gets a nod, and none within 0.45 s of the last accent that could have.
        stood_out, self._stands_out = self._stands_out, excess > _PROMINENCE
        if is_speaking and self._stands_out and not stood_out and self._since_s >= _APART_S:
            self._since_s = 0.0
            if self._random.random() < _NODDED:
                nod_deg = _LEAST_NOD_DEG + _NOD_PER_EXCESS_DEG * excess
                self._nod_deg = -min(_MOST_NOD_DEG, nod_deg)
        return self._nod_deg + _PHRASE_DEG * self._slow


#: Of the drift's pitch, yaw and roll: its time constant, and its standard deviation.
_TAUS_S = (1.2, 1.5, 1.8)
_SDS_DEG = (1.8, 2.2, 1.3)
#: Who listens moves half as much.
_LISTENING_SHARE = 0.5


class HeadDrift:
    """Slow random motion of the head: an Ornstein-Uhlenbeck process for each axis.

    An angle o changes by do = -o/tau dt + sigma sqrt(2/tau) dW, stepped exactly (Gillespie,
    Physical Review E 54, 1996, eq. 1.9), at standard deviation 1, so that its size may change at
    any time without a jump.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._decay = tuple(math.exp(-CUE_PERIOD_S / tau_s) for tau_s in _TAUS_S)
        self._noise_share = tuple(math.sqrt(1.0 - decay * decay) for decay in self._decay)
        self._state = (0.0, 0.0, 0.0)

    def step(self, talking: float) -> tuple[float, float, float]:
        """Advance by one cue, 10 ms; return pitch, yaw and roll in degrees.

        talking: how far the robot is talking, 0 to 1; at 0 the motion is half as large as at 1.
        """
        (pitch, yaw, roll), (decay_0, decay_1, decay_2) = self._state, self._decay
        noise_0, noise_1, noise_2 = self._noise_share
        gauss = self._random.gauss
        pitch = decay_0 * pitch + noise_0 * gauss(0.0, 1.0)
        yaw = decay_1 * yaw + noise_1 * gauss(0.0, 1.0)
        roll = decay_2 * roll + noise_2 * gauss(0.0, 1.0)
        self._state = (pitch, yaw, roll)
        size = _LISTENING_SHARE + (1.0 - _LISTENING_SHARE) * talking
        return size * _SDS_DEG[0] * pitch, size * _SDS_DEG[1] * yaw, size * _SDS_DEG[2] * roll


#: Mean speed of each axis of the neck in idle, at most; and how much travel may be saved up.
BUDGET_DEG_S: Final = 0.4
_MOST_SAVED_DEG, _FIRST_SAVED_DEG = 10.0, 1.0
#: Between moves: mean and standard deviation, beyond the shortest pause.
_SHORTEST_PAUSE_S, _PAUSE_S, _PAUSE_SD_S = 2.0, 5.0, 3.0
#: Every other move is a breath: up, a moment, and down, 3.8 s in all (0.26 Hz).
_BREATHING = 0.5
_LEAST_BREATH_DEG, _MOST_BREATH_DEG = 0.4, 0.8
_IN_S, _FULL_S, _OUT_S = 1.5, 0.5, 1.8
#: The other moves go to the other side of the middle; less than four pulses of a servo of 0.088
#: degrees a pulse would be gear noise and nothing seen.
_FURTHEST_DEG, _LEAST_MOVE_DEG = 0.9, 0.35
_MOVE_S = 1.2
#: The head turns with a look away only where its part of the gaze is at least as large.
_LEAST_TURN_DEG = 3.0
_SETTLING_S = 2.0


class _Axis:
    """One angle of the head that rests or moves to a goal, and its budget of travel.

    budget_deg: travel that may still be spent. home_deg: where the angle rests between moves.
    """

    def __init__(self) -> None:
        """Create the angle at rest at 0 degrees, with 1 degree of travel to spend."""
        self.angle_deg = 0.0
        self.goal_deg = 0.0
        self.home_deg = 0.0
        self.budget_deg = _FIRST_SAVED_DEG
        self._start_deg = 0.0
        self._elapsed_s = 0.0
        self._duration_s = _MOVE_S
        self.is_moving = False

    def start_move(self, goal_deg: float, duration_s: float) -> None:
        """Start a move to `goal_deg` that lasts `duration_s`, from rest at the present angle."""
        self._start_deg, self.goal_deg = self.angle_deg, goal_deg
        self._elapsed_s, self._duration_s = 0.0, duration_s
        self.is_moving = goal_deg != self.angle_deg

    def step(self) -> float:
        """Advance by one cue, 10 ms; return the angle in degrees, the goal when it is reached."""
        if self.is_moving:
            self._elapsed_s += CUE_PERIOD_S
            share = smoothstep(self._elapsed_s / self._duration_s)
            self.is_moving = share < 1.0
            way_deg = self.goal_deg - self._start_deg
            self.angle_deg = self._start_deg + share * way_deg if share < 1.0 else self.goal_deg
        return self.angle_deg

    def affordable(self, way_deg: float) -> float:
        """Return `way_deg`, signed, reduced to what the travel budget allows there and back."""
        return math.copysign(min(abs(way_deg), self.budget_deg / 2.0), way_deg)

    def spend(self, travel_deg: float) -> bool:
        """Take `travel_deg` from the budget and return True; return False if it is too small."""
        if travel_deg > self.budget_deg:
            return False
        self.budget_deg -= travel_deg
        return True


class IdlePosture:
    """A generator of a head's pitch, yaw and roll in idle: small moves with rests between them."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._pitch, self._yaw, self._roll = self._axes = (_Axis(), _Axis(), _Axis())
        self._pause_s = self._drawn_pause_s()
        self._until_exhale_s = 0.0
        self._is_turned = False

    def step(self, turn_deg: tuple[float, float]) -> tuple[float, float, float]:
        """Advance by one cue, 10 ms, of idle; return pitch, yaw and roll in degrees.

        turn_deg: (yaw, pitch) of the head's part of gaze away from the partner.
        """
        for axis in self._axes:
            axis.budget_deg = min(_MOST_SAVED_DEG, axis.budget_deg + BUDGET_DEG_S * CUE_PERIOD_S)
        if self._until_exhale_s > 0.0:
            self._hold_breath()
        # At rest: turn with a look away or back from it; after the pause make a small move.
        elif not (self._pitch.is_moving or self._yaw.is_moving or self._roll.is_moving):
            self._pause_s -= CUE_PERIOD_S
            if self._is_turned:
                self._maybe_turn_back(turn_deg)
            elif math.hypot(*turn_deg) >= _LEAST_TURN_DEG:
                self._turn_with_gaze(turn_deg)
            if self._pause_s <= 0.0 and not self._is_turned:
                self._pause_s = self._drawn_pause_s()
                self._begin_move()
        return self.follow()

    def follow(self) -> tuple[float, float, float]:
        """Advance by one cue, 10 ms; return pitch, yaw and roll in degrees. No new move begins."""
        return self._pitch.step(), self._yaw.step(), self._roll.step()

    def settle(self) -> None:
        """Start a move to 0 degrees, whatever the budget of travel; then call `follow` alone."""
        self._until_exhale_s = 0.0
        self._is_turned = False
        for axis in self._axes:
            axis.home_deg = 0.0
            axis.start_move(0.0, _SETTLING_S)

    def _drawn_pause_s(self) -> float:
        """Return a random pause in s: 2 s, and a gamma-distributed rest of 5 s on average."""
        shape = (_PAUSE_S / _PAUSE_SD_S) ** 2
        return _SHORTEST_PAUSE_S + self._random.gammavariate(shape, _PAUSE_S / shape)

    def _begin_move(self) -> None:
        """Begin a breath or a small move of a random axis, if its budget of travel allows it."""
        random = self._random
        if random.random() < _BREATHING:
            size_deg = random.uniform(_LEAST_BREATH_DEG, _MOST_BREATH_DEG)
            if self._pitch.spend(2.0 * size_deg):
                self._pitch.start_move(self._pitch.home_deg + size_deg, _IN_S)
                self._until_exhale_s = _IN_S + _FULL_S
            return
        axis = random.choice(self._axes)
        travel_deg = random.uniform(_LEAST_MOVE_DEG, _FURTHEST_DEG)
        if axis.spend(travel_deg):
            # To the other side of 0.
            axis.home_deg -= math.copysign(travel_deg, axis.home_deg)
            axis.start_move(axis.home_deg, _MOVE_S)

    def _hold_breath(self) -> None:
        """Advance by one cue the time until the breath goes out; then start the way down."""
        self._until_exhale_s -= CUE_PERIOD_S
        if self._until_exhale_s <= 0.0:
            self._pitch.start_move(self._pitch.home_deg, _OUT_S)

    def _turn_with_gaze(self, turn_deg: tuple[float, float]) -> None:
        """Start a turn of the head by `turn_deg` (yaw, pitch), as far as the travel budget allows.

        The way back is paid for at once, so that the head never stays turned. A turn of less than 3
        degrees is left to the eyes.
        """
        yaw_deg, pitch_deg = self._yaw.affordable(turn_deg[0]), self._pitch.affordable(turn_deg[1])
        if math.hypot(yaw_deg, pitch_deg) < _LEAST_TURN_DEG:
            return
        self._is_turned = True
        for axis, way_deg in ((self._yaw, yaw_deg), (self._pitch, pitch_deg)):
            if abs(way_deg) >= _LEAST_MOVE_DEG and axis.spend(2.0 * abs(way_deg)):
                axis.start_move(axis.home_deg + way_deg, _MOVE_S)

    def _maybe_turn_back(self, turn_deg: tuple[float, float]) -> None:
        """Start the way back if gaze is no longer so far away that the head should turn with it.

        turn_deg: (yaw, pitch) of the head's part of gaze.
        """
        if math.hypot(*turn_deg) < _LEAST_TURN_DEG:
            self._is_turned = False
            self._yaw.start_move(self._yaw.home_deg, _MOVE_S)
            self._pitch.start_move(self._pitch.home_deg, _MOVE_S)


#: Where a head turns and drifts it is slow; with accents, quick: through 1.6 Hz a nod would come
#: 0.2 s late, and people's heads lag their voices by some 30 ms.
_TURNING_HZ, _HEAD_HZ, _MOST_DEG_S = 1.6, 4.0, 120.0
#: The head stays where it is for a partner whose motion would move it by less; the eyes follow.
_STEADY_DEG = 1.0


class HeadPose:
    """The head's pitch, yaw and roll: conversation and idle motion mixed, and its part of gaze."""

    def __init__(self, seed: int) -> None:
        """Create the generators of the head's motion; `seed`: of their random numbers."""
        self._drift = HeadDrift(Random(f"{seed} head"))
        self._accents = ProsodyAccents(Random(f"{seed} accents"))
        self._idle = IdlePosture(Random(f"{seed} idle"))
        # A slow filter for turning and drifting, and after it a quick one that lets nods through.
        self._turning_pitch, self._turning_yaw, self._turning_roll = (
            DampedFollower(_TURNING_HZ, _MOST_DEG_S) for _ in range(3)
        )
        self._pitch, self._yaw, self._roll = (
            DampedFollower(_HEAD_HZ, _MOST_DEG_S) for _ in range(3)
        )
        # Where gaze was directed last, the head's part of that, and its part for the partner.
        self._aim_deg = self._aim_part_deg = self._partner_part_deg = STRAIGHT_AHEAD

    def settle(self) -> None:
        """Start moving the small offsets of idle motion back to 0, as the face goes to rest."""
        self._idle.settle()

    def step(
        self, cue: ExpressionCue, alertness: Alertness, gaze: Gaze, amount: float, gain: float
    ) -> tuple[float, float, float]:
        """Advance by one cue, 10 ms; return (pitch, yaw, roll) of the head in degrees.

        gaze: of which the head takes its part. amount: size of all motion, 0 to 1.5. gain: further
        factor of the drift, by arousal.
        """
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
        # Gaze, drift in conversation and idle motion move the head slowly, nods quickly.
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
        """Return (yaw, pitch) of the head's part of gaze, relative to its part for the partner."""
        if gaze.aim_deg is not self._aim_deg:
            self._aim_deg = gaze.aim_deg
            self._aim_part_deg = head_part_deg(gaze.aim_deg)
        aim_yaw_deg, aim_pitch_deg = self._aim_part_deg
        held_yaw_deg, held_pitch_deg = self._partner_part_deg
        turn_deg = (aim_yaw_deg - held_yaw_deg, aim_pitch_deg - held_pitch_deg)
        # At the partner the head takes a new pose only if it differs enough.
        if gaze.is_mutual:
            off_deg = abs(turn_deg[0]) + abs(turn_deg[1])
            if off_deg > _STEADY_DEG or self._aim_deg == STRAIGHT_AHEAD:
                self._partner_part_deg = self._aim_part_deg
                return STRAIGHT_AHEAD
        return turn_deg
