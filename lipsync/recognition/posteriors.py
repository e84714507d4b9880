"""From samples to phoneme posteriors: features, network, and detectors of sound that is no voice.

No voice are digital silence, steady sound, and the robot's own servos, where speeds are given.

The same arithmetic serves the live recogniser (a frame at a time), files that are processed ahead
of their time (many frames in one matrix product), and whole recordings.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.phonemes import FramePosteriors
from lipsync.recognition.decoder import SILENCE_INDEX, PosteriorFormat
from lipsync.recognition.features import (
    FRAMES_PER_S,
    HOP,
    N_BANDS,
    SPEECH_PEAK,
    WINDOW,
    LevelNormalizer,
    LogMelStream,
)
from lipsync.recognition.network import NetworkWeights, StreamingNetwork
from lipsync.recognition.own_noise import SURE_OF_SILENCE, OwnNoise, SteadySoundDetector

#: Where no band reaches this log power there is no sound: digital silence gives -16.1, white noise
#: at -100 dBFS -13.7. It must not be higher: of speech turned down by 30 dB, 6 % of the frames have
#: no band above -13 and 13 % none above -11 (20 LibriSpeech utterances, measured).
INAUDIBLE = -15.5
#: So many frames of silence go through the network together: in one product of matrices they cost
#: a third. Few enough not to delay the first sound after them by a tick of 10 ms.
_SILENCE_AT_ONCE = 16
#: A whole recording is processed in pieces of so many samples: memory does not grow with it.
_PIECE = 10 * SAMPLE_RATE_HZ
#: The mean over the bands from which on a person in the room would call it a sound: 30 dB below
#: the loud frames of speech.
NOTICEABLE = SPEECH_PEAK - 3.0 * math.log(10.0)


class PosteriorStream:
    """Converter of samples in pieces of any size to phoneme posteriors, frame by frame of 25 ms.

    Pieces of several frames go through the network in one matrix product; the posteriors differ
    from those of single frames by rounding only (1e-5).
    """

    def __init__(self, weights: NetworkWeights, own_noise: OwnNoise | None = None) -> None:
        """Create the stream; `own_noise`: the servos' noise, None if their speeds are unknown."""
        self._own_noise = own_noise
        self._n_samples = self._n_frames = 0
        self.format = PosteriorFormat(weights.phonemes, weights.delays)
        self._log_mel = LogMelStream()
        self._normalizer = LevelNormalizer(weights.scale)
        self._network = StreamingNetwork(weights)
        self._pending = np.zeros((0, N_BANDS), np.float32)  # frames, not in the network yet
        self._silence = np.zeros((1, len(weights.delays), len(weights.phonemes)), np.float32)
        self._silence[..., SILENCE_INDEX] = 1.0
        #: Whether all heads heard silence in all frames of the last push.
        self.is_silent = False
        #: Whether each of the frames of the last push was noticeable.
        self.noticeable: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._steady = SteadySoundDetector()
        # Whether there may have been a voice in each of the last frames, the newest last.
        self._may_be_voice = np.ones(weights.delays[-1], np.bool_)

    def use_own_noise(self, own_noise: OwnNoise) -> None:
        """Use `own_noise`, the noise model of the robot's servos, from now on."""
        self._own_noise = own_noise

    def push(self, samples: Array32, until_s: float = 0.0, *, is_awake: bool = False) -> Array32:
        """Add samples; return the phoneme posteriors of the frames that they complete.

        The head that waits d frames gives, at frame k, the posteriors of frame k - d. Where that
        frame is no voice, they are those of silence, whatever the network gives.

        Parameters
        ----------
        samples : Array32
            (m,) at 16 kHz.
        until_s : float
            Sound time in s at which the samples end; used for the robot's own noise only.
        is_awake : bool
            Whether speech was recognised just before; used for the robot's own noise only.

        Returns
        -------
        Array32
            (n, n_heads, n_phonemes).
        """
        frames = self._log_mel.push(samples)
        n = len(frames)
        self._n_samples += len(samples)
        self._n_frames += n
        self.noticeable = frames.mean(axis=1) >= NOTICEABLE
        if n == 0:
            return self._silence[:0]
        is_steady = np.array([self._steady.push(frame) for frame in frames])
        may_be_voice = (frames.max(axis=1) >= INAUDIBLE) & ~is_steady
        if self._own_noise is not None:
            may_be_voice &= ~self._is_own_noise(self._own_noise, frames, until_s, is_awake=is_awake)
        recent = np.concatenate((self._may_be_voice, may_be_voice))
        # Frames that wait for their last head come first.
        self._may_be_voice = recent[n:]
        self._pending = np.concatenate((self._pending, frames))
        self.is_silent = self._own_noise is None and not recent.any()
        if self.is_silent:
            if len(self._pending) >= _SILENCE_AT_ONCE:
                self._run_network()
            return np.broadcast_to(self._silence, (n, *self._silence.shape[1:]))
        posteriors = self._run_network()[-n:]
        if self._own_noise is not None:
            self._learn_own_noise(self._own_noise, posteriors)
        # A head's frames are those `delay` frames ago: silence where these are no voice.
        for head, delay in enumerate(self.format.delays):
            first = len(recent) - n - delay
            silent = ~recent[first : first + n]
            posteriors[silent, head] = 0.0
            posteriors[silent, head, SILENCE_INDEX] = 1.0
        return posteriors

    def _run_network(self) -> Array32:
        """Run the network on all pending frames; return their posteriors."""
        frames, self._pending = self._pending, self._pending[:0]
        return self._network.push(self._normalizer.push(frames))

    def _is_own_noise(
        self, own_noise: OwnNoise, frames: Array32, until_s: float, *, is_awake: bool
    ) -> NDArray[np.bool_]:
        """Add frames (n, 40) to the noise model; return (n,): whether each is the servos' noise.

        until_s: sound time in s at which the samples pushed so far end.
        """
        first_frame = self._n_frames - len(frames)
        middles = (first_frame + np.arange(len(frames))) * HOP + WINDOW // 2
        times_s = until_s - (self._n_samples - middles) / SAMPLE_RATE_HZ
        is_noise = [
            own_noise.is_own_noise(frame, time_s, is_awake=is_awake)
            for frame, time_s in zip(frames, times_s.tolist(), strict=True)
        ]
        return np.array(is_noise, np.bool_)

    def _learn_own_noise(self, own_noise: OwnNoise, posteriors: Array32) -> None:
        """Learn servo noise from the frames that the last head is now sure are silent."""
        newest = len(posteriors) - 1
        for index in np.flatnonzero(posteriors[:, -1, SILENCE_INDEX] > SURE_OF_SILENCE):
            own_noise.learn(newest - int(index) + self.format.delays[-1])


def whole_posteriors(weights: NetworkWeights, samples: Array32) -> FramePosteriors:
    """Return the network's phoneme posteriors of a whole recording.

    Parameters
    ----------
    weights : NetworkWeights
        Weights of the network.
    samples : Array32
        (n,) at 16 kHz.

    Returns
    -------
    FramePosteriors
        Its values are (n_frames, n_heads, n_phonemes).
    """
    stream = PosteriorStream(weights)
    pieces = range(0, max(len(samples), 1), _PIECE)
    values = np.concatenate([stream.push(samples[start : start + _PIECE]) for start in pieces])
    return FramePosteriors(FRAMES_PER_S, 0, weights.delays, values)
