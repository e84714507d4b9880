"""AnimPhos near the expectation, joined as the paper joins, over a revisable stream of phonemes.

An AnimPho is chosen at its phone's onset and again whenever more becomes known of the phonemes
around; what is left of the phone then begins where the mouth is, at the speed that it has. Two
departures from the paper's equations, both for the sake of the expectation: an AnimPho is moved, as
a whole, to where the mouth is expected, and it is joined sooner than at the phone's end
(decisions/0028).
"""

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from lipsync.animpho.selection import GuidedSelection, Joint, SelectionCosts
from lipsync.animpho.trajectory import (
    Trajectory,
    blend,
    choose_connected,
    ease,
    remaining,
    sample_derivatives,
    translate,
)
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits
from lipsync.arrays import Array
from lipsync.expectation.expectation import PhonemeTrack, context_at, track_of
from lipsync.motion.tick_plan import PAUSE_S, RESTING_S, TICK_S, TickPlan
from lipsync.phonemes import PHONEMES, SILENCE, stand_in

#: A phone is taken to last so long, the median of grid_s1; where its end is later than is known,
#: a recorded frame longer than is known.
USUAL_S = 0.08
LONGER_S = 0.04
#: Of a longer phone an AnimPho fills this much, up to its end.
LONGEST_S = 0.35


@dataclass(frozen=True, slots=True)
class PhoneSpan:
    """A phone, or one of several that stand in for it one after the other.

    phoneme: one that the AnimPhos know; None for a pause, in which the mouth rests. onset_s: of the
    whole phone, in sound time; start_s, end_s: what the AnimPho fills. is_known: whether the end is
    the phone's own, and no guess.
    """

    phoneme: str | None
    onset_s: float
    start_s: float
    end_s: float
    is_known: bool


def span_at(
    context: tuple[list[int], list[float]],
    time_s: float,
    known_s: float,
    known_phonemes: frozenset[str],
) -> PhoneSpan:
    """What goes on at `time_s`; context: `context_at` it, known for `known_s` more."""
    phonemes, times_s = context
    phoneme = PHONEMES[phonemes[2]]
    onset_s, is_known = time_s - times_s[2], not math.isnan(times_s[3])
    is_pause = times_s[2] > PAUSE_S and not is_known
    if phoneme == SILENCE and (is_pause or SILENCE not in known_phonemes):
        return PhoneSpan(None, onset_s, onset_s, math.inf, is_known)
    end_s = time_s + times_s[3]
    if not is_known:
        end_s = max(onset_s + USUAL_S, time_s + known_s + LONGER_S)
    parts, number, start_s = stand_in(phoneme, known_phonemes), 0, onset_s
    if len(parts) > 1:
        part_s = (end_s - onset_s) / len(parts)
        number = min(len(parts) - 1, int((time_s - onset_s) / part_s))
        start_s += number * part_s
        end_s = start_s + part_s
    return PhoneSpan(parts[number], onset_s, max(start_s, end_s - LONGEST_S), end_s, is_known)


#: Of what is left of a phone it takes this long to become its AnimPho, s, or all of it where it is
#: shorter. A shorter rest of a phone than `_SHORTEST_S` is begun as if it were as long.
JOINED_S = 0.02
_SHORTEST_S = 0.04
#: What is left of an AnimPho is planned anew so often: then more is known of what is expected.
REPLANNED_S = 0.04
#: The expectation at a phone's end is asked for so much before: there it is still that phone's.
_BEFORE_THE_END_S = 1e-6


@dataclass(frozen=True, slots=True)
class _Stretch:
    """What is played until more becomes known.

    known: all that it was planned from. phoneme: None at rest; begun_s: when the first stretch of
    its phone began. animpho: a_t; previous: a_{t-1}; None at rest.
    """

    trajectory: Trajectory
    known: Hashable
    phoneme: str | None
    begun_s: float
    animpho: int | None
    previous: int | None


class UnitMotion:
    """Faces out of AnimPhos, at any time; who asks says what the phonemes are."""

    def __init__(
        self,
        units: AnimPhoUnits,
        expected: Callable[[Array, float], Array],
        known_s: float,
        costs: SelectionCosts | None = None,
    ) -> None:
        """expected: faces (n, n_components) at times (n,), by what is known until an instant.

        known_s: how far beyond its tick a decision may look, s.
        """
        self._units = units
        self._known_phonemes = units.known_phonemes
        self._selection = GuidedSelection(units, costs)
        self._expected = expected
        self._known_s = known_s
        self.reset()

    def reset(self) -> None:
        """Forget everything; the mouth is closed and the stream begins anew at sound time 0."""
        rest = self._units.rest
        closed = ease(0.0, RESTING_S, rest, np.zeros_like(rest), rest)
        self._ticks = TickPlan(_Stretch(closed, None, None, -math.inf, None, None))
        self._track = track_of(())

    def at(self, time_s: float, track: PhonemeTrack) -> Array | None:
        """The face (n_components,) with the phonemes as they are believed now.

        None for a time that is too long ago.
        """
        self._track = track
        stretch = self._ticks.at(time_s, self._decide)
        return None if stretch is None else stretch.trajectory.at(time_s)[0]

    def _decide(self, time_s: float, last: _Stretch) -> _Stretch:
        """What plays in the tick that ends at `time_s`, from what is known then.

        The whole tick belongs to the phone that goes on at its end.
        """
        context = context_at(self._track, time_s, time_s + self._known_s)
        span = span_at(context, time_s, self._known_s, self._known_phonemes)
        # A guess of the end moves on with the time and is no news.
        end_s = round(span.end_s, 6) if span.is_known else None
        known = (span.phoneme, end_s, *context[0])
        if known == last.known and (
            span.phoneme is None
            or (
                span.onset_s <= last.begun_s
                and time_s <= last.trajectory.end_s
                and time_s - TICK_S < last.trajectory.start_s + REPLANNED_S - 1e-9
            )
        ):
            return last
        begin_s = time_s - TICK_S
        position, speed = last.trajectory.at(begin_s)
        if span.phoneme is None:
            rest = ease(begin_s, RESTING_S, position, speed, self._units.rest)
            return _Stretch(rest, known, None, begin_s, None, None)
        previous, begun_s = last.animpho, time_s
        if span.phoneme == last.phoneme and span.onset_s <= last.begun_s:
            previous, begun_s = last.previous, last.begun_s
        end_s = max(span.end_s, begin_s + _SHORTEST_S)
        phone_s = end_s - span.start_s
        share = max(0.0, (begin_s - span.start_s) / phone_s)
        joint = Joint(share, position, speed, phone_s, previous)
        target = self._target(span, joint, time_s + self._known_s)
        chosen = self._selection.choose(span.phoneme, target, joint)
        trajectory = self._joined(chosen, target, joint, begin_s)
        return _Stretch(trajectory, known, span.phoneme, begun_s, chosen, previous)

    def _target(self, span: PhoneSpan, joint: Joint, known_until_s: float) -> Array:
        """(r, n_components): what is expected at the sample times to come, as far as known."""
        shares = np.arange(joint.n_passed, SAMPLES_PER_ANIMPHO) / (SAMPLES_PER_ANIMPHO - 1)
        times_s = np.minimum(span.start_s + shares * joint.phone_s, span.end_s - _BEFORE_THE_END_S)
        return self._expected(times_s, known_until_s)

    def _joined(self, chosen: int, target: Array, joint: Joint, begin_s: float) -> Trajectory:
        """From the mouth as it is to the end of the chosen AnimPho, moved to its target."""
        units = self._units
        connected = chosen
        if joint.previous is not None:
            connected = choose_connected(units, joint.previous, chosen)
        samples = units.samples[chosen]
        moved = samples + (target - samples[joint.n_passed :]).mean(axis=0)
        left_s = (1.0 - joint.share) * joint.phone_s
        joined = blend(
            translate(remaining(units.samples[connected], joint.share), joint.position),
            remaining(moved, joint.share),
            min(1.0, JOINED_S / left_s),
        )
        first = joint.speed * (left_s / (SAMPLES_PER_ANIMPHO - 1))
        return Trajectory(begin_s, left_s, joined, sample_derivatives(joined, first))
