"""The corners of the mouth: together for W UW UH OW AO OY, and apart for a smile. The tongue's tip.

The expectation (predicted mean motion) was learned from one talker, and many hardly round lips:
across a room OW then looks as AA does. Here the corners come to within a share of their distance at
rest. The face moves by the change that is likeliest to go with such a change of the width at an
unchanged gap (the conditional mean of a Gaussian, Bishop, "Pattern Recognition and Machine
Learning", 2006, eq. 2.81), which brings the lips forward as well: a pucker. The opposite change
draws corners out and up.
"""

import math
from bisect import bisect_right
from collections.abc import Set
from dataclasses import dataclass
from typing import Final

import numpy as np

from lipsync.arrays import Array
from lipsync.expectation.expectation import PhonemeTrack
from lipsync.face.model import FaceModel
from lipsync.motion.tick_plan import Amount
from lipsync.phonemes import PHONEMES

ROUNDED: Final = frozenset(map(PHONEMES.index, ("W", "UW", "UH", "OW", "AO", "OY")))
#: Corners of round lips are at most this share of their distance at rest apart; of recorded ones of
#: grid_s1, who hardly rounds, 1 % are. A reader of recordings reads lips as round as that worse
#: (docs/decisions/closures.md), so this is for a stage and for the page.
ROUNDED_SHARE: Final = 0.8
#: For these the tongue's tip is between the teeth, or at the ridge behind the upper ones (Ladefoged
#: and Maddieson, "The Sounds of the World's Languages", 1996, chapters 2, 5 and 6).
_DENTALS: Final = frozenset(map(PHONEMES.index, ("TH", "DH")))
_ALVEOLARS: Final = frozenset(map(PHONEMES.index, ("L", "N", "T", "D")))
#: Lips take so long to round and to spread: 9 mm at 140 mm/s at most, as of any cubic. A tongue's
#: tip rises and falls as long: 14 mm at 210 mm/s.
ROUNDING_S: Final = 0.1
#: Keeps the inverse finite, as a share of the variance.
_RIDGE: Final = 1e-6
#: Rounds the corner where the correction sets in, mm.
_CORNER_MM: Final = 0.5
#: A broad smile draws the corners so far apart; sadness brings them together by as much.
_SMILE_MM: Final = 4.0
#: Sums of the same times differ by less.
_ROUNDING_ERROR_S: Final = 1e-9

#: The plans of round lips, tongue between the teeth, tongue behind them, before the first sound.
SPREAD: Final = (Amount(0.0, ROUNDING_S, 0.0, 0.0, 0.0),) * 3


@dataclass(frozen=True, slots=True)
class LipWidth:
    """The distance between the mouth's corners, linear in the face, and the face's response to it.

    at_mean_mm: the distance in the mean face; per_face: (n_components,), its change per
    coefficient; response: (n_components,), the change of the face that goes with 1 mm of width at
    an unchanged lip gap; at_rest_mm: the distance in the closed mouth.
    """

    at_mean_mm: float
    per_face: Array
    response: Array
    at_rest_mm: float

    def rounded(self, face: Array, amount: float) -> Array:
        """Return the face with corners at most `ROUNDED_SHARE` of their rest width apart.

        The result depends on face and amount without a jump.

        Parameters
        ----------
        face : Array
            (n_components,) coefficients.
        amount : float
            Share of the excess that is removed: 0 leaves the face unchanged, 1 removes all.

        Returns
        -------
        Array
            (n_components,) coefficients.
        """
        if amount <= 0.0:
            return face
        excess_mm = self.at_mean_mm + float(face @ self.per_face) - ROUNDED_SHARE * self.at_rest_mm
        # The excess, or 0 where there is none, with the corner between both rounded by a hyperbola.
        soft_excess_mm = (excess_mm + math.sqrt(excess_mm**2 + _CORNER_MM**2)) / 2.0
        return np.asarray(face - min(amount, 1.0) * soft_excess_mm * self.response)

    def smiling(self, face: Array, valence: float) -> Array:
        """Return the face with the mouth's corners 4 mm times `valence` farther apart.

        Parameters
        ----------
        face : Array
            (n_components,) coefficients.
        valence : float
            -1 (sad) to 1 (glad).

        Returns
        -------
        Array
            (n_components,) coefficients.
        """
        return np.asarray(face + _SMILE_MM * valence * self.response) if valence else face


def lip_width_of(model: FaceModel) -> LipWidth | None:
    """Return the lip width of a model's face; None for a layout without points of the lips.

    Its response is the last row of Cov(c)^-1 Cov(c, face), the conditional mean of the face
    given the lip gap and the width c, for 1 mm of width.
    """
    lips = list(model.layout.lips)
    if not lips:
        return None
    rest_mm = model.markers_mm(model.rest[None])[0, lips, 0]
    # The corners: the lips' outermost points to the speaker's left and right at rest.
    left, right = lips[int(np.argmax(rest_mm))], lips[int(np.argmin(rest_mm))]
    basis = model.basis.reshape(model.n_components, -1, 3)
    per_face = basis[:, left, 0] - basis[:, right, 0]
    gap = basis[:, model.layout.upper_lip] - basis[:, model.layout.lower_lip]
    gap_and_width = np.concatenate([gap, per_face[:, None]], axis=1)
    face_covariance = model.covariance @ gap_and_width
    covariance = gap_and_width.T @ face_covariance
    ridge = _RIDGE * np.trace(covariance) * np.eye(len(covariance))
    response = np.linalg.solve(covariance + ridge, face_covariance.T)[-1]
    at_mean_mm = float(model.mean_mm[left, 0] - model.mean_mm[right, 0])
    return LipWidth(at_mean_mm, per_face, response, float(np.ptp(rest_mm)))


def is_due(phonemes: Set[int], track: PhonemeTrack, time_s: float, known_until_s: float) -> bool:
    """Return whether lips, or the tongue, should move to the shape of `phonemes` or be in it.

    track: the phonemes, known until the sound time `known_until_s`. time_s: sound time.
    """
    known_until_s += _ROUNDING_ERROR_S
    until_s = min(time_s + ROUNDING_S + _ROUNDING_ERROR_S, known_until_s)
    # From the phone at `time_s` to the last one whose motion would begin by now.
    first = max(0, bisect_right(track.starts_s, time_s) - 1)
    for i in range(first, bisect_right(track.starts_s, until_s)):
        end_s = track.ends_s[i] if track.ends_s[i] <= known_until_s else math.inf
        if track.phonemes[i] in phonemes and time_s < end_s - ROUNDING_S / 2.0:
            return True
    return False


def plan_shapes(
    now: tuple[Amount, ...], track: PhonemeTrack, time_s: float, known_s: float
) -> tuple[Amount, ...]:
    """Return the plans of `SPREAD`, each an amount from 0 to 1, from `time_s` on.

    now: the plans so far, kept where the goal is unchanged. known_s: how many seconds after
    `time_s` the phonemes of `track` are known.
    """

    def planned(plan: Amount, phonemes: Set[int]) -> Amount:
        goal = float(is_due(phonemes, track, time_s, time_s + known_s))
        return plan if goal == plan.goal else Amount(time_s, ROUNDING_S, *plan.at(time_s), goal)

    return tuple(map(planned, now, (ROUNDED, _DENTALS, _ALVEOLARS)))
