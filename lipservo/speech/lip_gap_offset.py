"""Lips a little more open or closed than planned, while the face runs: for a person who looks.

In the millimetres of the speaker's mouth, which the calibration scales to the robot's. Outside of
all planning, so it moves closed lips as well: less than 0 closes lips that do not meet, more than 0
eases lips that are pressed.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from lipservo.settings.motion_names import LIP_GAP_OFFSET
from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.motion.lip_closure import lip_gap_of

#: Two of these, one after the other: 3 mm in a third of a second, without a step in speed.
_TIME_CONSTANT_S: Final = 0.06
#: Closer than an encoder step moves a lip.
_THERE_MM: Final = 0.005


class LipGapOffset:
    """Streaming: `feed` a face each `period_s`, get the one to show. NumPy only."""

    def __init__(self, model: FaceModel, offset_mm: float, period_s: float) -> None:
        """offset_mm: from the beginning on."""
        #: The change of the face (n_components,) that goes with a gap 1 mm higher.
        self._per_mm: Array = np.asarray(lip_gap_of(model).response[1])
        self._share = float(1.0 - np.exp(-period_s / _TIME_CONSTANT_S))
        self.wanted_mm = self._halfway_mm = self._shown_mm = offset_mm

    def change(self, settings: Mapping[str, float]) -> None:
        """Take what was set, by name, eased in."""
        self.wanted_mm = settings.get(LIP_GAP_OFFSET, self.wanted_mm)

    def feed(self, face: Array) -> Array:
        """The face (n_components,) of the next period."""
        if self._shown_mm != self.wanted_mm:
            self._halfway_mm += self._share * (self.wanted_mm - self._halfway_mm)
            self._shown_mm += self._share * (self._halfway_mm - self._shown_mm)
            if max(abs(self.wanted_mm - mm) for mm in (self._halfway_mm, self._shown_mm)) < (
                _THERE_MM
            ):
                self._halfway_mm = self._shown_mm = self.wanted_mm
        return self.shifted(face)

    def shifted(self, face: Array) -> Array:
        """The face as it would be shown now."""
        if self._shown_mm == 0.0:
            return face
        return np.asarray(face + self._shown_mm * self._per_mm)
