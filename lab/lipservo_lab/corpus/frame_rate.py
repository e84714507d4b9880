"""A sentence's motion at another frame rate."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
from scipy.signal import resample_poly

from lipservo_lab.corpus.utterance import Utterance

#: Frame rates as ratios of whole numbers no larger; 29.97 to 25 is off by 3 ms in an hour.
_LARGEST_TERM = 1200


def at_frame_rate(utterance: Utterance, frame_rate_hz: float) -> Utterance:
    """The same sentence with a frame at every i / frame_rate_hz, as long as the recording goes.

    By a polyphase filter, which holds back what fewer frames cannot show; edges go on as the line
    between them does.
    """
    ratio = Fraction(frame_rate_hz / utterance.frame_rate_hz).limit_denominator(_LARGEST_TERM)
    if ratio == 1:
        return replace(utterance, frame_rate_hz=frame_rate_hz)
    markers_mm = resample_poly(
        utterance.markers_mm.astype(np.float64),
        ratio.numerator,
        ratio.denominator,
        axis=0,
        padtype="line",
    )
    return replace(utterance, markers_mm=markers_mm.astype(np.float32), frame_rate_hz=frame_rate_hz)
