"""Arousal of a voice by rule: how loud, high and bright it is for this speaker.

After Bone, Lee and Narayanan, "Robust unsupervised arousal rating", IEEE Trans. Affective Computing
5(2), 2014: a score of each of three features against the speaker's own baseline, then their fusion.
Weights and times are design choices. Anger and joy look the same.
"""

import math

_FRAME_S = 0.010
_LOUDNESS_WEIGHT, _PITCH_WEIGHT, _TILT_WEIGHT = 0.40, 0.35, 0.25
#: So much voiced time until the baseline is believed in full.
_CONFIDENT_S = 10.0
_ATTACK_S, _RELEASE_S, _DECAY_S = 0.4, 1.5, 2.0
#: Syllables rise and fall; what they do on average over half a second is arousal.
_SYLLABLES_S = 0.5


def score(z: float) -> float:
    """2 Phi(z) - 1: from -1 to 1, 0 at the baseline."""
    return math.erf(z / math.sqrt(2.0))


class ArousalTracker:
    """One 10 ms frame after the other; rises within 0.4 s, falls in 1.5 s, in silence to 0."""

    def __init__(self) -> None:
        self._voiced_s = 0.0
        self._fused = 0.0
        self.arousal = 0.0

    def push_voiced(
        self, loudness_z: float, pitch_z: float, tilt_z: float, loudness_trust: float
    ) -> float:
        """A voiced frame of speech. loudness_trust: 0 to 1, what is left of loudness' weight."""
        self._voiced_s += _FRAME_S
        fused = (
            _LOUDNESS_WEIGHT * loudness_trust * score(loudness_z)
            + _PITCH_WEIGHT * score(pitch_z)
            + _TILT_WEIGHT * score(tilt_z)
        )
        self._fused += _FRAME_S / _SYLLABLES_S * (fused - self._fused)
        return self.push_unvoiced()

    def push_unvoiced(self) -> float:
        """A frame within speech that has no pitch: on towards what was voiced last."""
        aim = min(1.0, self._voiced_s / _CONFIDENT_S) * self._fused
        time_s = _ATTACK_S if aim > self.arousal else _RELEASE_S
        self.arousal += _FRAME_S / time_s * (aim - self.arousal)
        return self.arousal

    def push_silence(self) -> float:
        """A frame in which nobody speaks."""
        self.arousal -= _FRAME_S / _DECAY_S * self.arousal
        self._fused -= _FRAME_S / _DECAY_S * self._fused
        return self.arousal
