"""Lips that must touch do touch: when, planned from the phonemes, and by how small a correction.

A closure asks that the inner lips come within a distance. The face is moved by the change that is
likeliest to go with such a change of the gap in the recordings (the conditional mean of a Gaussian,
Bishop, "Pattern Recognition and Machine Learning", 2006, eq. 2.81), and only as far as needed.
"""

import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.expectation.context import PhonemeTrack
from lipsync.face.model import FaceModel
from lipsync.motion.tick_plan import Amount
from lipsync.phonemes import PHONEMES

#: Lips pressed together show this gap, mm. The bar is 1.0; the rest leaves room for the sampling
#: of a face between two ticks. Closer costs accuracy (docs/motion.md).
BILABIAL_GAP_MM = 0.7
#: Closer lips touch, in the recordings and where closures are counted.
TOUCHING_MM = 1.0
#: What no change of the gap can be told from, as a share of its variance: keeps the inverse finite.
_RIDGE = 1e-6
#: Rounds the corner where the correction sets in, mm, so that the motion keeps its speed there.
_CORNER_MM = 0.2


@dataclass(frozen=True, slots=True)
class LipGap:
    """The vector from lower to upper inner lip, linear in the face, and what moves with it.

    at_mean_mm: (3,); per_face: (n_components, 3); response: (3, n_components), the change of the
    face that goes with a change of the gap.
    """

    at_mean_mm: Array
    per_face: Array
    response: Array

    def begin_to_touch(self, faces: Array) -> NDArray[np.bool_]:
        """Which of the faces (n, n_components) of a motion are the first with lips that touch."""
        widths_mm = np.linalg.norm(self.at_mean_mm + faces @ self.per_face, axis=1)
        touch = widths_mm <= TOUCHING_MM
        return np.asarray(touch & ~np.insert(touch[:-1], 0, touch[0]))

    def shut(self, face: Array) -> Array:
        """The face (n_components,) with its lips pressed together."""
        return self.narrowed(face, BILABIAL_GAP_MM, 1.0)

    def narrowed(self, face: Array, distance_mm: float, amount: float) -> Array:
        """The face (n_components,) with its gap brought to at most `distance_mm`.

        amount: 0 leaves the face alone, 1 does it all; in between the share of the excess. The
        result follows face, distance and amount without a jump in value or speed.
        """
        if amount <= 0.0:
            return face
        gap_mm = self.at_mean_mm + face @ self.per_face
        width_mm = math.sqrt(float(gap_mm @ gap_mm))
        excess_mm = width_mm - distance_mm + _CORNER_MM
        soft_mm = (excess_mm + math.sqrt(excess_mm**2 + _CORNER_MM**2)) / 2.0
        share = min(amount, 1.0) * soft_mm / math.sqrt(width_mm**2 + _CORNER_MM**2)
        return np.asarray(face - (share * gap_mm) @ self.response)


def lip_gap_of(model: FaceModel) -> LipGap:
    """The gap of a model's face, with the response that its recordings show."""
    basis = model.basis.reshape(model.n_components, -1, 3)
    upper, lower = model.layout.upper_lip, model.layout.lower_lip
    per_face = basis[:, upper] - basis[:, lower]
    spread = model.covariance @ per_face
    gap_covariance = per_face.T @ spread
    ridge = _RIDGE * np.trace(gap_covariance) * np.eye(3)
    response = np.linalg.solve(gap_covariance + ridge, spread.T)
    at_mean_mm = model.mean_mm[upper] - model.mean_mm[lower] - model.lips_touching_mm
    return LipGap(at_mean_mm, per_face, response)


#: Lips shut, and lower lip at the upper teeth.
BILABIALS = ("P", "B", "M")
LABIODENTALS = ("F", "V")

#: Lips take this long to close, and to part. Chosen on inner splits of the training part
#: (docs/motion.md): shorter is more abrupt, longer closes the vowels around as well.
CLOSING_S = 0.04
PARTING_S = 0.04
#: They touch this long at least, around the moment at which the recordings are tightest.
HOLD_S = 0.02
#: While an M sounds the lips stay shut, from its onset until they must part for what follows.
_HUMMED = PHONEMES.index("M")
_HUM_ENDS_S = 0.03
#: Sums of the same times differ by less.
_ROUNDING_S = 1e-9


OPEN = Amount(0.0, PARTING_S, 0.0, 0.0, 0.0)


def planned(
    now: Amount,
    moments_s: Mapping[int, float],
    track: PhonemeTrack,
    time_s: float,
    known_until_s: float,
) -> Amount:
    """What the amount does from `time_s` on. Once begun, a closure is completed before it ends.

    moments_s: for each phoneme that closes, when after its onset it is tightest.
    """
    if now.goal == 1.0 and time_s < now.start_s + now.duration_s:
        return now
    if _is_due(now.touched_s, moments_s, track, time_s, known_until_s):
        goal, duration_s, touched_s = 1.0, CLOSING_S, time_s + CLOSING_S
    else:
        goal, duration_s, touched_s = 0.0, PARTING_S, now.touched_s
    if goal == now.goal:
        return replace(now, touched_s=time_s) if goal == 1.0 else now
    return Amount(time_s, duration_s, *now.at(time_s), goal, touched_s)


def _is_due(
    touched_s: float,
    moments_s: Mapping[int, float],
    track: PhonemeTrack,
    time_s: float,
    known_until_s: float,
) -> bool:
    """Whether the lips should be closing or closed, by all that is known."""
    return any(
        from_s - CLOSING_S <= time_s + _ROUNDING_S and time_s < until_s - _ROUNDING_S
        for from_s, until_s in closures(touched_s, moments_s, track, time_s, known_until_s)
    )


def closures(
    touched_s: float,
    moments_s: Mapping[int, float],
    track: PhonemeTrack,
    time_s: float,
    known_until_s: float,
) -> Iterator[tuple[float, float]]:
    """From when until when lips touch, for each closing phoneme around and after `time_s`.

    touched_s: when they touched last; the rest as `planned` has it.
    """
    # A tightest moment is at most so far from its onset, before or after.
    first = bisect_right(track.starts_s, time_s) - 2
    for i in range(max(0, first), len(track.phonemes)):
        start_s, end_s = track.starts_s[i], track.ends_s[i]
        if start_s > known_until_s + _ROUNDING_S:
            return
        if track.phonemes[i] in moments_s:
            # In the recordings an M lasts long; a short one is tightest in its middle, not its end.
            moment_s = min(start_s + moments_s[track.phonemes[i]], (start_s + end_s) / 2.0)
            from_s, until_s = moment_s - HOLD_S / 2.0, moment_s + HOLD_S / 2.0
            if track.phonemes[i] == _HUMMED:
                from_s = min(from_s, start_s + HOLD_S)
                until_s = max(until_s, min(end_s, known_until_s) - _HUM_ENDS_S)
            if touched_s < start_s - HOLD_S:
                until_s = max(until_s, end_s)  # told late: close late, as long as it goes on
            yield from_s, until_s


def closed_share(spans_s: Sequence[tuple[float, float]], time_s: float) -> float:
    """How far lips are expected to be closed: 1 within a closure, 0 apart from all of them."""
    share = 0.0
    for from_s, until_s in spans_s:
        apart = max((from_s - time_s) / CLOSING_S, (time_s - until_s) / PARTING_S, 0.0)
        share = max(share, 1.0 - min(apart, 1.0))
    return share * share * (3.0 - 2.0 * share)
