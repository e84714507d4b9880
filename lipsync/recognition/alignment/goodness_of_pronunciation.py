"""Whether a text is what was said: an alignment's phones against the network's posteriors.

Forced alignment lays any text over any sound as long as it finds a path. The score is the mean
over frames of log p(aligned phone) - log p(likeliest phone), the "goodness of pronunciation" of
Witt and Young (Speech Communication 30, 2000) with the posteriors of a network: 0 where every
phone aligned is the likeliest, lower the less they agree. docs/recognition.md says how the limits
were found, and how often they err.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.recognition.batch import recording_posteriors
from lipsync.recognition.features import FRAMES_PER_S, HOP
from lipsync.recognition.network import NetworkWeights
from lipsync.recognition.weights import load_shipped_weights

#: A text that scores less was not said.
LEAST_SCORE = -3.5
#: One that scores less was probably not said as it stands: words are missing, or too many.
DOUBTFUL_SCORE = -1.5
#: Nineteen in twenty true texts of native speakers, in words for people.
USUAL_SCORES = "-0.2 to -0.8"
#: A phone that is out of the question counts as this probability: one frame decides nothing.
_SMALLEST = 1e-6


def goodness_of_pronunciation(
    samples: NDArray[np.float32],
    phones: tuple[PhonemeEvent, ...],
    weights: NetworkWeights | None = None,
) -> float:
    """The score (<= 0) of an alignment's phones, all with ends, in samples (n,) at 16 kHz.

    Counted are the frames in which the alignment or the network (None: the shipped weights) has a
    phone that is not silence. 0 where there is none. Raises WeightsError.
    """
    weights = weights or _shipped()
    posteriors = _late_posteriors(weights, samples)
    numbers = {phoneme: number for number, phoneme in enumerate(weights.phonemes)}
    aligned = np.full(len(posteriors), numbers[SILENCE])
    for event in phones:
        end_s = event.start_s if event.end_s is None else event.end_s
        first, end = round(event.start_s * FRAMES_PER_S), round(end_s * FRAMES_PER_S)
        aligned[first:end] = numbers[event.phoneme]
    logs = np.log(np.maximum(posteriors, np.float32(_SMALLEST)))
    ratio = logs[np.arange(len(logs)), aligned] - logs.max(axis=1)
    heard = logs.argmax(axis=1) != numbers[SILENCE]
    spoken = heard | (aligned != numbers[SILENCE])
    return float(ratio[spoken].mean()) if spoken.any() else 0.0


def _late_posteriors(weights: NetworkWeights, samples: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n_frames, n_phonemes) of the head that waits longest, frame k beginning at k hops."""
    n_frames, delay = max(1, -(-len(samples) // HOP)), weights.delays[-1]
    posteriors = recording_posteriors(weights, samples, n_frames + delay)
    return posteriors[delay:, -1]


@cache
def _shipped() -> NetworkWeights:
    return load_shipped_weights()
