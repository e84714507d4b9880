"""What is usual for the voice that is heard: mean and spread of each feature, slowly forgotten."""

import math

#: Frames of 10 ms of voiced time.
_FRAMES_PER_S = 100
#: A spread is trusted after some seconds; until then it is the prior's.
_PRIOR_FRAMES = 10.0 * _FRAMES_PER_S
_MOST_Z = 4.0


class SpeakerBaseline:
    """Mean and standard deviation by exponential forgetting: 60 s of voiced time.

    Until so much was heard the mean is that of all. The standard deviation is mixed with a prior's
    that counts as 10 s, so that it is never below 0.38 of it: a monotone voice is no loud one.
    """

    def __init__(self, prior_sd: float, memory_s: float = 60.0) -> None:
        self._prior_variance = prior_sd * prior_sd
        self._most_frames = memory_s * _FRAMES_PER_S
        self._n_frames = 0.0
        self._mean = 0.0
        self._variance = 0.0

    def push(self, value: float) -> None:
        """Take the feature of one more voiced frame."""
        self._n_frames = min(self._n_frames + 1.0, self._most_frames)
        share = 1.0 / self._n_frames
        away = value - self._mean
        self._mean += share * away
        self._variance += share * ((1.0 - share) * away * away - self._variance)

    def z(self, value: float) -> float:
        """Standard deviations from the mean, -4 to 4; 0 before anything was heard."""
        if self._n_frames == 0.0:
            return 0.0
        n_all = self._n_frames + _PRIOR_FRAMES
        prior = _PRIOR_FRAMES * self._prior_variance
        sd = math.sqrt((self._n_frames * self._variance + prior) / n_all)
        return min(_MOST_Z, max(-_MOST_Z, (value - self._mean) / sd))

    def doubt(self, worth_s: float) -> None:
        """Let all that was heard so far count no more than `worth_s` of voiced time."""
        self._n_frames = min(self._n_frames, worth_s * _FRAMES_PER_S)
