"""When eyes blink, and how a lid moves then."""

import math
from random import Random

from lipsync.expression.bounded import bounded, smoothstep
from lipsync.expression.cue import CUE_PERIOD_S

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
    """Blinks of their own accord at log-normal intervals; at ends of speech; with large saccades.

    The interval is drawn anew after any of them. It is counted in mean intervals, so that the rate
    may change while it passes.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._left = self._drawn_interval()
        self._since_s = REFRACTORY_S
        self._until_end_blink_s = math.inf

    def step(self, rate_per_min: float, speech_ended: bool, saccade_deg: float) -> float:
        """How far the lids are shut by blinking, 0 to 1, one cue later.

        rate_per_min: of the blinks of their own accord; 0: no blink at all begins. saccade_deg: of
        a saccade that begins now.
        """
        self._since_s += CUE_PERIOD_S
        self._left -= rate_per_min / 60.0 * CUE_PERIOD_S
        self._until_end_blink_s -= CUE_PERIOD_S
        random = self._random
        if speech_ended and random.random() < _AT_END:
            self._until_end_blink_s = _AFTER_END_S
        with_saccade = False
        if saccade_deg > _NO_BLINK_DEG:
            chance = bounded((saccade_deg - _NO_BLINK_DEG) / _ALL_BLINK_DEG, 0.0, _MOST_BLINKING)
            with_saccade = random.random() < chance
        is_due = with_saccade or self._left <= 0.0 or self._until_end_blink_s <= 0.0
        if is_due and self._since_s >= REFRACTORY_S and rate_per_min > 0.0:
            self._since_s = 0.0
            self._left = self._drawn_interval()
            self._until_end_blink_s = math.inf
        return closure(self._since_s)

    def _drawn_interval(self) -> float:
        """Log-normal with mean 1."""
        return self._random.lognormvariate(-SIGMA * SIGMA / 2.0, SIGMA)


def closure(since_s: float) -> float:
    """How far a blink has shut the lids so long after it began: 0 to 1 and back."""
    if since_s >= CLOSING_S + HOLDING_S + OPENING_S:
        return 0.0
    if since_s < CLOSING_S:
        return smoothstep(since_s / CLOSING_S)
    return 1.0 - smoothstep((since_s - CLOSING_S - HOLDING_S) / OPENING_S)
