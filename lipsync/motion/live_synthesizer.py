"""The live methods: the expectation that moves the mouth, and the finishing step of all of them.

Frame-synchronous: a phoneme moves the mouth from its onset, before its end is known, and what the
recogniser takes back changes only what has not been shown. Faces are decided on a grid of 10 ms,
each from what is known at its own time; between two of them the motion is a cubic, continuous in
position and speed whatever arrives.

The finishing step mixes AnimPhos in, scales by the strength, rests in pauses and closes the lips
for P B M F V, in this order, in one frame. Live motion, the paper's method and scripted lines pass
it alike.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from lipsync.animpho.units import AnimPhoUnits
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.expectation.context import PhonemeTrack, context_at, track_of
from lipsync.expectation.expectation import Expectation
from lipsync.face.frame import FaceWindow, Frame
from lipsync.face.model import FaceModel
from lipsync.motion.closures import (
    BILABIAL_GAP_MM,
    BILABIALS,
    LABIODENTALS,
    OPEN,
    closed_share,
    closures,
    lip_gap_of,
    planned,
)
from lipsync.motion.tick_plan import (
    AT_REST,
    TICK_S,
    Amount,
    EasedSetting,
    TickPlan,
    is_reached,
    planned_rest,
    tick_of,
)
from lipsync.motion.unit_motion import UnitMotion
from lipsync.phonemes import PHONEMES, PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline

#: Their names on the command line and in results: the expectation, and AnimPhos near it.
LIVE_STRATEGY = "expected"
UNIT_STRATEGY = "animpho"
DEFAULT_LOOKAHEAD_S = 0.1
LONGEST_LOOKAHEAD_S = 1.0
STRONGEST = 1.5
#: Chosen on inner splits (decisions/0028).
DEFAULT_UNIT_SHARE = 0.25


#: A window shows the face so long after its frame, and where a closure is complete. Finer steps
#: change no plan of joints by more than their noise (docs/decisions/0043).
_WINDOW_S: Final = (0.05, 0.1, 0.15, 0.2)


class StyleError(UserError):
    """A strength, smoothness or look-ahead outside what is allowed."""


@dataclass(frozen=True, slots=True)
class Style:
    """What the user may set.

    lookahead_s: how much later than its sound a face may be shown, for the sake of what comes next;
    strength: 0 keeps the mouth closed, 1 moves as the speaker did, 1.5 is as far as it goes;
    smoothness: 0 follows at once, 1 is as slow as it gets. unit_share: of AnimPhos in the motion,
    where a synthesiser has any: 0 plays the expectation, 1 AnimPhos alone.
    """

    lookahead_s: float = DEFAULT_LOOKAHEAD_S
    strength: float = 1.0
    smoothness: float = 0.0
    unit_share: float = DEFAULT_UNIT_SHARE

    def __post_init__(self) -> None:
        limits = {
            "lookahead_s": LONGEST_LOOKAHEAD_S,
            "strength": STRONGEST,
            "smoothness": 1.0,
            "unit_share": 1.0,
        }
        for name, most in limits.items():
            value = getattr(self, name)
            if not 0.0 <= value <= most:
                raise StyleError(f"{name} is {value}; allowed: 0 to {most}")


#: More look-ahead than this is allowed but not used: the model has learned no more.
USED_LOOKAHEAD_S = 0.2
#: Averages over what is not known move too little. A share of the last frame's step (25 Hz, as in
#: the recordings) is extrapolated; chosen on inner splits (docs/motion.md).
LEAD = 0.1
_LEAD_TICKS = 4
#: The recordings' 25 frames a second know of nothing quicker than 80 ms; a context does, it changes
#: from one tick to the next. So what is expected is averaged over so many ticks before and after,
#: as far as the look-ahead reaches.
_AVERAGED_TICKS = 1
#: A look-ahead of whole ticks is a quotient of floats.
_ROUNDING_TICKS = 1e-6
#: The slowest that smoothness can make the mouth: its time constant, s.
_SLOWEST_S = 0.04


@dataclass(frozen=True, slots=True)
class _Tick:
    """Motion from one grid point to the next: a cubic. Speeds are per tick.

    rest: how far a pause has brought the mouth to rest.
    """

    start: Array
    start_speed: Array
    end: Array
    end_speed: Array
    rest: Amount

    def at(self, u: float) -> Array:
        """The face (n_components,) at share u of the tick."""
        face = (1.0 + 2.0 * u) * (1.0 - u) ** 2 * self.start + u**2 * (3.0 - 2.0 * u) * self.end
        face += u * (1.0 - u) ** 2 * self.start_speed + u**2 * (u - 1.0) * self.end_speed
        return face


class ExpectedMotion:
    """The learned expectation over a revisable stream of phonemes, and nothing around it."""

    def __init__(
        self, expectation: Expectation, rest: Array, *, lookahead_s: float, smoothness: float
    ) -> None:
        """rest: (n_components,), the closed mouth; smoothness: from 0 to 1, as in `Style`."""
        self._expectation = expectation
        self._rest = rest
        self._lookahead_s = lookahead_s
        self.known_s = min(lookahead_s, USED_LOOKAHEAD_S)
        n_ahead = min(_AVERAGED_TICKS, int(self.known_s / TICK_S + _ROUNDING_TICKS))
        self._ahead_s = n_ahead * TICK_S
        self._weights = _bell(2 * n_ahead + 1)
        self._smoothness = EasedSetting(smoothness, 1.0)
        self.reset()

    @property
    def lookahead_s(self) -> float:
        """How much sound after an instant must have been heard before its frame is asked for."""
        return self._lookahead_s

    @property
    def track(self) -> PhonemeTrack:
        """The phonemes as they are believed now, end to end."""
        return self._track

    def reset(self) -> None:
        """Forget everything; the mouth is closed and the stream begins anew at sound time 0."""
        rest, still = self._rest, np.zeros_like(self._rest)
        self._timeline = PhonemeTimeline()
        self._track = track_of(())
        self._wanted = rest
        self._expectations = deque([rest] * _LEAD_TICKS, maxlen=_LEAD_TICKS)
        self._newest = deque([rest] * len(self._weights), maxlen=len(self._weights))
        self._ticks = TickPlan(_Tick(rest, still, rest, still, AT_REST))
        self._smoothness.settle()
        self._newest_start_s = -math.inf
        self.phonemes_planned = 0

    def push(self, update: PhonemeUpdate) -> None:
        """Take a revision of the phonemes; what has been shown stays as it is."""
        self._timeline.apply(update)
        self._track = track_of(self._timeline.events)

    def frame_at(self, time_s: float) -> Frame:
        """The frame at sound time `time_s`; the same time gives the same frame.

        Times may step back by half a second, not more.
        """
        tick = self._ticks.at(time_s, self._decide)
        if tick is None:
            return Frame(time_s, self._rest)
        share = time_s / TICK_S - tick_of(time_s) + 1.0
        return Frame(time_s, tick.at(min(1.0, max(0.0, share))))

    def faces_after(self, frame: Frame, times_s: Array) -> Array:
        """The faces (k, n_components) expected at later sound times (k,); decides nothing."""
        until_s = frame.time_s + self.known_s
        found = [context_at(self._track, time_s, until_s) for time_s in times_s.tolist()]
        phonemes = np.array([phonemes for phonemes, _ in found])
        known_s = np.maximum(until_s - times_s, 0.0)
        return self._expectation.faces(phonemes, np.array([times for _, times in found]), known_s)

    def adjust_smoothness(self, smoothness: float) -> None:
        """Go over to another smoothness, 0 to 1, from the newest tick on."""
        self._smoothness.change(self._ticks.decided_until_s, smoothness)

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme believed at a time, for displays."""
        return self._timeline.event_at(time_s)

    def _decide(self, time_s: float, last: _Tick) -> _Tick:
        """The motion of the tick that ends at `time_s`, from what is known then."""
        begin_s = time_s - TICK_S
        context = context_at(self._track, time_s, time_s + self.known_s)
        rest = planned_rest(last.rest, *context, begin_s, self.known_s)
        at_rest = is_reached(rest, begin_s)
        self._newest.append(self._expected(time_s, at_rest=at_rest))
        wanted = self._extrapolated(self._weights @ np.array(self._newest))
        slowness_s = self._smoothness.at(time_s) * _SLOWEST_S
        keep = math.exp(-TICK_S / slowness_s) if slowness_s else 0.0
        self._wanted = keep * self._wanted + (1.0 - keep) * wanted
        # Half of the way a chord would go: a sudden turn then overshoots by a few percent only.
        end_speed = (self._wanted - last.start) / 2.0
        return _Tick(last.end, last.end_speed, self._wanted, end_speed, rest)

    def _expected(self, time_s: float, *, at_rest: bool) -> Array:
        """What the mouth should look like a little later, while somebody speaks.

        From a mouth at rest the motion sets out from rest itself, not from the mean of silences.
        """
        if at_rest:
            return self._rest
        known_s = self.known_s - self._ahead_s
        later_s = time_s + self._ahead_s
        phonemes, times_s = context_at(self._track, later_s, later_s + known_s)
        self._count(later_s - times_s[2])
        return self._expectation.at(phonemes, times_s, known_s)

    def _extrapolated(self, expectation: Array) -> Array:
        """The expectation, and a little more of where it is going."""
        before = self._expectations[0]
        self._expectations.append(expectation)
        return expectation + LEAD * (expectation - before)

    def _count(self, start_s: float) -> None:
        if start_s > self._newest_start_s:
            self._newest_start_s = start_s
            self.phonemes_planned += 1


def _bell(n: int) -> Array:
    """Weights (n,) of a mean, largest in the middle (Hann's window)."""
    weights = np.sin(np.pi * np.arange(1, n + 1) / (n + 1)) ** 2
    return np.asarray(weights / weights.sum())


class TrackedSynthesizer(Protocol):
    """What the finishing step is put around: a `Synthesizer` whose phonemes it can see."""

    @property
    def track(self) -> PhonemeTrack:
        """The phonemes as they are believed now, end to end."""

    @property
    def phonemes_planned(self) -> int:
        """How many phonemes have moved the mouth."""

    @property
    def lookahead_s(self) -> float:
        """How much sound after an instant must have been heard before its frame is asked for."""

    def reset(self) -> None:
        """Forget everything."""

    def push(self, update: PhonemeUpdate) -> None:
        """Take a revision of the phonemes."""

    def frame_at(self, time_s: float) -> Frame:
        """The frame at a sound time."""

    def faces_after(self, frame: Frame, times_s: Array) -> Array:
        """The faces (k, n_components) expected at sound times (k,) after the newest frame."""

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme believed at a time, for displays."""


@dataclass(frozen=True, slots=True)
class _Finish:
    """What is decided for one tick: how far the mouth is at rest, and its lips are closed."""

    rest: Amount = AT_REST
    bilabial: Amount = OPEN
    labiodental: Amount = OPEN


class FinishedSynthesizer:
    """The finishing step around a synthesiser: AnimPhos, strength, rest in pauses, closures."""

    def __init__(
        self,
        model: FaceModel,
        inner: TrackedSynthesizer,
        strength: float = 1.0,
        *,
        known_s: float | None = None,
        adjust_inner: Mapping[str, Callable[[float], None]] | None = None,
        units: UnitMotion | None = None,
        unit_share: float = DEFAULT_UNIT_SHARE,
    ) -> None:
        """strength: 0 keeps the mouth at rest, 1 changes nothing.

        known_s: how far beyond its tick a decision may look, s; None for what the look-ahead of
        `inner` allows. adjust_inner: how `inner` takes a new value of its own settings, by name.
        units: AnimPhos to mix in, None for none; unit_share: 0 leaves them out, 1 shows them alone.
        """
        self._inner = inner
        self._known_s = min(inner.lookahead_s, USED_LOOKAHEAD_S) if known_s is None else known_s
        self._rest = model.rest
        self._gap = lip_gap_of(model)
        self._labiodental_gap_mm = model.labiodental_gap_mm
        self._bilabial_s = _tightest_s(model, BILABIALS)
        self._labiodental_s = _tightest_s(model, LABIODENTALS)
        self._units = units
        self._strength = EasedSetting(strength, STRONGEST)
        self._unit_share = EasedSetting(unit_share, 1.0)
        self._ticks = TickPlan(_Finish())
        self._adjust = {**(adjust_inner or {}), "strength": self._changing(self._strength)}
        if units is not None:
            self._adjust["unit_share"] = self._changing(self._unit_share)

    @property
    def is_resting(self) -> bool:
        """Whether the mouth is at rest, or on its way there, because nobody speaks."""
        return self._ticks.newest.rest.goal == 1.0

    @property
    def strength(self) -> float:
        """As it was set last."""
        return self._strength.goal

    @property
    def adjustable(self) -> Set[str]:
        """Names of the settings that may change while the mouth moves."""
        return self._adjust.keys()

    @property
    def phonemes_planned(self) -> int:
        """How many phonemes have moved the mouth."""
        return self._inner.phonemes_planned

    @property
    def lookahead_s(self) -> float:
        """How much sound after an instant must have been heard before its frame is asked for."""
        return self._inner.lookahead_s

    def reset(self) -> None:
        """Forget everything but the settings; the mouth is closed at sound time 0."""
        self._inner.reset()
        if self._units is not None:
            self._units.reset()
        self._strength.settle()
        self._unit_share.settle()
        self._ticks = TickPlan(_Finish())

    def push(self, update: PhonemeUpdate) -> None:
        """Take a revision of the phonemes; what has been shown stays as it is."""
        self._inner.push(update)

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme believed at a time, for displays."""
        return self._inner.event_at(time_s)

    def adjust(self, name: str, value: float) -> None:
        """Set a setting from the newest face on, eased in over `ADJUSTING_S`.

        What was shown stays as it was. Raises StyleError for a setting that it has not, or beyond
        its limits.
        """
        if name not in self._adjust:
            raise StyleError(f"{name} cannot be adjusted; {', '.join(sorted(self._adjust))} can")
        Style(**{name: value})
        self._adjust[name](value)

    def frame_at(self, time_s: float) -> Frame:
        """The frame at sound time `time_s`; the same time gives the same frame."""
        frame = self._inner.frame_at(time_s)
        face = frame.coefficients
        if self._units is not None:
            face = self._mixed(face, self._units, time_s)
        strength = self._strength.at(time_s)
        if strength != 1.0:
            face = self._rest + strength * (face - self._rest)
        finish = self._ticks.at(time_s, self._decide)
        if finish is not None:
            face = self._rest + (1.0 - finish.rest.smooth(time_s)) * (face - self._rest)
            labiodental = finish.labiodental.smooth(time_s)
            face = self._gap.narrowed(face, self._labiodental_gap_mm, labiodental)
            face = self._gap.narrowed(face, BILABIAL_GAP_MM, finish.bilabial.smooth(time_s))
        return replace(frame, coefficients=face)

    def window_after(self, frame: Frame) -> FaceWindow:
        """What is expected after the newest frame by the phonemes known; decides nothing."""
        now_s, finish = frame.time_s, self._ticks.newest
        until_s = now_s + self._known_s
        track, lips, teeth = self._inner.track, finish.bilabial, finish.labiodental
        closing = [
            (gap_mm, list(closures(amount.touched_s, moments_s, track, now_s, until_s)))
            for amount, moments_s, gap_mm in (
                (teeth, self._labiodental_s, self._labiodental_gap_mm),
                (lips, self._bilabial_s, BILABIAL_GAP_MM),
            )
        ]
        begins_s = {from_s for _, spans_s in closing for from_s, _ in spans_s}
        steps_s = (now_s + step_s for step_s in _WINDOW_S if step_s <= self._known_s)
        times_s = sorted({*steps_s, *(s for s in begins_s if now_s < s <= until_s)})
        strength = self._strength.goal
        faces = self._inner.faces_after(frame, np.array(times_s)) if times_s else ()
        rows, closed = [frame.coefficients], [max(lips.at(now_s)[0], teeth.at(now_s)[0]) == 1.0]
        for time_s, face in zip(times_s, faces, strict=True):
            moved = (1.0 - finish.rest.smooth(time_s)) * strength * (face - self._rest)
            face = self._rest + moved
            shares = [closed_share(spans_s, time_s) for _, spans_s in closing]
            for (gap_mm, _), share in zip(closing, shares, strict=True):
                face = self._gap.narrowed(face, gap_mm, share)
            rows.append(face)
            closed.append(max(shares) == 1.0)
        offsets_s = np.array([now_s, *times_s]) - now_s
        shut = self._gap.shut(frame.coefficients)
        return FaceWindow(offsets_s, np.array(rows), np.array(closed), shut)

    def _mixed(self, face: Array, units: UnitMotion, time_s: float) -> Array:
        """The weighted mean of a face (n_components,) and that of the AnimPhos."""
        of_units = units.at(time_s, self._inner.track)
        share = self._unit_share.at(time_s)
        if of_units is None or share == 0.0:
            return face
        return face + share * (of_units - face)

    def _decide(self, time_s: float, last: _Finish) -> _Finish:
        """Rest and closures of the tick that ends at `time_s`, from what is known then."""
        track, begin_s, until_s = self._inner.track, time_s - TICK_S, time_s + self._known_s
        context = context_at(track, time_s, until_s)
        return _Finish(
            planned_rest(last.rest, *context, begin_s, self._known_s),
            planned(last.bilabial, self._bilabial_s, track, begin_s, until_s),
            planned(last.labiodental, self._labiodental_s, track, begin_s, until_s),
        )

    def _changing(self, setting: EasedSetting) -> Callable[[float], None]:
        return lambda value: setting.change(self._ticks.decided_until_s, value)


def _tightest_s(model: FaceModel, phonemes: tuple[str, ...]) -> dict[int, float]:
    """By number in `PHONEMES`: when after its onset the lips are nearest."""
    numbers = [PHONEMES.index(phoneme) for phoneme in phonemes]
    return {number: float(model.tightest_s[number]) for number in numbers}


class LiveSynthesizer(FinishedSynthesizer):
    """Our strategies over a revisable stream of phonemes."""

    def __init__(
        self,
        model: FaceModel,
        expectation: Expectation,
        style: Style | None = None,
        units: AnimPhoUnits | None = None,
    ) -> None:
        """units: AnimPhos to choose from; None: the expectation alone, whatever `unit_share` is."""
        style = style or Style()
        expected = ExpectedMotion(
            expectation, model.rest, lookahead_s=style.lookahead_s, smoothness=style.smoothness
        )
        super().__init__(
            model,
            expected,
            style.strength,
            adjust_inner={"smoothness": expected.adjust_smoothness},
            units=None if units is None else UnitMotion(units, expectation, expected.known_s),
            unit_share=style.unit_share,
        )
