"""The published live method, end to end: phonemes in, face coefficients at any time out.

A phoneme's motion is planned once, when its first instant is due, from a recorded piece of motion
(an AnimPho); frames already shown never change. The caller shows the face `longest_phone_s` after
the sound arrives, so that the end of every phoneme up to that length is known by then; a longer one
plays for that long and is then held.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from lipsync.animpho.selection import Choice, PrioritySelection, SelectionStrategy
from lipsync.animpho.trajectory import (
    Trajectory,
    blend,
    choose_connected,
    ease,
    sample_derivatives,
    translate,
)
from lipsync.animpho.units import AnimPhoUnits
from lipsync.arrays import Array
from lipsync.expectation.expectation import PhonemeTrack, track_of
from lipsync.face.frame import Frame
from lipsync.phonemes import SILENCE, PhonemeEvent, PhonemeUpdate, stand_in
from lipsync.timeline import PhonemeTimeline

#: Phones longer than this are held (architecture.md, Time).
LONGEST_PHONE_S = 0.35
#: A longer silence closes the mouth and ends the chain of AnimPhos.
PAUSE_S = 0.30
#: How long the lips take to close in a pause, or to settle in a held phone. The mouth of grid_s1
#: closes within this after the last phone of nine sentences in ten.
SETTLE_S = 0.25
#: What is left of a phoneme after a late revision is not worth an AnimPho below this.
_SHORTEST_PHONE_S = 0.02
#: Stretches of motion kept for times asked for again; a tick asks at most 50 ms back.
_KEPT = 16


@dataclass(frozen=True, slots=True)
class _Stretch:
    """One planned piece of motion, which another piece replaces at `until_s`.

    until_s: sound time; infinite while the mouth rests or is held: then the first known phoneme
    that starts after `after_s` ends the piece.
    """

    trajectory: Trajectory
    until_s: float
    after_s: float


class PublishedSynthesizer:
    """Wei and Deng's synthesis and blending over a revisable stream of phonemes.

    units: the AnimPhos, recorded pieces of motion; strategy: selects one per phoneme, None:
    PrioritySelection; longest_phone_s: a longer phoneme is held after this time, which is also the
    look-ahead. published_derivatives: keep eq. (5)'s derivative per sample spacing where two pieces
    join, so that the speed jumps when durations differ; by default the speed per second is
    continuous.
    """

    def __init__(
        self,
        units: AnimPhoUnits,
        strategy: SelectionStrategy | None = None,
        *,
        published_derivatives: bool = False,
        longest_phone_s: float = LONGEST_PHONE_S,
    ) -> None:
        """Create the synthesiser with a closed mouth; the parameters are those of the class."""
        self._units = units
        self._known_phonemes = units.known_phonemes
        self._strategy = strategy or PrioritySelection()
        self._published_derivatives = published_derivatives
        self.longest_phone_s = longest_phone_s
        self._track: PhonemeTrack | None = None
        self.reset()

    @property
    def lookahead_s(self) -> float:
        """Seconds of sound needed after an instant before its face can be computed."""
        return self.longest_phone_s

    @property
    def track(self) -> PhonemeTrack:
        """The phonemes known now, joined end to end; for synthesizers that wrap this one."""
        if self._track is None:
            self._track = track_of(self._timeline.events)
        return self._track

    def reset(self) -> None:
        """Forget all phonemes and motion: the mouth is closed, and sound time begins at 0."""
        rest = self._units.rest
        closed = ease(0.0, SETTLE_S, rest, np.zeros_like(rest), rest)
        self._timeline = PhonemeTimeline()
        self._track = None
        self._stretches = deque([_Stretch(closed, math.inf, -math.inf)], maxlen=_KEPT)
        self._choice: Choice | None = None
        self._shown_until_s = 0.0
        self.phonemes_planned = 0
        self.misses = 0

    def push(self, update: PhonemeUpdate) -> None:
        """Apply a revision to the known phonemes; motion already planned is not changed."""
        self._timeline.apply(update)
        self._track = None

    def frame_at(self, time_s: float) -> Frame:
        """Return the frame at sound time `time_s`; equal times give equal frames.

        Times may step back within the newest 16 pieces of motion: a few phonemes.
        """
        while (until_s := self._end_of_plan_s()) <= time_s:
            self._add_motion(until_s)
        self._shown_until_s = max(self._shown_until_s, time_s)
        for stretch in reversed(self._stretches):
            if stretch.trajectory.start_s <= time_s:
                return Frame(time_s, stretch.trajectory.at(time_s)[0])
        return Frame(time_s, self._units.rest)

    def faces_after(self, frame: Frame, times_s: Array) -> Array:
        """Return the face of `frame` for each later time: the published method plans no further.

        Parameters
        ----------
        frame : Frame
            The newest frame.
        times_s : Array
            (k,) later sound times in seconds; only their number is used.

        Returns
        -------
        Array
            (k, n_components), the frame's coefficients repeated.
        """
        return np.tile(frame.coefficients, (len(times_s), 1))

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """Return the phoneme at sound time `time_s` as known now, for displays; None if unknown."""
        return self._timeline.event_at(time_s)

    def _end_of_plan_s(self) -> float:
        """Return the sound time until which motion is planned: the start of the next motion.

        inf while the mouth rests or is held and no later phoneme is known.
        """
        newest = self._stretches[-1]
        if math.isfinite(newest.until_s):
            return newest.until_s
        # The mouth rests or is held: the first later phoneme known, but no time already shown.
        earliest_s = max(newest.trajectory.start_s, self._shown_until_s)
        for event in self._timeline.events_after(newest.after_s):
            if event.end_s is None or event.end_s > earliest_s:
                return max(event.start_s, earliest_s)
        return math.inf

    def _add_motion(self, start_s: float) -> None:
        """Append the motion from sound time `start_s` on, for the phoneme at that time.

        In a pause, or where no phoneme is known, the mouth closes; where less than 20 ms of the
        phoneme is left the mouth keeps its position; else AnimPhos, recorded pieces of motion, are
        played.
        """
        event = self._timeline.event_at(start_s)
        end_s = math.inf if event is None or event.end_s is None else event.end_s
        remaining_s = end_s - start_s
        is_pause = remaining_s > PAUSE_S or SILENCE not in self._known_phonemes
        if event is None or (event.phoneme == SILENCE and is_pause):
            self._choice = None
            self._hold(start_s, event, self._units.rest)
        elif remaining_s < _SHORTEST_PHONE_S:
            self._hold(start_s, event, self._state_at(start_s)[0])
        else:
            played_s = min(remaining_s, self.longest_phone_s)
            self._add_phone(event.phoneme, start_s, played_s)
            if played_s < remaining_s:
                self._hold(start_s + played_s, event, self._stretches[-1].trajectory.samples[-1])

    def _hold(self, start_s: float, event: PhonemeEvent | None, position: Array) -> None:
        """Append motion that eases to `position` and holds it until a phoneme starts after `event`.

        event: the phoneme in which the mouth rests; None: no phoneme is known at `start_s`.
        """
        after_s = -math.inf if event is None else event.start_s
        trajectory = ease(start_s, SETTLE_S, *self._state_at(start_s), position)
        self._stretches.append(_Stretch(trajectory, math.inf, after_s))

    def _add_phone(self, phoneme: str, start_s: float, duration_s: float) -> None:
        """Append the motion of a phoneme: an AnimPho (recorded piece) of it, `duration_s` long.

        A phoneme without AnimPhos is replaced by similar ones, which share its time evenly.
        """
        parts = stand_in(phoneme, self._known_phonemes)
        share_s = duration_s / len(parts)
        for number, part in enumerate(parts):
            self._add_animpho(part, start_s + number * share_s, share_s)

    def _add_animpho(self, phoneme: str, start_s: float, duration_s: float) -> None:
        """Append the motion of one AnimPho (recorded piece) of `phoneme`, `duration_s` long.

        The strategy selects the AnimPho to fit the last one; the motion begins at the mouth's
        present position.
        """
        position, velocity = self._state_at(start_s)
        if self._choice is None:
            # Out of silence b_1 = a_1 and d_1[1] = 0 (our choice; the paper does not say).
            chosen = self._strategy.first(self._units, phoneme)
            connected = chosen.animpho
        else:
            chosen = self._strategy.following(self._units, phoneme, self._choice)
            connected = choose_connected(self._units, self._choice.animpho, chosen.animpho)
        animphos = self._units.samples
        samples = blend(translate(animphos[connected], position), animphos[chosen.animpho])
        spacing_s = duration_s / (len(samples) - 1)
        # The slope per sample spacing at the first sample.
        first = velocity * spacing_s
        if self._published_derivatives:
            previous = self._stretches[-1].trajectory
            first = np.zeros_like(position) if self._choice is None else previous.derivatives[-1]
        trajectory = Trajectory(start_s, duration_s, samples, sample_derivatives(samples, first))
        self._stretches.append(_Stretch(trajectory, start_s + duration_s, start_s))
        self._choice = chosen
        self.phonemes_planned += 1
        self.misses += chosen.missed

    def _state_at(self, time_s: float) -> tuple[Array, Array]:
        """Return the newest motion's position and velocity per second at sound time `time_s`."""
        return self._stretches[-1].trajectory.at(time_s)
