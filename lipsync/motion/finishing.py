"""The finishing step of every motion: AnimPhos, strength, rest in pauses, and lips that must touch.

AnimPhos are recorded pieces of motion. The step is applied alike to live motion, the paper's method
and scripted lines (known speech with its motion), in this order, in one frame. A closure requires
that the inner lips come within a distance, for certain phonemes. The face is moved by the change
that is likeliest to go with such a change of the gap in the recordings (the conditional mean of a
Gaussian, Bishop, "Pattern Recognition and Machine Learning", 2006, eq. 2.81), and only as far as
needed.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.expectation.expectation import PhonemeTrack, context_at
from lipsync.face.frame import DRAWN_MOUTH, FaceWindow, Frame, Motion
from lipsync.face.model import FaceModel
from lipsync.motion.rounding import ROUNDED, SPREAD, is_due, lip_width_of, plan_shapes
from lipsync.motion.tick_plan import (
    AT_REST,
    TICK_S,
    Amount,
    EasedSetting,
    TickPlan,
    is_reached,
    plan_rest,
    values_at,
)
from lipsync.phonemes import PHONEMES, PhonemeEvent, PhonemeUpdate

if TYPE_CHECKING:
    from lipsync.motion.unit_motion import UnitMotion

#: Lips pressed together show this gap, mm. The bar is 1.0; the rest leaves room for the sampling
#: of a face between two ticks. Closer costs accuracy (docs/motion.md).
BILABIAL_GAP_MM = 0.7
#: Closer lips touch, in the recordings and where closures are counted.
TOUCHING_MM = 1.0
#: Added to the diagonal of the gap's covariance, as a share of its trace: keeps the inverse finite.
_RIDGE = 1e-6
#: Rounds the corner where the correction sets in, mm, so that the motion keeps its speed there.
_CORNER_MM = 0.2


@dataclass(frozen=True, slots=True)
class LipGap:
    """The vector from lower to upper inner lip, linear in the face, and the face's response to it.

    at_mean_mm: (3,), the vector of the mean face; per_face: (n_components, 3), its change per
    coefficient; response: (3, n_components), the change of the face that goes with a change of the
    vector by 1 mm.
    """

    at_mean_mm: Array
    per_face: Array
    response: Array

    def begin_to_touch(self, faces: Array) -> NDArray[np.bool_]:
        """Return for each face of a motion whether the lips touch in it but not in the face before.

        Parameters
        ----------
        faces : Array
            (n, n_components), in order of time.

        Returns
        -------
        NDArray[np.bool_]
            (n,), the first always False.
        """
        widths_mm = np.linalg.norm(self.at_mean_mm + faces @ self.per_face, axis=1)
        touches = widths_mm <= TOUCHING_MM
        # The first face has none before it and is compared with itself.
        return np.asarray(touches & ~np.insert(touches[:-1], 0, touches[0]))

    def shut(self, face: Array) -> Array:
        """Return the face with its lips pressed together, at most 0.7 mm apart.

        Parameters
        ----------
        face : Array
            (n_components,) coefficients.

        Returns
        -------
        Array
            (n_components,) coefficients.
        """
        return self.narrowed(face, BILABIAL_GAP_MM, 1.0)

    def narrowed(self, face: Array, distance_mm: float, amount: float) -> Array:
        """Return the face with its lip gap brought to at most `distance_mm`.

        The result depends on face, distance and amount without a jump in value or speed.

        Parameters
        ----------
        face : Array
            (n_components,) coefficients.
        distance_mm : float
            Largest distance between the lips.
        amount : float
            Share of the excess that is removed: 0 leaves the face unchanged, 1 removes all.

        Returns
        -------
        Array
            (n_components,) coefficients.
        """
        if amount <= 0.0:
            return face
        gap_mm = self.at_mean_mm + face @ self.per_face
        width_mm = math.sqrt(float(gap_mm @ gap_mm))
        excess_mm = width_mm - distance_mm + _CORNER_MM
        # The excess, or 0 where there is none, with the corner between both rounded by a hyperbola.
        soft_mm = (excess_mm + math.sqrt(excess_mm**2 + _CORNER_MM**2)) / 2.0
        # The gap's vector becomes shorter by this share of it, and the face follows.
        share = min(amount, 1.0) * soft_mm / math.sqrt(width_mm**2 + _CORNER_MM**2)
        return np.asarray(face - (share * gap_mm) @ self.response)


def lip_gap_of(model: FaceModel) -> LipGap:
    """Return the lip gap of a model's face, with the response by its recordings' covariance.

    The response is Cov(gap)^-1 Cov(gap, face), the conditional mean of the face given the gap.
    """
    basis = model.basis.reshape(model.n_components, -1, 3)
    upper, lower = model.layout.upper_lip, model.layout.lower_lip
    per_face = basis[:, upper] - basis[:, lower]
    face_gap_covariance = model.covariance @ per_face
    gap_covariance = per_face.T @ face_gap_covariance
    ridge = _RIDGE * np.trace(gap_covariance) * np.eye(3)
    response = np.linalg.solve(gap_covariance + ridge, face_gap_covariance.T)
    at_mean_mm = model.mean_mm[upper] - model.mean_mm[lower] - model.lips_touching_mm
    return LipGap(at_mean_mm, per_face, response)


#: Lips shut, and lower lip at the upper teeth.
BILABIALS = ("P", "B", "M")
LABIODENTALS = ("F", "V")

#: Lips take this long to close, and to part: 12 mm at 300 mm/s at most. Chosen on inner splits of
#: the training part: shorter jumps, longer closes the vowels around as well
#: (docs/decisions/closures.md).
CLOSING_S = 0.06
PARTING_S = 0.06
#: They touch this long at least, around the moment at which the recordings are tightest.
HOLD_S = 0.02
#: While an M sounds the lips stay shut, from its onset until they must part for what follows.
_HUMMED = PHONEMES.index("M")
_SHUT: Final = frozenset(map(PHONEMES.index, BILABIALS))
_VOWELS: Final = frozenset(n for n, phoneme in enumerate(PHONEMES) if phoneme[0] in "AEIOU")
_HUM_ENDS_S = 0.03
#: Sums of the same times differ by less.
_ROUNDING_S = 1e-9


OPEN = Amount(0.0, PARTING_S, 0.0, 0.0, 0.0)


def plan_closure(
    now: Amount,
    tightest_s: Mapping[int, float],
    track: PhonemeTrack,
    time_s: float,
    known_until_s: float,
) -> Amount:
    """Return the plan for a lip closure, an amount from 0 (open) to 1 (closed), from `time_s` on.

    now: the plan so far, returned if its goal is unchanged, with a new time of the last touch while
    the lips are held closed. A closure that has begun is completed first. tightest_s: by the index
    of each closing phoneme (P B M, or F V), seconds from its onset until the lips are nearest.
    track: the phonemes, known until the sound time `known_until_s`.
    """
    if now.goal == 1.0 and time_s < now.start_s + now.duration_s:
        return now
    # Closing begins so much earlier that the lips touch when a closure's span begins.
    if any(
        from_s - CLOSING_S <= time_s + _ROUNDING_S and time_s < until_s - _ROUNDING_S
        for from_s, until_s in closures(now.touched_s, tightest_s, track, time_s, known_until_s)
    ):
        goal, duration_s, touched_s = 1.0, CLOSING_S, time_s + CLOSING_S
    else:
        goal, duration_s, touched_s = 0.0, PARTING_S, now.touched_s
    if goal == now.goal:
        return replace(now, touched_s=time_s) if goal == 1.0 else now
    return Amount(time_s, duration_s, *now.at(time_s), goal, touched_s)


def closures(
    touched_s: float,
    tightest_s: Mapping[int, float],
    track: PhonemeTrack,
    time_s: float,
    known_until_s: float,
) -> Iterator[tuple[float, float]]:
    """Yield (from, until), sound times in s between which lips touch, for each closing phoneme.

    These are the phonemes of `tightest_s` around or after `time_s`: by their index (P B M, or F V),
    seconds from the onset until the lips are nearest. touched_s: sound time at which the lips
    touched last. track: the phonemes, known until `known_until_s`. A phoneme for which the lips
    have not touched yet keeps them closed until its end.
    """
    # From the phone before the present one on: its lips may be nearest only after its end.
    first = bisect_right(track.starts_s, time_s) - 2
    for i in range(max(0, first), len(track.phonemes)):
        start_s, end_s = track.starts_s[i], track.ends_s[i]
        if end_s > known_until_s + _ROUNDING_S:
            end_s = math.inf  # not known yet
        if start_s > known_until_s + _ROUNDING_S:
            return
        if track.phonemes[i] in tightest_s:
            moment_s = start_s + tightest_s[track.phonemes[i]]
            if track.phonemes[i] in _SHUT or track.phonemes[max(0, i - 1)] not in _VOWELS:
                # A short one is tightest in its middle, but F and V after a vowel towards the end.
                moment_s = min(moment_s, (start_s + end_s) / 2.0)
            from_s, until_s = moment_s - HOLD_S / 2.0, moment_s + HOLD_S / 2.0
            # Lips stay shut while an M sounds, until they must part for the next phone.
            if track.phonemes[i] == _HUMMED:
                from_s = min(from_s, start_s + HOLD_S)
                until_s = max(until_s, min(end_s, known_until_s) - _HUM_ENDS_S)
            if touched_s < start_s - HOLD_S:
                until_s = max(until_s, end_s)  # known late: close late, while the phone lasts
            yield from_s, until_s


def closed_share(spans_s: Sequence[tuple[float, float]], time_s: float) -> float:
    """Return how far lips are expected to be closed at `time_s`, 0 to 1.

    spans_s: (from, until) of closures; 1 within any of them, 0 at 60 ms and more from all.
    """
    share = 0.0
    for from_s, until_s in spans_s:
        # In units of the closing and parting times: 0 inside a closure, 1 and more far from it.
        distance = max((from_s - time_s) / CLOSING_S, (time_s - until_s) / PARTING_S, 0.0)
        share = max(share, 1.0 - min(distance, 1.0))
    return share * share * (3.0 - 2.0 * share)


DEFAULT_LOOKAHEAD_S = 0.1
LONGEST_LOOKAHEAD_S = 1.0
STRONGEST = 1.5
DEFAULT_UNIT_SHARE = 1.0


#: On a stage, which viewers see from 3 m, a mouth goes so much farther than the speaker's.
STAGE_STRENGTH = 1.3

#: A window shows the face so long after its frame, and where a closure is complete. Finer steps
#: change no plan of joints by more than their noise (docs/decisions/closures.md).
_WINDOW_S: Final = (0.05, 0.1, 0.15, 0.2)


class StyleError(UserError):
    """Error for a setting of the motion's style that is unknown or outside its limits."""


@dataclass(frozen=True, slots=True)
class Style:
    """The settings of the motion that the user may change. Raises StyleError beyond their limits.

    lookahead_s: how much later than its sound a face may be shown, so that what follows is known;
    strength: 0 keeps the mouth closed, 1 moves as the recorded speaker did, 1.5 is the most;
    smoothness: 0 follows at once, 1 is the slowest. unit_share: share of AnimPhos in the motion,
    where a synthesiser has any: 0 plays the expectation, 1 AnimPhos alone. stage: 1 opens and
    rounds the mouth for viewers at 3 m, 0 does not.
    """

    lookahead_s: float = DEFAULT_LOOKAHEAD_S
    strength: float = 1.0
    smoothness: float = 0.0
    unit_share: float = DEFAULT_UNIT_SHARE
    stage: float = 0.0

    def __post_init__(self) -> None:
        """Raise StyleError for a setting that is negative, above its limit, or NaN."""
        limits = {
            "lookahead_s": LONGEST_LOOKAHEAD_S,
            "strength": STRONGEST,
            "smoothness": 1.0,
            "unit_share": 1.0,
            "stage": 1.0,
        }
        for name, most in limits.items():
            value = getattr(self, name)
            if not 0.0 <= value <= most:
                raise StyleError(f"{name} is {value}; allowed: 0 to {most}")


#: More look-ahead than this is allowed but not used: the model has learned no more.
USED_LOOKAHEAD_S = 0.2


class TrackedSynthesizer(Motion, Protocol):
    """A synthesiser that the finishing step can wrap: a `Motion` that exposes its phonemes."""

    @property
    def track(self) -> PhonemeTrack:
        """The phonemes as they are known now, joined end to end."""

    def faces_after(self, frame: Frame, times_s: Array) -> Array:
        """Return the faces expected at times after the newest frame, by the phonemes known.

        Parameters
        ----------
        frame : Frame
            The newest frame.
        times_s : Array
            (k,) sound times.

        Returns
        -------
        Array
            (k, n_components) coefficients.
        """


@dataclass(frozen=True, slots=True)
class _Finish:
    """The plans decided for one tick, 10 ms: rest, closed lips, lip at the teeth, and `SPREAD`'s.

    is_still: whether the mouth is at rest in this tick, and nothing is known that ends the pause.
    """

    rest: Amount = AT_REST
    bilabial: Amount = OPEN
    labiodental: Amount = OPEN
    shapes: tuple[Amount, ...] = SPREAD
    is_still: bool = False


class FinishedSynthesizer:
    """A synthesiser with the finishing step: AnimPhos, strength, rest in pauses, lip closures."""

    def __init__(
        self,
        model: FaceModel,
        inner: TrackedSynthesizer,
        strength: float = 1.0,
        *,
        known_s: float | None = None,
        adjust_inner: Mapping[str, Callable[[float], None]] | None = None,
        units: "UnitMotion | None" = None,
        unit_share: float = DEFAULT_UNIT_SHARE,
        stage: float = 0.0,
    ) -> None:
        """Wrap the synthesiser `inner`. `strength`: 0 keeps the mouth at rest, 1 changes nothing.

        known_s: how many seconds of sound beyond its tick a decision may use; None for what the
        look-ahead of `inner` allows. adjust_inner: functions that set the settings of `inner`, by
        the setting's name. units: motion of recorded pieces (AnimPhos) to mix in, None for none;
        unit_share: 0 leaves them out, 1 shows them alone. stage: as in `Style`.
        """
        self._inner = inner
        self._known_s = min(inner.lookahead_s, USED_LOOKAHEAD_S) if known_s is None else known_s
        self._rest = model.rest
        self._gap = lip_gap_of(model)
        self._width = lip_width_of(model)
        self._labiodental_gap_mm = model.labiodental_gap_mm
        self._bilabial_s = _tightest_s(model, BILABIALS)
        self._labiodental_s = _tightest_s(model, LABIODENTALS)
        self._unit_motion = units
        self._strength = EasedSetting(strength, STRONGEST)
        self._unit_share = EasedSetting(unit_share, 1.0)
        self._stage = EasedSetting(stage, 1.0)
        self._valence = EasedSetting(0.0, 1.0, -1.0)
        self._style = (self._strength, self._stage, self._valence)
        self._ticks = TickPlan(_Finish())
        self._still = self._still_window()
        self._adjusters = {
            **(adjust_inner or {}),
            "strength": self._change_of(self._strength),
            "stage": self._change_of(self._stage),
        }
        if units is not None:
            self._adjusters["unit_share"] = self._change_of(self._unit_share)

    @property
    def is_resting(self) -> bool:
        """Whether the mouth is at rest, or moving to rest, because of silence."""
        return self._ticks.newest.rest.goal == 1.0

    @property
    def strength(self) -> float:
        """The strength that was set last, 0 to 1.5; the motion may still be easing to it."""
        return self._strength.goal

    @property
    def adjustable(self) -> Set[str]:
        """Names of the settings that may change while the mouth moves."""
        return self._adjusters.keys()

    @property
    def phonemes_planned(self) -> int:
        """The number of phonemes that have moved the mouth since the last `reset`."""
        return self._inner.phonemes_planned

    @property
    def lookahead_s(self) -> float:
        """Seconds of sound needed after an instant before its frame can be computed."""
        return self._inner.lookahead_s

    def reset(self) -> None:
        """Forget all but the settings; the mouth is closed and sound time begins at 0."""
        self._inner.reset()
        if self._unit_motion is not None:
            self._unit_motion.reset()
        for setting in (*self._style, self._unit_share):
            setting.settle()
        self._ticks = TickPlan(_Finish())

    def push(self, update: PhonemeUpdate) -> None:
        """Apply a revision to the known phonemes; frames already computed are not changed."""
        self._inner.push(update)

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """Return the phoneme at sound time `time_s` as known now, for displays; None if unknown."""
        return self._inner.event_at(time_s)

    def adjust(self, name: str, value: float) -> None:
        """Set the setting `name` to `value` from the newest face on, eased in over 0.3 s.

        Faces already shown are not changed. Raises StyleError for a setting that cannot be
        adjusted, or a value beyond its limits.
        """
        if name not in self._adjusters:
            raise StyleError(f"{name} cannot be adjusted; {', '.join(sorted(self._adjusters))} can")
        Style(**{name: value})
        self._adjusters[name](value)

    def smile(self, valence: float) -> None:
        """Set the smile of the speaking mouth from the newest face on: -1 (sad) to 1 (glad)."""
        self._change_of(self._valence)(valence)

    def frame_at(self, time_s: float) -> Frame:
        """Return the finished frame at sound time `time_s`; equal times give equal frames.

        The step's parts in order: recorded pieces (AnimPhos), strength, mouth corners, rest,
        closures.
        """
        frame = self._inner.frame_at(time_s)
        units = self._unit_motion
        offset = None if units is None else units.at(time_s, self._inner.track)
        # The plans of this tick; None for a time too long ago.
        finish = self._ticks.at(time_s, self._decide_tick)
        if finish is not None and finish.is_still:
            return replace(frame, coefficients=self._rest)
        face = frame.coefficients
        if offset is not None:
            face = face + self._unit_share.at(time_s) * offset
        strength, stage, valence = values_at(self._style, time_s)
        face = self._strengthened(face, strength, stage)
        if finish is not None:
            rounding, dental, alveolar = [each.share(time_s) for each in finish.shapes]
            if stage or valence:
                face = self._cornered(face, strength, stage * rounding, (1.0 - rounding) * valence)
            face = self._rest + (1.0 - finish.rest.smooth(time_s)) * (face - self._rest)
            labiodental, bilabial = finish.labiodental.share(time_s), finish.bilabial.share(time_s)
            face = self._gap.narrowed(face, self._labiodental_gap_mm, labiodental)
            face = self._gap.narrowed(face, BILABIAL_GAP_MM, bilabial)
            most = min(1.0, strength)
            # Lips that touch each other or the teeth hide the tongue.
            raised = most * (1.0 - max(bilabial, labiodental))
            lip_tuck = most * min(labiodental, 1.0 - bilabial)
            shares = lip_tuck, raised * dental, raised * alveolar
            if any(shares):
                drawn = zip(DRAWN_MOUTH, (share or None for share in shares), strict=True)
                expression = replace(frame.expression, **dict(drawn))
                return replace(frame, coefficients=face, expression=expression)
        return replace(frame, coefficients=face)

    def window_after(self, frame: Frame) -> FaceWindow:
        """Return `frame` and the faces expected after it by the phonemes known.

        `frame` must be the newest. The call changes no later frame.
        """
        now_s, finish = frame.time_s, self._ticks.newest
        if finish.is_still:
            return self._still
        until_s = now_s + self._known_s
        track, lips, teeth = self._inner.track, finish.bilabial, finish.labiodental
        # Of both kinds of closure: the gap that it requires, and the spans in which lips touch.
        closing = [
            (gap_mm, list(closures(amount.touched_s, tightest_s, track, now_s, until_s)))
            for amount, tightest_s, gap_mm in (
                (teeth, self._labiodental_s, self._labiodental_gap_mm),
                (lips, self._bilabial_s, BILABIAL_GAP_MM),
            )
        ]
        begins_s = {from_s for _, spans_s in closing for from_s, _ in spans_s}
        steps_s = (now_s + step_s for step_s in _WINDOW_S if step_s <= self._known_s)
        times_s = sorted({*steps_s, *(s for s in begins_s if now_s < s <= until_s)})
        # At the steps of the window, and where closures are complete.
        faces = self._inner.faces_after(frame, np.array(times_s)) if times_s else ()
        # The frame itself is finished already; later faces are finished as `frame_at` does.
        rows, closed = [frame.coefficients], [max(lips.at(now_s)[0], teeth.at(now_s)[0]) == 1.0]
        for time_s, face in zip(times_s, faces, strict=True):
            strength, stage, valence = values_at(self._style, time_s)
            face = self._strengthened(face, strength, stage)
            if stage or valence:
                rounding = float(is_due(ROUNDED, track, time_s, until_s))
                face = self._cornered(face, strength, stage * rounding, (1.0 - rounding) * valence)
            face = self._rest + (1.0 - finish.rest.smooth(time_s)) * (face - self._rest)
            shares = [closed_share(spans_s, time_s) for _, spans_s in closing]
            for (gap_mm, _), share in zip(closing, shares, strict=True):
                face = self._gap.narrowed(face, gap_mm, share)
            rows.append(face)
            closed.append(max(shares) == 1.0)
        offsets_s = np.array([now_s, *times_s]) - now_s
        shut = self._gap.shut(frame.coefficients)
        return FaceWindow(offsets_s, np.array(rows), np.array(closed), shut)

    def _still_window(self) -> FaceWindow:
        """Return the window (the faces to come) of a mouth that is at rest and stays so."""
        steps_s = [0.0, *(step_s for step_s in _WINDOW_S if step_s <= self._known_s)]
        faces = np.array([self._rest] * len(steps_s))
        open_ = np.zeros(len(steps_s), dtype=np.bool_)
        return FaceWindow(np.array(steps_s), faces, open_, self._gap.shut(self._rest))

    def _strengthened(self, face: Array, strength: float, stage: float) -> Array:
        """Return the face (n_components,) scaled about rest by `strength`, 1.3 times at stage 1."""
        strength *= 1.0 + (STAGE_STRENGTH - 1.0) * stage
        return face if strength == 1.0 else self._rest + strength * (face - self._rest)

    def _cornered(self, face: Array, strength: float, rounding: float, smile: float) -> Array:
        """Return the face (n_components,) with its mouth's corners moved.

        strength: below 1, moves them less. rounding: 0 to 1 moves them together; smile: -1
        (together) to 1 (apart). The face itself is returned for a model without points of the lips.
        """
        if self._width is None:
            return face
        moved = min(1.0, strength)
        return self._width.smiling(self._width.rounded(face, moved * rounding), moved * smile)

    def _decide_tick(self, time_s: float, last: _Finish) -> _Finish:
        """Return the plans for the tick of 10 ms that ends at `time_s`, from what is known then.

        last: the plans of the tick before.
        """
        track, begin_s, until_s = self._inner.track, time_s - TICK_S, time_s + self._known_s
        rest = plan_rest(last.rest, *context_at(track, time_s, until_s), begin_s, self._known_s)
        plans = last.bilabial, last.labiodental, *last.shapes
        if is_reached(rest, begin_s) and not any(
            plan.goal or plan.at(begin_s)[0] for plan in plans
        ):
            return last if last.is_still else replace(last, rest=rest, is_still=True)
        return _Finish(
            rest,
            plan_closure(last.bilabial, self._bilabial_s, track, begin_s, until_s),
            plan_closure(last.labiodental, self._labiodental_s, track, begin_s, until_s),
            plan_shapes(last.shapes, track, begin_s, self._known_s + TICK_S),
        )

    def _change_of(self, setting: EasedSetting) -> Callable[[float], None]:
        """Return a function that eases `setting` to a value, from the newest tick on."""
        return lambda value: setting.change(self._ticks.decided_until_s, value)


def _tightest_s(model: FaceModel, phonemes: tuple[str, ...]) -> dict[int, float]:
    """Return, by index of each of `phonemes`, s from its onset until the lips are nearest."""
    numbers = [PHONEMES.index(phoneme) for phoneme in phonemes]
    return {number: float(model.tightest_s[number]) for number in numbers}
