"""How and when the speaker's lips close: read off the recordings. Offline."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.utterance import Utterance
from lipsync.arrays import Array
from lipsync.markers import CLOSED_GAP_MM
from lipsync.phonemes import PHONEMES

_CLOSING = ("P", "B", "M", "F", "V")
#: The tightest moment is looked for this far around the phone: labels are good to a few tens of ms.
_AROUND_S = 0.04
#: Frames this near to the smallest gap are as tight: the tracker's jitter is about 0.1 mm.
_AS_TIGHT_MM = 0.15
_STEP_S = 0.005
#: A phone seen fewer times is not asked for its own moment.
_FEWEST = 5


@dataclass(frozen=True, slots=True)
class Closures:
    """labiodental_gap_mm: the median smallest gap of F and V; tightest_s: (40,), see FaceModel."""

    labiodental_gap_mm: float
    tightest_s: Array


def observe_closures(
    utterances: Iterable[Utterance], lip_gaps_mm: Callable[[NDArray[np.floating]], Array]
) -> Closures:
    """Medians over all closing phones. A phoneme too rare takes the median of all.

    lip_gaps_mm: (n_frames, n_points, 3) -> (n_frames,), how far the lips are apart.
    """
    moments_s: dict[str, list[float]] = {phoneme: [] for phoneme in _CLOSING}
    labiodental_mm: list[float] = []
    for utterance in utterances:
        gaps_mm = lip_gaps_mm(utterance.markers_mm)
        frames_s = np.arange(len(gaps_mm)) / utterance.frame_rate_hz
        for phone in utterance.phones:
            if phone.phoneme not in _CLOSING or phone.end_s is None:
                continue
            times_s = np.arange(phone.start_s - _AROUND_S, phone.end_s + _AROUND_S, _STEP_S)
            around_mm = np.interp(times_s, frames_s, gaps_mm)
            tight = around_mm <= around_mm.min() + _AS_TIGHT_MM
            moments_s[phone.phoneme].append(float(times_s[tight].mean() - phone.start_s))
            if phone.phoneme in ("F", "V"):
                labiodental_mm.append(float(around_mm.min()))
    everything = [m for list_ in moments_s.values() for m in list_] or [0.0]
    tightest_s = np.zeros(len(PHONEMES))
    for phoneme, list_ in moments_s.items():
        enough = list_ if len(list_) >= _FEWEST else everything
        # Inside the phone, or a closure would belong to the phone before.
        tightest_s[PHONEMES.index(phoneme)] = max(0.0, float(np.median(enough)))
    gap_mm = float(np.median(labiodental_mm)) if labiodental_mm else CLOSED_GAP_MM
    return Closures(gap_mm, tightest_s)
