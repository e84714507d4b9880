"""Sound that stands still: hum, buzz, fans, a note held by a machine. No voice does that.

The floor of each mel band is the least that it had in the last seconds (minimum statistics, after
R. Martin, "Noise power spectral density estimation", IEEE Trans. Speech and Audio Processing 9(5),
2001), of levels smoothed over 50 ms. A sound is steady as long as all bands together stay within
`_WITHIN_DB` of their floors: so the floor adapts to any room, and what rises out of it is heard.
"""

import numpy as np

from lipsync.arrays import Array32
from lipsync.recognition.features import FRAMES_PER_S, N_BANDS

#: A vowel is not held so long without its bands moving by more than `_WITHIN_DB`.
FLOOR_S = 1.5
#: Longer than any closure in a word: these must not be taken for the hum behind them.
STEADY_S = 0.2
_WITHIN_DB = 2.0
_STEP_FRAMES = 10
_SMOOTHING = np.float32(0.2)
_DB_PER_NAT = 10.0 / np.log(10.0)


class SteadySoundDetector:
    """Takes one log-mel frame after the other and says whether the sound stands still."""

    def __init__(self) -> None:
        n_steps = round(FLOOR_S * FRAMES_PER_S) // _STEP_FRAMES
        # Before the stream there was silence: what begins at once is no steady sound yet.
        self._minima = np.full((n_steps, N_BANDS), -100.0, np.float32)
        self._level: Array32 = np.full(N_BANDS, -100.0, np.float32)
        self._n_frames = self._n_near_floor = 0
        self._floor: Array32 = self._minima[0].copy()

    def push(self, frame: Array32) -> bool:
        """Whether the sound has been steady for `STEADY_S`; frame (40,): natural log of power."""
        self._level = self._level + _SMOOTHING * (frame - self._level)
        step, within = divmod(self._n_frames, _STEP_FRAMES)
        minimum = self._minima[step % len(self._minima)]
        if within == 0:
            minimum[:] = self._level
            self._floor = self._minima.min(axis=0)
        else:
            np.minimum(minimum, self._level, out=minimum)
            np.minimum(self._floor, self._level, out=self._floor)
        self._n_frames += 1
        above_db = float(np.mean(self._level - self._floor)) * _DB_PER_NAT
        self._n_near_floor = self._n_near_floor + 1 if above_db < _WITHIN_DB else 0
        return self._n_near_floor >= round(STEADY_S * FRAMES_PER_S)
