"""The input of a face's expression, one cue every 10 ms, and helpers shared by all generators.

Bounds keep motion within its limits whatever a cue contains; a damped follower moves as mass does.
"""

import math
from dataclasses import dataclass
from typing import Final, Protocol

from lipsync.face.frame import Expression
from lipsync.prosody.voice_frame import SILENT_VOICE, VoiceFrame


def bounded(value: float, least: float, most: float) -> float:
    """Return `value` clipped to `least` and `most`, infinities included; 0 for NaN."""
    if value != value:
        return 0.0
    return least if value < least else most if value > most else value


def smoothstep(share: float) -> float:
    """Return 3 u^2 - 2 u^3 for a `share` u clipped to 0 to 1: slope 0 at both ends, at most 1.5."""
    if share <= 0.0:
        return 0.0
    return 1.0 if share >= 1.0 else share * share * (3.0 - 2.0 * share)


def toward(value: float, goal: float, step: float) -> float:
    """Return `value` moved by one `step` towards `goal`, never beyond the goal."""
    return min(goal, value + step) if value < goal else max(goal, value - step)


#: From one cue to the next.
CUE_PERIOD_S: Final = 0.010


@dataclass(frozen=True, slots=True)
class ExpressionCue:
    """The input of a face's expression at one instant of sound time, causal.

    time_s: sound time; it grows by CUE_PERIOD_S. voice: the voice heard. is_speaking: the robot's
    mouth speaks (pauses within a sentence count as speech until 0.3 s have passed). silent_s: how
    long no person has spoken. look_at_deg: (yaw, pitch) of a person to look at, in the robot's own
    frame, None: no person. valence: -1 (sad) to 1 (glad), from a dialogue system; arousal: -1 to 1,
    of the voice or from a dialogue system. amount: 0 (still) to 1 (as measured on people), and up
    to 1.5.
    """

    time_s: float
    voice: VoiceFrame = SILENT_VOICE
    is_speaking: bool = False
    silent_s: float = 0.0
    look_at_deg: tuple[float, float] | None = None
    valence: float = 0.0
    arousal: float = 0.0
    amount: float = 1.0


class ExpressionSource(Protocol):
    """A source of expressions, deterministic: equal seeds and cues give equal motion."""

    def step(self, cue: ExpressionCue) -> Expression:
        """Return the expression at the cue's time; call it once for each cue, in order."""

    @property
    def is_resting(self) -> bool:
        """Whether the face is at neutral, and stays there until a person speaks or moves."""


#: A follower nearer to its target than this, and slower than this in a time constant, is set to the
#: target: the last thousandth of a degree would take forever, and a neck that holds must hold. A
#: servo's pulse is 0.088 degrees.
_ARRIVED = 1e-3


class DampedFollower:
    """A critically damped filter that moves as a mass does: x'' = w^2 (target - x) - 2 w x'.

    It is solved exactly for each cue, 10 ms. The error is cut off at 2 `most_per_s` / w, at which
    the filter's final speed is `most_per_s`, which is never exceeded; no acceleration is more than
    4 w `most_per_s`. The filter does not overshoot: x stays between the least and the greatest
    target that it has had.
    """

    def __init__(self, frequency_hz: float, most_per_s: float) -> None:
        """Create a filter at 0. `frequency_hz`: w / 2 pi; a target's swing at it is halved.

        most_per_s: limit of its speed, in units of the value per second.
        """
        self.value = 0.0
        self._speed_per_s = 0.0
        self._w = 2.0 * math.pi * frequency_hz
        self._decay = math.exp(-self._w * CUE_PERIOD_S)
        self._most_error = 2.0 * most_per_s / self._w

    def follow(self, target: float) -> float:
        """Advance by one cue, 10 ms, with this target; return the new value."""
        error, speed_per_s, w = self.value - target, self._speed_per_s, self._w
        if -_ARRIVED < error < _ARRIVED and abs(speed_per_s) < _ARRIVED * w:
            self.value, self._speed_per_s = target, 0.0
            return target
        most_error = self._most_error
        if error > most_error:
            error = most_error
        elif error < -most_error:
            error = -most_error
        rise = (speed_per_s + w * error) * CUE_PERIOD_S
        self.value += (error + rise) * self._decay - error
        self._speed_per_s = (speed_per_s - w * rise) * self._decay
        return self.value
