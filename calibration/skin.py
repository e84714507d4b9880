"""What neighbouring markers have in common: they sit on one skin, slit at the mouth."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lipsync.markers import MARKER_LANDMARKS, MARKER_NAMES

Array = NDArray[np.float64]

_UPPER_LIP = (39, 37, 0, 267, 269, 82, 13, 312)
_LOWER_LIP = (405, 314, 17, 84, 181, 317, 14, 87)
#: The two lips count as this far from their corners across the slit, one up and one down, so that
#: closed lips are not taken for one piece. Between 10 and 20 mm nothing changes by 0.01 mm.
_SLIT_MM = 15.0
#: Variance of the noise of a learnt motion over that of the motion itself.
_NOISE_RATIO = 0.05


def skin_smoothing(marker_names: Sequence[str], rest_mm: Array, width_mm: float) -> Array:
    """(n_markers, n_markers): noisy motions of the markers -> likely ones, by Gaussian processes.

    S = K (K + noise)^-1 with K = exp(-d^2 / 2 width^2), d the distance along the skin. width_mm = 0
    leaves everything as it is. rest_mm: (n_markers, 3).
    """
    if width_mm == 0.0:
        return np.eye(len(marker_names))
    beyond_slit_mm = np.array([_SLIT_MM * _side(name) for name in marker_names])
    places_mm = np.column_stack([rest_mm, beyond_slit_mm])
    apart_mm = np.linalg.norm(places_mm[:, None] - places_mm, axis=2)
    alike = np.exp(-0.5 * (apart_mm / width_mm) ** 2)
    return np.asarray(alike @ np.linalg.inv(alike + _NOISE_RATIO * np.eye(len(alike))))


def _side(name: str) -> float:
    """1 on the upper lip, -1 on the lower, 0 elsewhere and in the corners."""
    if name not in MARKER_NAMES:
        return 0.0
    landmark = MARKER_LANDMARKS[MARKER_NAMES.index(name)]
    return float(landmark in _UPPER_LIP) - float(landmark in _LOWER_LIP)
