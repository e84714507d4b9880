"""Where a voice stresses a syllable: louder and higher than a moment ago."""

import math
from random import Random

from lipsync.expression.bounded import bounded
from lipsync.expression.cue import CUE_PERIOD_S
from lipsync.prosody.voice_frame import VoiceFrame

_FAST_S, _SLOW_S = 0.06, 0.6
#: An accent stands out by so many standard deviations, and comes so long after the last one.
_STANDING_OUT = 0.8
_APART_S = 0.45
#: Not every accent is nodded to.
_NODDED = 0.7
_LEAST_NOD_DEG, _NOD_PER_EXCESS_DEG, _MOST_NOD_DEG = 2.0, 1.2, 6.0
_NOD_DECAY_S = 0.18
#: The head rises with a phrase's loudness and pitch. With less of it, what loudness goes with best
#: is the way back from a nod, 0.2 s late (docs/expression.md).
_PHRASE_DEG = 1.8
#: Beyond this a standard score is a fault or a shout; both count as a shout.
MOST_Z = 4.0


class ProsodyAccents:
    """Head pitch that goes with prosody: a nod to an accent, and the course of the phrase.

    Prominence is loudness + pitch / 2, in standard deviations; an accent is where its fast average
    leaves its slow one behind. The head lags prosody by some 30 ms in people (Fotedar and Ghosh,
    Interspeech 2017), so that nothing need be known beforehand.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._fast_share = -math.expm1(-CUE_PERIOD_S / _FAST_S)
        self._slow_share = -math.expm1(-CUE_PERIOD_S / _SLOW_S)
        self._kept = math.exp(-CUE_PERIOD_S / _NOD_DECAY_S)
        self._fast = 0.0
        self._slow = 0.0
        self._since_s = _APART_S
        self._stands_out = False
        self._nod_deg = 0.0

    def step(self, voice: VoiceFrame, is_speaking: bool) -> float:
        """Degrees of pitch, positive upwards, one cue later."""
        prominence = 0.0
        if is_speaking and voice.is_speech:
            loudness = bounded(voice.loudness_z, -MOST_Z, MOST_Z)
            prominence = loudness + 0.5 * bounded(voice.pitch_z, -MOST_Z, MOST_Z)
        self._fast += self._fast_share * (prominence - self._fast)
        self._slow += self._slow_share * (prominence - self._slow)
        self._nod_deg *= self._kept
        self._since_s += CUE_PERIOD_S
        excess = self._fast - self._slow
        stood_out, self._stands_out = self._stands_out, excess > _STANDING_OUT
        if is_speaking and self._stands_out and not stood_out and self._since_s >= _APART_S:
            self._since_s = 0.0
            if self._random.random() < _NODDED:
                nod_deg = _LEAST_NOD_DEG + _NOD_PER_EXCESS_DEG * excess
                self._nod_deg = -min(_MOST_NOD_DEG, nod_deg)
        return self._nod_deg + _PHRASE_DEG * self._slow
