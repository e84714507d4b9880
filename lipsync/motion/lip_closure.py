"""Lips that must touch do touch: a correction of the face, as small as it can be.

A closure asks that the inner lips come within a distance. The face is moved by the change that is
likeliest to go with such a change of the gap in the recordings (the conditional mean of a Gaussian,
Bishop, "Pattern Recognition and Machine Learning", 2006, eq. 2.81), and only as far as needed.
"""

import math
from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array
from lipsync.face.model import FaceModel

#: Lips pressed together show this gap, mm. The bar is 1.0; the rest leaves room for the sampling
#: of a face between two ticks. Closer costs accuracy (docs/motion.md).
BILABIAL_GAP_MM = 0.7
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
