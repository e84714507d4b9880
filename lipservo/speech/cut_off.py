"""What the mouth does once its sound is cut off: it closes, and later joins speech again."""

import numpy as np

from lipsync.arrays import Array

#: From wherever it is to rest: as fast as a mouth closes for a P, so that with the servos' own lag
#: it is closed within 200 ms.
CLOSING_S = 0.10
#: Back from rest to what is said by then: no jump, and over before the first vowel is.
JOINING_S = 0.08


class CutOff:
    """Poses of all servos, one each period; positions are joint angles in degrees (n_servos,)."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._start_deg: Array = np.zeros(0)
        self._rest_deg: Array = np.zeros(0)
        self._closed = 1.0
        self._joined = 1.0
        #: Sound that comes before it is not shown.
        self.until_s = -np.inf
        self.is_closing = False

    def begin(self, shown_deg: Array, rest_deg: Array, until_s: float) -> None:
        """The mouth is at `shown_deg` and is to rest until sound time `until_s`."""
        self.until_s = max(self.until_s, until_s) if self.is_closing else until_s
        if self.is_closing:
            return
        self.is_closing = True
        self._start_deg, self._rest_deg = shown_deg, rest_deg
        self._closed = 0.0

    def close(self) -> Array:
        """The next pose on the way to rest."""
        self._closed = min(1.0, self._closed + self._period_s / CLOSING_S)
        return self._between(self._start_deg, self._rest_deg, self._closed)

    def join(self, live_deg: Array) -> Array:
        """The next pose on the way back to what speech wants."""
        if self.is_closing:
            self.is_closing = False
            self._start_deg = self._between(self._start_deg, self._rest_deg, self._closed)
            self._joined = 0.0
        if self._joined >= 1.0:
            return live_deg
        self._joined = min(1.0, self._joined + self._period_s / JOINING_S)
        return self._between(self._start_deg, live_deg, self._joined)

    @staticmethod
    def _between(start_deg: Array, end_deg: Array, share: float) -> Array:
        """3 u^2 - 2 u^3 of the way: it begins and ends at rest."""
        return np.asarray(start_deg + share * share * (3.0 - 2.0 * share) * (end_deg - start_deg))
