"""The last correction of a pose in which the speaker's lips are near: it makes lips meet exactly.

A regression from faces to angles is off by some tenths of a millimetre, which is an opening where
lips should touch, or needless force. The distance of this robot's lips, beyond contact, is a
quadratic of its joints; so the opening that a face requires is compared with that of the
regression's pose, and joints are turned by the difference. NumPy only: it runs in every tick.
"""

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from lipsync.arrays import Array, Indices

#: The speaker's lips are closed at a gap up to CLOSED_GAP_MM. Over BLEND_MM more the wanted gap is
#: blended from pressed to open, so that angles do not jump. Up to there poses are corrected wholly,
#: from there less and less, and not at all at _CORRECTED_BELOW_MM. Closed lips are pressed wholly
#: where the coefficients are at least _FULL_PRESS_MM from the rest, and less and less nearer to it,
#: since servos must not press all day; recorded closures of speech are 2.9 mm or more from it.
CLOSED_GAP_MM, BLEND_MM, _CORRECTED_BELOW_MM, _FULL_PRESS_MM = 1.0, 0.8, 2.6, 1.0
_FADE_OUT_MM = _CORRECTED_BELOW_MM - CLOSED_GAP_MM - BLEND_MM


@dataclass(frozen=True, slots=True)
class Closure:
    """A model of the n_gaps heights between the robot's lips beyond contact, middle gap first.

    speaker_mm: (3, n_components), change of the vector from the speaker's lower to upper lip by
    each coefficient; speaker_rest_mm: (3,), that vector at rest. opens_mm: (n_gaps, n_components),
    change of the robot's wanted gaps by each coefficient. at_deg: (n_servos,), a pose with lips
    closed; gaps_mm: (n_gaps,), its gaps; slopes: (n_gaps, n_servos) and bends: (n_gaps, n_pairs),
    change of the gaps away from at_deg, pairs i <= j row by row. turns_deg: (n_servos, n_gaps),
    turns that open each gap by a millimetre. press_mm: how far past contact closures of speech go.
    """

    speaker_mm: Array
    speaker_rest_mm: Array
    opens_mm: Array
    at_deg: Array
    gaps_mm: Array
    slopes: Array
    bends: Array
    turns_deg: Array
    press_mm: float
    crossed: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Set `crossed`: `bends` as a matrix of each gap, (n_gaps, n_servos, n_servos)."""
        n_servos = len(self.at_deg)
        crossed = np.zeros((len(self.bends), n_servos, n_servos))
        crossed[:, *pairs(n_servos)] = self.bends
        object.__setattr__(self, "crossed", crossed)

    def open_mm(self, poses_deg: Array) -> Array:
        """Return how far the lips are open beyond contact in each pose.

        Parameters
        ----------
        poses_deg : Array
            (k, n_servos) degrees.

        Returns
        -------
        Array
            (k, n_gaps) mm: below 0 lips press each other.
        """
        moved_deg = poses_deg - self.at_deg
        first, second = pairs(moved_deg.shape[1])
        quadratic_mm = (moved_deg[:, first] * moved_deg[:, second]) @ self.bends.T
        return np.asarray(self.gaps_mm + moved_deg @ self.slopes.T + quadratic_mm)

    def wanted_mm(self, from_rest: Array, apart_mm: float) -> Array:
        """Return a face's wanted gaps beyond contact; negative where the speaker's lips close.

        Open lips get the opening by `opens_mm`, closed ones go `press_mm` past contact, with a
        blend between. Near the rest closed lips press less; at rest they just touch.

        Parameters
        ----------
        from_rest : Array
            (n_components,) mm, the face's coefficients less the rest.
        apart_mm : float
            Distance of the speaker's lips in this face.

        Returns
        -------
        Array
            (n_gaps,) mm.
        """
        closed_share = min(max(1.0 - (apart_mm - CLOSED_GAP_MM) / BLEND_MM, 0.0), 1.0)
        opened_mm = np.maximum(self.opens_mm @ from_rest, 0.0)
        press_mm = self.press_mm * min(math.sqrt(from_rest @ from_rest) / _FULL_PRESS_MM, 1.0)
        return np.asarray((1.0 - closed_share) * opened_mm - closed_share * press_mm)

    def corrected_deg(self, from_rest: Array, poses_deg: Array, low: Array, high: Array) -> Array:
        """Return poses (k, n_servos) corrected so that near lips are as far apart as wanted.

        Poses with the speaker's lips 2.6 mm apart or more are unchanged. Frame by frame, because
        live there is only one, for which operations on arrays of frames are slower.

        Parameters
        ----------
        from_rest : Array
            (k, n_components) mm, coefficients less the rest.
        poses_deg : Array
            (k, n_servos) degrees, from the regression.
        low,high : Array
            (n_servos,) degrees: the joints' limits.

        Returns
        -------
        Array
            (k, n_servos) degrees.
        """
        poses_deg = poses_deg.copy()
        for row, x in enumerate(from_rest):
            apart_mm = math.hypot(*(self.speaker_rest_mm + self.speaker_mm @ x))
            if apart_mm >= _CORRECTED_BELOW_MM:  # most of the ticks
                continue
            correction_share = min((_CORRECTED_BELOW_MM - apart_mm) / _FADE_OUT_MM, 1.0)
            moved_deg = poses_deg[row] - self.at_deg
            # The gaps of this pose, as `open_mm` computes them for several poses.
            open_mm = self.gaps_mm + (self.slopes + self.crossed @ moved_deg) @ moved_deg
            missing_mm = correction_share * (self.wanted_mm(x, apart_mm) - open_mm)
            # Turn the joints by what opens the gaps by the missing millimetres.
            turned_deg = poses_deg[row] + self.turns_deg @ missing_mm
            poses_deg[row] = np.minimum(np.maximum(turned_deg, low), high)
        return poses_deg


@lru_cache
def pairs(n_servos: int) -> tuple[Indices, Indices]:
    """Return the row and column indices i <= j of all pairs of n_servos values, row by row."""
    return np.triu_indices(n_servos)
