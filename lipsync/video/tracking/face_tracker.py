"""What finds faces in pictures: a device to this package, behind one small protocol.

Points are numbered as the 478-point face mesh does (`lipsync/markers.py`).
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.errors import UserError

#: (height, width, 3), red, green, blue.
Picture = NDArray[np.uint8]


class TrackerError(UserError):
    """No tracker can be had; one line: what is missing, what to do."""


class FaceTracker(Protocol):
    """Finds the points of every face in a picture."""

    @property
    def name(self) -> str:
        """What it is, for reports."""

    def faces(self, picture: Picture) -> tuple[Array, ...]:
        """Points (478, 3) of each face, in pixels: x right, y down, z away from the viewer.

        The largest face comes first; none where there is none. Pictures are independent of each
        other: nothing is smoothed over time.
        """
