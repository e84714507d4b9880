"""Face motion by AnimPhos (recorded pieces of motion, Wei and Deng), near the expected face.

The expected face is that of the expectation: the predicted mean motion for decided phonemes. An
AnimPho is chosen at its phone's onset and again whenever the phonemes around it are revised or
become known; every 40 ms its rest is planned anew. Each time the rest of the phone begins at the
mouth's present position and speed. Departures from the paper's equations: an AnimPho is chosen by
the expected face too, and moved .7 of the way to it; a_t is reached 20 ms after the phone's onset,
not at its end (docs/decisions/animphos.md); and the AnimPho's offset from the face that was
expected at planning is added to the face expected now, so that no plan is older than a tick.
"""

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Final

import numpy as np

from lipsync.animpho.selection import MOVED_SHARE, Choice, GuidedSelection, Joint
from lipsync.animpho.trajectory import (
    Trajectory,
    blend,
    choose_connected,
    ease,
    remainder_weights,
    sample_derivatives,
    translate,
)
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO
from lipsync.arrays import Array
from lipsync.expectation.expectation import UNKNOWN, PhonemeTrack, context_at, track_of
from lipsync.motion.tick_plan import PAUSE_S, RESTING_S, TICK_S, TickPlan
from lipsync.phonemes import PHONEMES, SILENCE, stand_in

#: How long phones last, ms: medians of grid_s1, of sentences and words that no benchmark scores; of
#: those that it lacks as of their likes.
_USUAL_MS: Final = {
    "W": 30, "DH": 30, "AH": 40, "AE": 40, "R": 40, "L": 50, "T": 50, "HH": 50, "IH": 60, "D": 60,
    "UH": 60, "TH": 70, "B": 70, "N": 70, "OW": 70, "V": 70, "NG": 70, "K": 80, "EH": 80, "M": 80,
    "CH": 90, "Y": 90, "JH": 90, "IY": 90, "AY": 90, "G": 100, "AO": 100, "P": 100, "ZH": 100,
    "ER": 100, "UW": 110, "EY": 110, "F": 120, "S": 120, "SH": 120, "AA": 130, "Z": 150, "OY": 200,
    "AW": 220, SILENCE: 80,
}  # fmt: skip
_USUAL_S: Final = [_USUAL_MS[phoneme] / 1e3 for phoneme in PHONEMES]
#: The last two phones took at most so many times as long as usual, or as short; of that pace, in
#: logarithms, half is believed of the next.
_MOST_PACE: Final = 2.0
#: An end that is not known lies at least a recorded frame after the time that is known.
LONGER_S = 0.04
#: Of a longer phone an AnimPho fills this much, up to its end.
LONGEST_S = 0.35
_SILENCE: Final = PHONEMES.index(SILENCE)


@dataclass(frozen=True, slots=True)
class PhoneSpan:
    """The time of a phone, or of one of several phones that stand in for it one after the other.

    phoneme: one with recorded units; None for a pause, in which the mouth rests. onset_s:
    start of the whole phone, in sound time; start_s, end_s: the part that the unit fills.
    is_known: whether the end of the phone is known; False: it is guessed.
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
    """Return the span of the phone at `time_s`, or of the phone that stands in for it at that time.

    context: what `context_at` returns for `time_s`, with phonemes known for `known_s` seconds more;
    an end that is not known is guessed. known_phonemes: those with recorded pieces of motion;
    others are replaced by stand-ins. The phoneme of a pause is None.
    """
    phonemes, times_s = context
    phoneme = PHONEMES[phonemes[2]]
    onset_s, is_known = time_s - times_s[2], not math.isnan(times_s[3])
    is_pause = times_s[2] > PAUSE_S and not is_known
    if phoneme == SILENCE and (is_pause or SILENCE not in known_phonemes):
        return PhoneSpan(None, onset_s, onset_s, math.inf, is_known)
    end_s = time_s + times_s[3]
    if not is_known:
        end_s = max(onset_s + guessed_s(phonemes, times_s), time_s + known_s + LONGER_S)
    parts, part, start_s = stand_in(phoneme, known_phonemes), 0, onset_s
    # Several stand-ins share the phone's time evenly: which of them plays at `time_s`?
    if len(parts) > 1:
        part_s = (end_s - onset_s) / len(parts)
        part = min(len(parts) - 1, int((time_s - onset_s) / part_s))
        start_s += part * part_s
        end_s = start_s + part_s
    return PhoneSpan(parts[part], onset_s, max(start_s, end_s - LONGEST_S), end_s, is_known)


def guessed_s(phonemes: list[int], times_s: list[float]) -> float:
    """Return the probable duration in s of the present phone, at the speaker's pace.

    phonemes, times_s: what `context_at` returns, first of the phone before last, the last and the
    present one: their indices, and how many seconds ago they began. The pace is the duration of the
    two phones before over their usual one, 1/2 to 2; in logarithms half of it is believed.
    """
    usual_s = elapsed_s = 0.0
    for phoneme, begun_s, next_begun_s in zip(phonemes[:2], times_s[:2], times_s[1:3], strict=True):
        if phoneme not in (UNKNOWN, _SILENCE) and math.isfinite(begun_s):
            usual_s += _USUAL_S[phoneme]
            elapsed_s += begun_s - next_begun_s
    pace = elapsed_s / usual_s if usual_s else 1.0
    pace = min(_MOST_PACE, max(1.0 / _MOST_PACE, pace))
    return _USUAL_S[phonemes[2]] * math.sqrt(pace)


#: Time in which the motion becomes the AnimPho, s, or all that is left of the phone if that is
#: shorter. A shorter rest of a phone than `_SHORTEST_S` is begun as if it were as long.
JOINED_S = 0.02
_SHORTEST_S = 0.04
#: What is left of an AnimPho is planned anew so often: then more is known of what is expected.
REPLANNED_S = 0.04
#: The expected face is asked for at these shares of what is left of a phone; `_BETWEEN` makes five
#: samples of the three, by straight lines.
_TARGETS = np.array([0.0, 0.5, 1.0])
_BETWEEN = np.array([[1, 0, 0], [0.5, 0.5, 0], [0, 1, 0], [0, 0.5, 0.5], [0, 0, 1]])
#: Sums of the same times differ by less.
_ROUNDING_S = 1e-9
#: The expectation at a phone's end is asked for so much before: there it is still that phone's.
_BEFORE_THE_END_S = 1e-6


@dataclass(frozen=True, slots=True)
class _Stretch:
    """A planned trajectory of offsets from the expected face, played until it is replanned.

    known: what it was planned from, namely the phoneme, its end if known, and the phonemes around.
    phoneme: None at rest; begun_s: when the first stretch of its phone began. chosen, previous: the
    phone's AnimPho (recorded piece of motion) a_t, and a_{t-1} before it; None at rest.
    """

    trajectory: Trajectory
    known: Hashable
    phoneme: str | None
    begun_s: float
    chosen: Choice | None
    previous: Choice | None


class UnitMotion:
    """Planner of the offset of AnimPhos (recorded pieces of motion) from the expected face."""

    def __init__(
        self,
        selection: GuidedSelection,
        expected: Callable[[Array, float], Array],
        known_s: float,
    ) -> None:
        """Create the motion of the recorded pieces that `selection` chooses.

        expected(times_s, until_s): returns the faces (n, n_components) expected at times (n,) in s
        from the phonemes until `until_s`. known_s: seconds beyond its tick that a decision may use.
        """
        self._units = selection.units
        self._known_phonemes = selection.units.known_phonemes
        self._selection = selection
        self._expected_faces = expected
        self._known_s = known_s
        self.reset()

    def reset(self) -> None:
        """Forget all phonemes and plans: the offset is 0, a new stream begins at sound time 0."""
        none = np.zeros_like(self._units.rest)
        still = ease(0.0, RESTING_S, none, none, none)
        self._ticks = TickPlan(_Stretch(still, None, None, -math.inf, None, None))
        self._track = track_of(())

    def at(self, time_s: float, track: PhonemeTrack) -> Array | None:
        """Return the offset of the recorded pieces' face from the face expected from phonemes.

        Parameters
        ----------
        time_s : float
            Sound time.
        track : PhonemeTrack
            The phonemes known now, with their times.

        Returns
        -------
        Array | None
            (n_components,); None for a time before the newest 64 ticks.
        """
        self._track = track
        stretch = self._ticks.at(time_s, self._decide_tick)
        return None if stretch is None else stretch.trajectory.at(time_s)[0]

    def _decide_tick(self, time_s: float, last: _Stretch) -> _Stretch:
        """Return the stretch of motion for the tick that ends at `time_s`, from what is known then.

        The stretch `last` of the tick before is returned while it still applies. The whole tick
        belongs to the phone at its end.
        """
        context = context_at(self._track, time_s, time_s + self._known_s)
        span = span_at(context, time_s, self._known_s, self._known_phonemes)
        # A guess of the end moves on with the time and is no news.
        end_s = round(span.end_s, 6) if span.is_known else None
        known = (span.phoneme, end_s, *context[0])
        # The last stretch stays while nothing new is known, its phone lasts, and it is fresh.
        goes_on = span.onset_s <= last.begun_s and time_s <= last.trajectory.end_s
        is_fresh = time_s <= last.trajectory.start_s + REPLANNED_S + _ROUNDING_S
        if known == last.known and (span.phoneme is None or (goes_on and is_fresh)):
            return last
        begin_s = time_s - TICK_S
        if span.phoneme is None:
            offset, speed = last.trajectory.at(begin_s)
            rest = ease(begin_s, RESTING_S, offset, speed, np.zeros_like(offset))
            return _Stretch(rest, known, None, begin_s, None, None)
        # A new phone begins after the last AnimPho; else the same phone goes on.
        previous, begun_s = last.chosen, time_s
        if span.phoneme == last.phoneme and span.onset_s <= last.begun_s:
            previous, begun_s = last.previous, last.begun_s
        # Where nothing new is known what is left of a_t is planned anew, and a_t stays.
        kept = last.chosen if known == last.known and goes_on else None
        chosen, trajectory = self._choose_and_join(span, begin_s, last.trajectory, previous, kept)
        return _Stretch(trajectory, known, span.phoneme, begun_s, chosen, previous)

    def _choose_and_join(
        self,
        span: PhoneSpan,
        begin_s: float,
        last: Trajectory,
        previous: Choice | None,
        kept: Choice | None,
    ) -> tuple[Choice, Trajectory]:
        """Return the AnimPho (recorded piece) for the rest of a phone, and its offsets.

        The offsets are from the expected face, from `begin_s` on. As in Wei and Deng, eqs. (3) to
        (5), the mouth begins at its present position and becomes the AnimPho, here moved part of
        the way to the mean of the expected faces. last: the trajectory of offsets that is left at
        `begin_s`. previous: the AnimPho before, a_{t-1}; kept: the AnimPho to go on with, a_t, None
        to choose one.
        """
        assert span.phoneme is not None
        phone_s = max(span.end_s, begin_s + _SHORTEST_S) - span.start_s
        passed_share = max(0.0, (begin_s - span.start_s) / phone_s)
        left_s = (1.0 - passed_share) * phone_s
        spacing_s = left_s / (SAMPLES_PER_ANIMPHO - 1)
        times_s = np.minimum(begin_s + left_s * _TARGETS, span.end_s - _BEFORE_THE_END_S)
        # The expected faces at five even times of what is left.
        target = _BETWEEN @ self._expected_faces(times_s, begin_s + TICK_S + self._known_s)
        offset, speed = last.at(begin_s)
        position = target[0] + offset
        # left: the weights that resample the rest of an AnimPho to five samples.
        units, left = self._units, remainder_weights(passed_share)
        chosen = kept
        if chosen is None:
            velocity = speed + (target[1] - target[0]) / spacing_s
            joint = Joint(passed_share, position, velocity, spacing_s, previous)
            chosen = self._selection.choose(span.phoneme, target, joint)
        connected = chosen.animpho
        if kept is None and previous is not None:
            connected = choose_connected(units, previous.animpho, connected)
        # a_t, moved towards the expected faces; the motion reaches it after 20 ms.
        moved = left @ units.samples[chosen.animpho]
        moved += MOVED_SHARE * (target - moved).mean(axis=0)
        joined = blend(
            translate(left @ units.samples[connected], position), moved, min(1.0, JOINED_S / left_s)
        )
        offsets = joined - target
        derivatives = sample_derivatives(offsets, speed * spacing_s)
        return chosen, Trajectory(begin_s, left_s, offsets, derivatives)
