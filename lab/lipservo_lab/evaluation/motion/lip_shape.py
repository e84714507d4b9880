"""What of the lips anybody sees, and a robot can show: how far apart, how wide, how far forward."""

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.face.model import FaceModel

#: Columns of `lip_shapes_mm`.
LIP_SHAPE = ("gap", "width", "protrusion")


def lip_shapes_mm(face: FaceModel, markers_mm: NDArray[np.floating]) -> Array:
    """(n_frames, n_points, 3) -> (n_frames, 3), in the order of LIP_SHAPE.

    gap: as `FaceModel.lip_gaps_mm`. width: from the outermost point of the lips on the one side to
    that on the other, sideways; NaN for a layout without points of the lips. protrusion: how far
    forward, in the head's pose, the middle of the two points of the lip gap stands.
    """
    layout = face.layout
    gap_mm = face.lip_gaps_mm(markers_mm)
    middle_mm = (markers_mm[:, layout.upper_lip] + markers_mm[:, layout.lower_lip]) / 2.0
    if layout.lips:
        width_mm = np.ptp(markers_mm[:, list(layout.lips), 0], axis=1)
    else:
        width_mm = np.full(len(gap_mm), np.nan)
    return np.stack([gap_mm, width_mm, middle_mm[:, 2]], axis=1).astype(np.float64)
