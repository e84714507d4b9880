"""What arousal does to a face: gains and offsets, each with its limits.

Arousal alone comes from a voice: anger and joy sound equally excited (Bone, Lee and Narayanan,
"Robust unsupervised arousal rating", IEEE Trans. Affective Computing 5(2), 2014), so that nothing
here smiles or frowns. The sizes are design choices, not measured on people.
"""

from lipsync.expression.bounded import bounded

_LEAST_MOUTH_GAIN, _MOST_MOUTH_GAIN = 0.85, 1.2


def mouth_gain(arousal: float) -> float:
    """How far the mouth's coefficients go, 0.85 to 1.2; for all but closures of the lips."""
    return bounded(1.0 + 0.2 * bounded(arousal, -1.0, 1.0), _LEAST_MOUTH_GAIN, _MOST_MOUTH_GAIN)


def head_gain(arousal: float) -> float:
    """How far the head drifts, 0.4 to 1.6."""
    return 1.0 + 0.6 * bounded(arousal, -1.0, 1.0)


def blink_gain(arousal: float) -> float:
    """How often it blinks, 0.85 to 1.15."""
    return 1.0 + 0.15 * bounded(arousal, -1.0, 1.0)


def gaze_pace(arousal: float) -> float:
    """How quickly one fixation follows the other, 0.8 to 1.2."""
    return 1.0 + 0.2 * bounded(arousal, -1.0, 1.0)


def brow_raise(arousal: float) -> float:
    """How far excitement raises the brows, 0 to 0.2."""
    return 0.2 * max(0.0, bounded(arousal, -1.0, 1.0))


def lid_offset(arousal: float) -> float:
    """Eyes widened by excitement, to -0.25; lids drooping without any, to 0.15."""
    arousal = bounded(arousal, -1.0, 1.0)
    return -0.25 * arousal if arousal > 0.0 else -0.15 * arousal
