"""From samples to the posteriors of phonemes: features, network, digital silence.

One arithmetic for the live recogniser (a frame at a time), for a file that is worked on ahead of
its time (many frames in one matrix product), and for whole recordings.
"""

import numpy as np

from lipsync.arrays import Array32
from lipsync.recognition.decoder import SILENCE_INDEX
from lipsync.recognition.features import LevelNormalizer, LogMelStream
from lipsync.recognition.network import NetworkWeights, StreamingNetwork

#: Where no band reaches this log power there is no sound: digital silence gives -16.1, white noise
#: at -100 dBFS -13.7. Higher it must not be: of speech turned down by 30 dB, 6 % of the frames have
#: no band above -13 and 13 % none above -11 (20 LibriSpeech utterances, measured).
INAUDIBLE = -15.5


class PosteriorStream:
    """Samples in pieces of any size; the posteriors of a frame as soon as its 25 ms are there.

    Pieces of several frames go through the network in one matrix product; the posteriors differ
    from those of single frames by rounding only (1e-5).
    """

    def __init__(self, weights: NetworkWeights) -> None:
        self._delays = weights.delays
        self._log_mel = LogMelStream()
        self._normalizer = LevelNormalizer(weights.scale)
        self._network = StreamingNetwork(weights)
        self._none = np.zeros((0, len(weights.delays), len(weights.phonemes)), np.float32)
        # Whether there was any sound in each of the last frames, the newest last.
        self._audible = np.ones(weights.delays[-1], np.bool_)

    def push(self, samples: Array32) -> Array32:
        """(n, n_heads, n_phonemes) of the frames that samples (m,) at 16 kHz complete.

        The head that waits d frames gives, at frame k, the posteriors of frame k - d. Where that
        frame holds no sound it is silence, whatever the network says.
        """
        frames = self._log_mel.push(samples)
        n = len(frames)
        if n == 0:
            return self._none
        posteriors = self._network.push(self._normalizer.push(frames))
        audible = np.concatenate((self._audible, frames.max(axis=1) >= INAUDIBLE))
        for head, delay in enumerate(self._delays):
            first = len(self._audible) - delay
            silent = ~audible[first : first + n]
            posteriors[silent, head] = 0.0
            posteriors[silent, head, SILENCE_INDEX] = 1.0
        self._audible = audible[n:]
        return posteriors
