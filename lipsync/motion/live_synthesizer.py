"""The live methods: whatever moves the mouth, and the finishing step that all of them share.

The finishing step mixes AnimPhos in, scales by the strength, rests in pauses and closes the lips
for P B M F V, in this order, in one frame. Live motion, the paper's method and scripted lines pass
it alike.
"""

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from lipsync.animpho.units import AnimPhoUnits
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.expectation.context import PhonemeTrack, context_at
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
from lipsync.motion.expected_motion import USED_LOOKAHEAD_S, ExpectedMotion
from lipsync.motion.tick_plan import AT_REST, TICK_S, Amount, EasedSetting, TickPlan, planned_rest
from lipsync.motion.unit_motion import UnitMotion
from lipsync.phonemes import PHONEMES, PhonemeEvent, PhonemeUpdate

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
_WINDOW_S: Final = (0.033, 0.066, 0.1, 0.15, 0.2)


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
