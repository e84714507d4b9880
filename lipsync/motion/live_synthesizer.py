"""The live method: every frame as it is expected to be, from all that is known by then.

Frame-synchronous: a phoneme moves the mouth from its onset, before its end is known, and what the
recogniser takes back changes only what has not been shown. Faces are decided on a grid of 10 ms,
each from what is known at its own time; between two of them the motion is a cubic. Position and
speed are continuous whatever arrives, and lips that must touch do.
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.errors import UserError
from lipsync.expectation.context import context_at, track_of
from lipsync.expectation.expectation import Expectation
from lipsync.face.model import FaceModel
from lipsync.motion.closure_plan import BILABIALS, LABIODENTALS, OPEN, Amount, planned
from lipsync.motion.lip_closure import PRESSED_GAP_MM, lip_gap_of
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline

Array = NDArray[np.float64]

#: Speech is published at 100 Hz (architecture.md, Time).
TICK_S = 0.010
#: Its name on the command line and in results.
LIVE_STRATEGY = "expected"
DEFAULT_LOOKAHEAD_S = 0.1
#: More look-ahead than this is allowed but not used: the model has learned no more.
USED_LOOKAHEAD_S = 0.2
LONGEST_LOOKAHEAD_S = 1.0
STRONGEST = 1.5
#: Longer than a stop gap inside a word (to 120 ms) with its borders heard 50 ms wrong: a silence
#: that lasts longer is a pause, and in a pause the mouth comes to rest.
PAUSE_S = 0.17
#: So long it takes to come to rest. It is left within this share of the look-ahead, so that the
#: mouth is where it should be at the onset: 10 ms later costs .002 of ratio (inner split).
RESTING_S = 0.15
_WAKING_SHARE = 0.7
#: Ticks kept for times that are asked for again.
_KEPT = 64
#: After a longer leap in time the motion in between was seen by nobody and is not computed.
_LONGEST_LEAP_TICKS = 100
#: Averages over what is not known move too little. A share of the last frame's step (25 Hz, as in
#: the recordings) is gone ahead; chosen on inner splits (docs/motion.md).
LEAD = 0.07
_LEAD_TICKS = 4
#: The slowest that smoothness can make the mouth: its time constant, s.
_SLOWEST_S = 0.04
_SILENCE = PHONEMES.index(SILENCE)


class StyleError(UserError):
    """A strength, smoothness or look-ahead outside what is allowed."""


@dataclass(frozen=True, slots=True)
class Style:
    """What the user may set.

    lookahead_s: how much later than its sound a face may be shown, for the sake of what comes next;
    strength: 0 keeps the mouth closed, 1 moves as the talker did, 1.5 is as far as it goes;
    smoothness: 0 follows at once, 1 is as slow as it gets.
    """

    lookahead_s: float = DEFAULT_LOOKAHEAD_S
    strength: float = 1.0
    smoothness: float = 0.0

    def __post_init__(self) -> None:
        limits = {
            "lookahead_s": LONGEST_LOOKAHEAD_S,
            "strength": STRONGEST,
            "smoothness": 1.0,
        }
        for name, most in limits.items():
            value = getattr(self, name)
            if not 0.0 <= value <= most:
                raise StyleError(f"{name} is {value}; allowed: 0 to {most}")


@dataclass(frozen=True, slots=True)
class _Tick:
    """Motion from one grid point to the next: a cubic, and how far the lips are being closed.

    Tick n ends at n TICK_S. Speeds are per tick. resting: how much of the rest pose a pause brings.
    """

    start: Array
    start_speed: Array
    end: Array
    end_speed: Array
    pressed: Amount
    bitten: Amount
    resting: Amount

    def at(self, u: float) -> Array:
        """The face (n_components,) at share u of the tick."""
        face = (1.0 + 2.0 * u) * (1.0 - u) ** 2 * self.start + u**2 * (3.0 - 2.0 * u) * self.end
        face += u * (1.0 - u) ** 2 * self.start_speed + u**2 * (u - 1.0) * self.end_speed
        return face


class LiveSynthesizer:
    """Our strategy over a revisable stream of phonemes."""

    def __init__(
        self, model: FaceModel, expectation: Expectation, style: Style | None = None
    ) -> None:
        self._model = model
        self._expectation = expectation
        self._style = style or Style()
        self._gap = lip_gap_of(model)
        self._bilabial_s = _moments_s(model, BILABIALS)
        self._labiodental_s = _moments_s(model, LABIODENTALS)
        self._known_s = min(self._style.lookahead_s, USED_LOOKAHEAD_S)
        slowness_s = self._style.smoothness * _SLOWEST_S
        self._keep = math.exp(-TICK_S / slowness_s) if slowness_s else 0.0
        self.reset()

    @property
    def lookahead_s(self) -> float:
        """How much sound after an instant must have been heard before its face is asked for."""
        return self._style.lookahead_s

    def reset(self) -> None:
        """Forget everything; the mouth is closed and the stream begins anew at sound time 0."""
        rest, still = self._model.rest, np.zeros_like(self._model.rest)
        self._timeline = PhonemeTimeline()
        self._track = track_of(())
        self._wanted = rest
        self._expectations = deque([rest] * _LEAD_TICKS, maxlen=_LEAD_TICKS)
        resting = Amount(0.0, RESTING_S, 1.0, 0.0, 1.0)
        self._ticks = deque([_Tick(rest, still, rest, still, OPEN, OPEN, resting)], maxlen=_KEPT)
        self._newest = -1  # number of the newest tick
        self._phoneme_moved = -math.inf
        self.phonemes_planned = 0

    def push(self, update: PhonemeUpdate) -> None:
        """Believe a recogniser; what has been shown stays as it is."""
        self._timeline.apply(update)
        self._track = track_of(self._timeline.events)

    def coefficients_at(self, time_s: float) -> Array:
        """The face (n_components,) at sound time `time_s`; the same time gives the same face.

        Times may step back by half a second, not more.
        """
        number = math.ceil(time_s / TICK_S - 1e-6)
        self._newest = max(self._newest, number - _LONGEST_LEAP_TICKS)
        while self._newest < number:
            self._plan(self._newest + 1)
        back = self._newest - number
        if back >= len(self._ticks):
            return self._model.rest
        tick = self._ticks[-1 - back]
        face = tick.at(min(1.0, max(0.0, time_s / TICK_S - number + 1.0)))
        awake = self._style.strength * (1.0 - tick.resting.smooth(time_s))
        face = self._model.rest + awake * (face - self._model.rest)
        bitten, pressed = tick.bitten.smooth(time_s), tick.pressed.smooth(time_s)
        face = self._gap.narrowed(face, self._model.labiodental_gap_mm, bitten)
        return self._gap.narrowed(face, PRESSED_GAP_MM, pressed)

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme believed at a time, for displays."""
        return self._timeline.event_at(time_s)

    @property
    def is_resting(self) -> bool:
        """Whether the mouth is at rest, or on its way there, because nobody speaks."""
        return self._ticks[-1].resting.goal == 1.0

    def _plan(self, number: int) -> None:
        """Decide the motion of one tick from what is known at its end."""
        time_s = number * TICK_S
        known_until_s = time_s + self._known_s
        last = self._ticks[-1]
        begin_s = time_s - TICK_S
        context = context_at(self._track, time_s, known_until_s)
        resting = self._resting(last.resting, *context, begin_s)
        at_rest = resting.goal == 1.0 and resting.at(begin_s) == (1.0, 0.0)
        wanted = self._livened(self._expected(time_s, *context, at_rest=at_rest))
        self._wanted = self._keep * self._wanted + (1.0 - self._keep) * wanted
        # Half of the way a chord would go: a sudden turn then overshoots by a few percent only.
        end_speed = (self._wanted - last.start) / 2.0
        pressed = planned(last.pressed, self._bilabial_s, self._track, begin_s, known_until_s)
        bitten = planned(last.bitten, self._labiodental_s, self._track, begin_s, known_until_s)
        tick = _Tick(last.end, last.end_speed, self._wanted, end_speed, pressed, bitten, resting)
        self._ticks.append(tick)
        self._newest = number

    def _expected(
        self, time_s: float, phonemes: list[int], times_s: list[float], *, at_rest: bool
    ) -> Array:
        """What the mouth should look like while somebody speaks."""
        if at_rest:
            return self._model.rest
        self._count(time_s - times_s[2])
        return self._expectation.at(phonemes, times_s, self._known_s)

    def _livened(self, expectation: Array) -> Array:
        """The expectation, and a little more of where it is going."""
        before = self._expectations[0]
        self._expectations.append(expectation)
        return expectation + LEAD * (expectation - before)

    def _resting(
        self, now: Amount, phonemes: list[int], times_s: list[float], time_s: float
    ) -> Amount:
        """How the mouth comes to rest in a pause, and leaves it when the end of it is known."""
        is_pause = phonemes[2] == _SILENCE and times_s[2] > PAUSE_S and math.isnan(times_s[3])
        if is_pause == (now.goal == 1.0):
            return now
        waking_s = max(TICK_S, _WAKING_SHARE * self._known_s)
        duration_s, goal = (RESTING_S, 1.0) if is_pause else (waking_s, 0.0)
        return Amount(time_s, duration_s, *now.at(time_s), goal)

    def _count(self, start_s: float) -> None:
        if start_s > self._phoneme_moved:
            self._phoneme_moved = start_s
            self.phonemes_planned += 1


def _moments_s(model: FaceModel, phonemes: Iterable[str]) -> dict[int, float]:
    numbers = [PHONEMES.index(p) for p in phonemes]
    return {number: float(model.tightest_s[number]) for number in numbers}
