"""The live methods: the expectation (predicted mean motion) with the finishing step around it.

Frame-synchronous: a phoneme moves the mouth from its onset, before its end is known, and a revision
by the recogniser changes only what has not been shown. Faces are decided on a grid of 10 ms, each
from what is known at its own time; between two of these the motion is a cubic, continuous in
position and speed whatever arrives.
"""

import logging
import math
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lipsync.arrays import Array
from lipsync.expectation.expectation import Expectation, PhonemeTrack, context_at, track_of
from lipsync.expectation.soft_expectation import FRAMES_PER_S, BelievedFrames, SoftExpectation
from lipsync.face.frame import Frame
from lipsync.face.model import FaceModel
from lipsync.motion.finishing import USED_LOOKAHEAD_S, FinishedSynthesizer, Style
from lipsync.motion.tick_plan import (
    AT_REST,
    TICK_S,
    Amount,
    EasedSetting,
    TickPlan,
    is_reached,
    plan_rest,
    tick_of,
)
from lipsync.phonemes import PHONEMES, PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline

if TYPE_CHECKING:
    from lipsync.animpho.selection import GuidedSelection

_LOG: Final = logging.getLogger(__name__)
#: Their names on the command line and in results: the expectation, and AnimPhos near it.
LIVE_STRATEGY = "expected"
UNIT_STRATEGY = "animpho"
#: Averages over what is not known move too little. A share of the last frame's step (25 Hz, as in
#: the recordings) is extrapolated; chosen on inner splits (docs/motion.md).
LEAD = 0.1
_LEAD_TICKS = 4
#: The recordings' 25 frames a second know of nothing quicker than 80 ms; a context does, it changes
#: from one tick to the next. So what is expected is averaged over so many ticks before and after,
#: as far as the look-ahead reaches.
_AVERAGED_TICKS = 1
#: After so many ticks at rest all that a tick is made of is the rest face.
_REMEMBERED_TICKS = _LEAD_TICKS + 2 * _AVERAGED_TICKS + 1
#: A look-ahead of whole ticks is a quotient of floats.
_ROUNDING_TICKS = 1e-6
#: The slowest that smoothness can make the mouth: its time constant, s.
_SLOWEST_S = 0.04


@dataclass(frozen=True, slots=True)
class _Tick:
    """The motion of a tick of 10 ms between two grid points: a cubic; speeds are per tick.

    start, end: faces (n_components,). rest: how far a pause has brought the mouth to rest.
    is_still: whether nothing moves in this tick, nor in the faces that were averaged for it.
    """

    start: Array
    start_speed: Array
    end: Array
    end_speed: Array
    rest: Amount
    is_still: bool = False

    def at(self, u: float) -> Array:
        """Return the face (n_components,) at the share u, 0 to 1, of the tick."""
        if self.is_still:
            return self.end
        face = (1.0 + 2.0 * u) * (1.0 - u) ** 2 * self.start + u**2 * (3.0 - 2.0 * u) * self.end
        face += u * (1.0 - u) ** 2 * self.start_speed + u**2 * (u - 1.0) * self.end_speed
        return face


class ExpectedMotion:
    """Motion by the expectation over a revisable stream of phonemes, before the finishing step.

    The expectation predicts the mouth's mean motion for decided phonemes. Lip closures, strength
    and AnimPhos (recorded pieces of motion) are left to `FinishedSynthesizer`.
    """

    def __init__(
        self,
        expectation: Expectation,
        rest: Array,
        *,
        lookahead_s: float,
        smoothness: float,
        soft: SoftExpectation | None = None,
    ) -> None:
        """Start at sound time 0 with a closed mouth.

        expectation: predicts the mean motion of decided phonemes. rest: (n_components,), the closed
        mouth. lookahead_s: seconds of sound that must be known after a frame. smoothness: 0 to 1,
        as in `Style`. soft: predicts the motion from the recogniser's probabilities of phonemes,
        and is blended in; None: decided phonemes alone move the mouth.
        """
        self._with_back_off = expectation
        self._without_back_off = replace(expectation, back_off=None)
        self._soft = soft
        self._rest = rest
        self._lookahead_s = lookahead_s
        self.known_s = min(lookahead_s, USED_LOOKAHEAD_S)
        # The mean of expected faces reaches one tick ahead, if the look-ahead does.
        n_ahead = min(_AVERAGED_TICKS, int(self.known_s / TICK_S + _ROUNDING_TICKS))
        self._averaged_ahead_s = n_ahead * TICK_S
        self._weights = _bell(2 * n_ahead + 1)
        self._smoothness = EasedSetting(smoothness, 1.0)
        self._has_warned = False
        self.reset()

    @property
    def lookahead_s(self) -> float:
        """Seconds of sound needed after an instant before its frame can be computed."""
        return self._lookahead_s

    @property
    def track(self) -> PhonemeTrack:
        """The phonemes as they are known now, joined end to end."""
        return self._track

    def reset(self) -> None:
        """Forget all phonemes and motion: the mouth is closed, and sound time begins at 0."""
        rest, still = self._rest, np.zeros_like(self._rest)
        self._expectation = self._with_back_off
        self._timeline = PhonemeTimeline()
        self._track = track_of(())
        self._posteriors = BelievedFrames()
        self._goal = rest
        self._last_means = deque([rest] * _LEAD_TICKS, maxlen=_LEAD_TICKS)
        self._averaged_faces = deque([rest] * len(self._weights), maxlen=len(self._weights))
        self._ticks = TickPlan(_Tick(rest, still, rest, still, AT_REST))
        self._smoothness.settle()
        self._newest_start_s = -math.inf
        self._n_at_rest = 0
        self.phonemes_planned = 0

    def push(self, update: PhonemeUpdate) -> None:
        """Apply a revision to phonemes and posteriors; motion already decided is not changed.

        Posteriors are the recogniser's probabilities of phonemes. Where they are not valid a
        warning is logged once.
        """
        self._timeline.apply(update)
        self._track = track_of(self._timeline.events)
        posteriors = update.posteriors
        is_heard = posteriors is not None and self._posteriors.push(posteriors)
        # Recognised phonemes move the mouth without back-off: where training did not have a pair of
        # them the recogniser may be mistaken (docs/decisions/motion.md). Known ones move it with,
        # whatever was heard before.
        self._expectation = self._without_back_off if is_heard else self._with_back_off
        if posteriors is None or is_heard or self._has_warned:
            return
        self._has_warned = True
        _LOG.warning(
            "probabilities of phonemes from the recogniser are not used: each head must give %d "
            "that add up to 1, %d times a second; decided phonemes alone move the mouth",
            len(PHONEMES),
            FRAMES_PER_S,
        )

    def frame_at(self, time_s: float) -> Frame:
        """Return the frame at sound time `time_s`; equal times give equal frames.

        Times may step back by half a second; for an earlier time the face at rest is returned.
        """
        tick = self._ticks.at(time_s, self._decide_tick)
        if tick is None:
            return Frame(time_s, self._rest)
        # How much of the tick is over, 0 to 1.
        share = time_s / TICK_S - tick_of(time_s) + 1.0
        return Frame(time_s, tick.at(min(1.0, max(0.0, share))))

    def faces_after(self, frame: Frame, times_s: Array) -> Array:
        """Return the faces expected at later times; the call changes no later frame.

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
        known_until_s = frame.time_s + self.known_s
        return self._blended(self.decided_at(times_s, known_until_s), times_s, known_until_s)

    def decided_at(self, times_s: Array, known_until_s: float) -> Array:
        """Return the faces expected by decided phonemes alone, without posteriors.

        Parameters
        ----------
        times_s : Array
            (k,) sound times.
        known_until_s : float
            Sound time until which phonemes are known.

        Returns
        -------
        Array
            (k, n_components) coefficients.
        """
        return self._expectation.faces_after(self._track, times_s, known_until_s)

    def adjust_smoothness(self, smoothness: float) -> None:
        """Change the smoothness, 0 to 1, from the newest tick on, eased in over 0.3 s."""
        self._smoothness.change(self._ticks.decided_until_s, smoothness)

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """Return the phoneme at sound time `time_s` as known now, for displays; None if unknown."""
        return self._timeline.event_at(time_s)

    def _decide_tick(self, time_s: float, last: _Tick) -> _Tick:
        """Return the motion of the tick that ends at `time_s`, from what is known at that time.

        last: the motion of the tick before.
        """
        begin_s = time_s - TICK_S
        context = context_at(self._track, time_s, time_s + self.known_s)
        rest = plan_rest(last.rest, *context, begin_s, self.known_s)
        at_rest = is_reached(rest, begin_s)
        if at_rest and last.is_still:
            return last
        self._n_at_rest = self._n_at_rest + 1 if at_rest else 0
        # The mean over the newest faces, moved on, and with the share of the posteriors.
        self._averaged_faces.append(self._expected_face(time_s, at_rest=at_rest))
        goal = self._extrapolated(self._weights @ np.array(self._averaged_faces))
        if not at_rest:
            goal = self._blended(goal[None], np.array([time_s]), time_s + self.known_s)[0]
        slowness_s = self._smoothness.at(time_s) * _SLOWEST_S
        # Smoothness is a low-pass filter: so much of the old face stays in each tick.
        keep = math.exp(-TICK_S / slowness_s) if slowness_s else 0.0
        self._goal = keep * self._goal + (1.0 - keep) * goal
        # Half of the way a chord would go: a sudden turn then overshoots by a few percent only.
        end_speed = (self._goal - last.start) / 2.0
        is_still = self._n_at_rest > _REMEMBERED_TICKS and not (
            end_speed.any() or last.end_speed.any()
        )
        return _Tick(last.end, last.end_speed, self._goal, end_speed, rest, is_still)

    def _expected_face(self, time_s: float, *, at_rest: bool) -> Array:
        """Return the face (n_components,) expected 10 ms after `time_s`; at it without look-ahead.

        At rest (`at_rest`) it is the rest face: motion sets out from rest itself, not from the mean
        of silences.
        """
        if at_rest:
            return self._rest
        remaining_s = self.known_s - self._averaged_ahead_s
        later_s = time_s + self._averaged_ahead_s
        phonemes, times_s = context_at(self._track, later_s, later_s + remaining_s)
        self._count_phoneme(later_s - times_s[2])
        return self._expectation.at(phonemes, times_s, remaining_s)

    def _blended(self, faces: Array, times_s: Array, known_until_s: float) -> Array:
        """Return faces (n, n_components) at times (n,) mixed with those expected by posteriors.

        known_until_s: sound time until which phonemes are known.
        """
        if self._soft is None:
            return faces
        return self._soft.mixed(faces, self._posteriors, self._track, times_s, known_until_s)

    def _extrapolated(self, expectation: Array) -> Array:
        """Return the expected face moved on by 0.1 (`LEAD`) of its change over the last 40 ms."""
        mean_before = self._last_means[0]
        self._last_means.append(expectation)
        return expectation + LEAD * (expectation - mean_before)

    def _count_phoneme(self, start_s: float) -> None:
        if start_s > self._newest_start_s:
            self._newest_start_s = start_s
            self.phonemes_planned += 1


def _bell(n: int) -> Array:
    """Return the weights (n,) of a mean, largest in the middle (Hann's window), with sum 1."""
    weights = np.sin(np.pi * np.arange(1, n + 1) / (n + 1)) ** 2
    return np.asarray(weights / weights.sum())


class LiveSynthesizer(FinishedSynthesizer):
    """A live synthesiser with the finishing step: predicted mean motion, alone or with AnimPhos."""

    def __init__(
        self,
        model: FaceModel,
        expectation: Expectation,
        style: Style | None = None,
        selection: "GuidedSelection | None" = None,
        soft: SoftExpectation | None = None,
    ) -> None:
        """Create the motion of a model's mouth; `style` None: the default settings.

        expectation: predicts the mean motion of decided phonemes. soft: predicts it from the
        recogniser's phoneme probabilities, and is blended in; None: decided phonemes alone.
        selection: chooses recorded pieces of motion (AnimPhos); None: predicted motion alone,
        whatever `unit_share` is.
        """
        style = style or Style()
        expected = ExpectedMotion(
            expectation,
            model.rest,
            lookahead_s=style.lookahead_s,
            smoothness=style.smoothness,
            soft=soft,
        )
        mixed_in = None
        if selection is not None:
            from lipsync.motion.unit_motion import UnitMotion

            mixed_in = UnitMotion(selection, expected.decided_at, expected.known_s)
        super().__init__(
            model,
            expected,
            style.strength,
            adjust_inner={"smoothness": expected.adjust_smoothness},
            units=mixed_in,
            unit_share=style.unit_share,
            stage=style.stage,
        )
