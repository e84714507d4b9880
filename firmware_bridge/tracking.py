"""Notices servos that do not follow: jammed, too weak, or a horn that slipped."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.health import Feedback


@dataclass(frozen=True, slots=True)
class TrackingRule:
    """A servo farther than `error_deg` from its goal for `after_s` on end does not follow.

    The defaults are our choice: at 400 deg/s a servo that lags by 30 ms is 12 deg behind, and no
    motion of speech goes one way for half a second. Raises ValueError unless both are positive.
    """

    error_deg: float = 15.0
    after_s: float = 0.5

    def __post_init__(self) -> None:
        if not (self.error_deg > 0.0 and self.after_s > 0.0):
            raise ValueError(
                f"needs error_deg > 0 and after_s > 0, got {self.error_deg} and {self.after_s}"
            )


class TrackingMonitor:
    """Compares goals with places, tick by tick. Only what was heard just now counts."""

    def __init__(self, n_servos: int, rule: TrackingRule) -> None:
        self._rule = rule
        self._well_s: NDArray[np.float64] = np.zeros(n_servos)
        self.error_deg: NDArray[np.float64] = np.zeros(n_servos)

    @property
    def rule(self) -> TrackingRule:
        """What is allowed."""
        return self._rule

    def excuse(self, index: int, until_s: float) -> None:
        """One servo need not follow until then: newly woken ones are slow on purpose."""
        self._well_s[index] = until_s

    def behind(self, sent_deg: NDArray[np.float64], feedback: Feedback) -> NDArray[np.bool_]:
        """Which servos have not followed for too long, (n_servos,)."""
        heard = feedback.age_s == 0.0
        error_deg = np.abs(sent_deg - feedback.positions_deg)
        self.error_deg = np.where(heard, error_deg, self.error_deg)
        fine = ~(self.error_deg > self._rule.error_deg)
        self._well_s = np.where(fine, np.maximum(self._well_s, feedback.time_s), self._well_s)
        return feedback.time_s - self._well_s > self._rule.after_s
