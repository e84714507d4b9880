"""Motion of lids and brows: blinks, lids that follow the eyes, brows that rise with the voice."""

import math
from random import Random

from lipsync.expression.cue import CUE_PERIOD_S, bounded, smoothstep
from lipsync.expression.head_pose import MOST_Z
from lipsync.prosody.voice_frame import VoiceFrame

#: Down in about 90 ms, up in about 240 (VanderWerf et al., J. Neurophysiology 89, 2003), shut for
#: 20: full closures with a slow way up are what people like (Trutoiu et al., ACM TAP 8(3), 2011).
CLOSING_S, HOLDING_S, OPENING_S = 0.09, 0.02, 0.24
#: Intervals between blinks are log-normal, with this standard deviation of their logarithm.
SIGMA = 0.8
#: From the beginning of a blink to that of the next one, at least: 0.4, and two cues in which a lid
#: that is half down passes any mark sooner.
REFRACTORY_S = 0.42
#: People blink where speech ends (Nakano and Kitazawa, Exp. Brain Research 205, 2010): so often,
#: and so long after. Half as often would be too often in a dialogue of short turns.
_AT_END, _AFTER_END_S = 0.3, 0.08
#: Small saccades go without a blink, nearly all above 33 degrees with one (Evinger et al., 1994).
_NO_BLINK_DEG, _ALL_BLINK_DEG, _MOST_BLINKING = 5.0, 28.0, 0.97


class Blinks:
    """A generator of blinks: spontaneous at log-normal intervals, at ends of speech, with saccades.

    The interval until the next spontaneous blink is drawn anew after each blink, in units of the
    mean interval, so that the rate may change while it passes.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._interval_left = self._drawn_interval()
        self._since_s = REFRACTORY_S
        self._until_end_blink_s = math.inf

    def step(self, rate_per_min: float, speech_ended: bool, saccade_deg: float) -> float:
        """Advance by one cue, 10 ms; return how far blinking shuts the lids, 0 to 1.

        rate_per_min: of spontaneous blinks; 0: no blink at all begins. speech_ended: whether speech
        ends in this cue, after which a blink may come. saccade_deg: size of a saccade that begins
        now, else 0.
        """
        self._since_s += CUE_PERIOD_S
        self._interval_left -= rate_per_min / 60.0 * CUE_PERIOD_S
        self._until_end_blink_s -= CUE_PERIOD_S
        random = self._random
        if speech_ended and random.random() < _AT_END:
            self._until_end_blink_s = _AFTER_END_S
        with_saccade = False
        if saccade_deg > _NO_BLINK_DEG:
            chance = bounded((saccade_deg - _NO_BLINK_DEG) / _ALL_BLINK_DEG, 0.0, _MOST_BLINKING)
            with_saccade = random.random() < chance
        is_due = with_saccade or self._interval_left <= 0.0 or self._until_end_blink_s <= 0.0
        if is_due and self._since_s >= REFRACTORY_S and rate_per_min > 0.0:
            self._since_s = 0.0
            self._interval_left = self._drawn_interval()
            self._until_end_blink_s = math.inf
        return closure(self._since_s)

    def _drawn_interval(self) -> float:
        """Return a random interval until the next blink, log-normal, in units of its mean."""
        return self._random.lognormvariate(-SIGMA * SIGMA / 2.0, SIGMA)


def closure(since_s: float) -> float:
    """Return how far a blink shuts the lids `since_s` seconds after its beginning, 0 to 1."""
    if since_s >= CLOSING_S + HOLDING_S + OPENING_S:
        return 0.0
    if since_s < CLOSING_S:
        return smoothstep(since_s / CLOSING_S)
    return 1.0 - smoothstep((since_s - CLOSING_S - HOLDING_S) / OPENING_S)


#: Lids go down with the eyes and up with them, in shares of the way to shut per degree.
_PER_DEG_DOWN, _MOST_DOWN = 0.02, 0.5
_PER_DEG_UP, _MOST_UP = 0.01, 0.15
#: Wide open and sleepily open.
WIDEST, _SLEEPIEST = -0.4, 0.65


def lid_position(eye_pitch_deg: float, offset: float, size: float, blink: float) -> float:
    """Return the position of a lid: 0 open, 1 shut, below 0 wider than at rest.

    eye_pitch_deg: the lid follows the eye up and down. offset: added, by arousal. size: factor of
    these two, 0 to 1. blink: 0 to 1, closes that share of what is open, so that 1 is shut and
    neither end has a corner.
    """
    if eye_pitch_deg < 0.0:
        follow = min(_MOST_DOWN, -_PER_DEG_DOWN * eye_pitch_deg)
    else:
        follow = -min(_MOST_UP, _PER_DEG_UP * eye_pitch_deg)
    open_position = size * bounded(follow + offset, WIDEST, _SLEEPIEST)
    return open_position + (1.0 - open_position) * blink


#: Time constants of the fast and the slow mean of pitch.
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
    """A generator of raised brows, 0 to 1: short flashes when pitch rises, and by high pitch."""

    def __init__(self, random: Random) -> None:
        """Create the generator with brows at rest; `random`: its random generator."""
        self._random = random
        self._fast_share = -math.expm1(-CUE_PERIOD_S / _FAST_S)
        self._slow_share = -math.expm1(-CUE_PERIOD_S / _SLOW_S)
        self._decay = math.exp(-CUE_PERIOD_S / _DECAY_S)
        self._fast = 0.0
        self._slow = 0.0
        self._since_s = _APART_S
        self._was_rising = False
        self._flash = 0.0

    def step(self, voice: VoiceFrame, is_speaking: bool, is_idle: bool) -> float:
        """Advance by one cue, 10 ms; return how far brows are raised, 0 to 1.

        voice: its pitch counts only while the robot speaks (`is_speaking`). No flash begins while
        `is_idle`. Pitch rises where its fast mean exceeds its slow mean by 0.6 standard deviations.
        """
        self._since_s += CUE_PERIOD_S
        if is_speaking and voice.is_speech and voice.pitch_hz > 0.0:
            pitch = bounded(voice.pitch_z, -MOST_Z, MOST_Z)
            self._fast += self._fast_share * (pitch - self._fast)
            self._slow += self._slow_share * (pitch - self._slow)
        elif not is_speaking:
            self._fast -= self._slow_share * self._fast
            self._slow -= self._slow_share * self._slow
        if self._since_s > _HOLD_S:
            self._flash *= self._decay
        excess = self._fast - self._slow
        was_rising, self._was_rising = self._was_rising, excess > _RISING
        if self._since_s >= _APART_S and not is_idle:
            if self._was_rising and not was_rising:
                self._maybe_begin_flash(excess, _WITH_RISE)
            elif self._random.random() < _UNASKED_PER_S * CUE_PERIOD_S:
                self._maybe_begin_flash(0.0, 1.0)
        return self._flash + bounded(_PER_PITCH * self._slow, 0.0, _MOST_BY_PITCH)

    def _maybe_begin_flash(self, excess: float, chance: float) -> None:
        """Begin a flash with probability `chance`; it is the larger the more `excess` pitch has."""
        if self._random.random() < chance:
            self._since_s = 0.0
            self._flash = min(_MOST_FLASH, _LEAST_FLASH + _FLASH_PER_EXCESS * excess)
