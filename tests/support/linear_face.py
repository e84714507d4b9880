"""A robot's face whose markers are straight lines of two angles, with the truth that a bench asks.

It has what the benches use of an elastic face, is solved at once, and its figures can be worked out
by hand: the jaw opens by OPENS_MM_PER_DEG, corners go out by WIDENS_MM_PER_DEG each.
"""

from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from small_model import small_model

from calibration.mouth_servos import JointRange, MouthServos
from calibration.simulated.elastic_robot import N_PAIRS
from lipsync.markers import MARKERS_47

Array = NDArray[np.float64]

OPENS_MM_PER_DEG, WIDENS_MM_PER_DEG = 0.5, 0.25
MODEL = small_model()
NEUTRAL_MM = MODEL.markers_mm(MODEL.rest[None])[0]
SERVOS = MouthServos(
    (JointRange("jaw", -3.0, 24.0), JointRange("corners", -30.0, 30.0)),
    "linear",
    (),
    ("opens", "widens"),
)
_OPENING, _WIDTH = MODEL.basis.reshape(5, 47, 3)[:2]
_LOWER = MARKERS_47.names.index("inner_lip_14")
_CORNER = MARKERS_47.names.index("outer_lip_291")
BY_DEG = np.stack(
    [
        _OPENING * OPENS_MM_PER_DEG / -_OPENING[_LOWER, 1],
        _WIDTH * WIDENS_MM_PER_DEG / _WIDTH[_CORNER, 0],
    ]
)


class LinearFace:
    """off_edge_mm: how far each dot lies beside the edge of its lip, upper three, lower three."""

    noise_stream = (7,)
    backlash_deg = np.ones(2)

    def __init__(self, off_edge_mm: Array | None = None) -> None:
        off_mm = np.zeros(6) if off_edge_mm is None else off_edge_mm
        self.draw = SimpleNamespace(
            signs=np.ones(2), play_deg=np.ones(2), skin=SimpleNamespace(off_edge_mm=off_mm)
        )

    def markers_mm(self, angles_deg: Array) -> Array:
        """(n, 2) -> (n, 47, 3)."""
        return np.asarray(NEUTRAL_MM + np.einsum("ns,smk->nmk", angles_deg, BY_DEG))

    def seen_mm(self, output_deg: Array, _n_moves: int) -> Array:
        """(2,) -> (47, 3)."""
        return np.asarray(self.markers_mm(output_deg[None])[0])

    def state(self, angles_deg: Array, _warmth: float = 1.0) -> SimpleNamespace:
        """Markers, and the gaps of the lips' own edges, which are closed at neutral."""
        gaps_mm = np.repeat(np.maximum(OPENS_MM_PER_DEG * angles_deg[:, :1], 0.0), N_PAIRS, axis=1)
        return SimpleNamespace(markers_mm=self.markers_mm(angles_deg), gaps_mm=gaps_mm)
