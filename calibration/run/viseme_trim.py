"""Degrees that a person adds to a joint while a viseme class is spoken, without training anew."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calibration.calibration import Calibration, CalibrationError
from lipsync.arrays import Array
from lipsync.phonemes import VISEME_CLASSES, VISEME_OF

#: Trims come and go with this time constant: within a phone of 80 ms, without a step that the
#: servos would make audible.
_BLEND_S = 0.03


def trimmed(calibration: Calibration, phoneme: str, joint: str, degrees: float) -> Calibration:
    """The same with so many degrees for one joint and class, instead of what was there.

    Raises CalibrationError for an unknown phoneme or joint, or degrees beyond the joint's range.
    """
    if phoneme not in VISEME_OF:
        known = " ".join(viseme[0] for viseme in VISEME_CLASSES)
        raise CalibrationError(f"no phoneme {phoneme!r}; one of each class: {known}")
    if joint not in calibration.servo_names:
        known = ", ".join(calibration.servo_names)
        raise CalibrationError(f"no joint {joint!r} in this calibration; it has {known}")
    index = calibration.servo_names.index(joint)
    span_deg = float(calibration.max_deg[index] - calibration.min_deg[index])
    if not abs(degrees) <= span_deg:
        raise CalibrationError(f"{degrees:g} deg is more than {joint} can turn, {span_deg:g}")
    viseme = VISEME_CLASSES[VISEME_OF[phoneme]][0]
    row = calibration.trim.get(viseme, np.zeros(len(calibration.servo_names))).copy()
    row[index] = degrees
    return replace(calibration, trim={**calibration.trim, viseme: row})


class VisemeTrim:
    """Streaming: `feed` a phoneme each `period_s`, get the degrees to add. NumPy only."""

    def __init__(self, trim: Mapping[str, Array], n_servos: int, period_s: float) -> None:
        """trim: degrees (n_servos,) by the first phoneme of a viseme class, as in the file."""
        self._nothing = np.zeros(n_servos)
        self._wanted = [trim.get(viseme[0], self._nothing) for viseme in VISEME_CLASSES]
        self._share = 1.0 - np.exp(-period_s / _BLEND_S)
        self._idle = not trim
        self._added_deg = self._nothing

    def feed(self, phoneme: str) -> Array:
        """(n_servos,): what to add for this period."""
        if not self._idle:
            wanted = self._wanted[VISEME_OF[phoneme]]
            self._added_deg = self._added_deg + self._share * (wanted - self._added_deg)
        return self._added_deg

    def reset(self) -> None:
        """Start anew without any trim."""
        self._added_deg = self._nothing
