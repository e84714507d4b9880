"""Brows that go up with the voice."""

import math
from random import Random

from lipsync.expression.bounded import bounded
from lipsync.expression.cue import CUE_PERIOD_S
from lipsync.expression.prosody_accents import MOST_Z
from lipsync.prosody.voice_frame import VoiceFrame

_FAST_S, _SLOW_S = 0.05, 0.5
#: Seven of ten rises of pitch go with a flash (71 %, Cave et al., ICSLP 1996), some come unasked.
_RISING, _WITH_RISE = 0.6, 0.71
_APART_S = 1.2
_UNASKED_PER_S = 1.0 / 25.0
_LEAST_FLASH, _FLASH_PER_EXCESS, _MOST_FLASH = 0.35, 0.2, 0.8
#: A flash stays up, and goes.
_HOLD_S, _DECAY_S = 0.12, 0.25
#: Higher voice, higher brows (Huron and Shanahan, Music Perception 30(5), 2013).
_PER_PITCH, _MOST_BY_PITCH = 0.08, 0.2


class BrowFlashes:
    """Raised brows, 0 to 1: flashes with rises of pitch, and a little of the pitch itself."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._fast_share = -math.expm1(-CUE_PERIOD_S / _FAST_S)
        self._slow_share = -math.expm1(-CUE_PERIOD_S / _SLOW_S)
        self._kept = math.exp(-CUE_PERIOD_S / _DECAY_S)
        self._fast = 0.0
        self._slow = 0.0
        self._since_s = _APART_S
        self._was_rising = False
        self._flash = 0.0

    def step(self, voice: VoiceFrame, is_speaking: bool, is_idle: bool) -> float:
        """One cue later; nothing begins where the face is idle."""
        self._since_s += CUE_PERIOD_S
        if is_speaking and voice.is_speech and voice.pitch_hz > 0.0:
            pitch = bounded(voice.pitch_z, -MOST_Z, MOST_Z)
            self._fast += self._fast_share * (pitch - self._fast)
            self._slow += self._slow_share * (pitch - self._slow)
        elif not is_speaking:
            self._fast -= self._slow_share * self._fast
            self._slow -= self._slow_share * self._slow
        if self._since_s > _HOLD_S:
            self._flash *= self._kept
        excess = self._fast - self._slow
        was_rising, self._was_rising = self._was_rising, excess > _RISING
        if self._since_s >= _APART_S and not is_idle:
            if self._was_rising and not was_rising:
                self._begin(excess, _WITH_RISE)
            elif self._random.random() < _UNASKED_PER_S * CUE_PERIOD_S:
                self._begin(0.0, 1.0)
        return self._flash + bounded(_PER_PITCH * self._slow, 0.0, _MOST_BY_PITCH)

    def _begin(self, excess: float, chance: float) -> None:
        if self._random.random() < chance:
            self._since_s = 0.0
            self._flash = min(_MOST_FLASH, _LEAST_FLASH + _FLASH_PER_EXCESS * excess)
