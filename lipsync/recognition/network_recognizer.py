"""The recogniser of the live path: features, network, decoder, in NumPy, 10 ms at a time."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import AudioBlock
from lipsync.phonemes import PHONEMES, PhonemeUpdate
from lipsync.recognition.belief import FrameBelief
from lipsync.recognition.decoder import QUICK, SILENCE_INDEX, SMOOTH, DecoderSettings, SwitchDecoder
from lipsync.recognition.features import FRAMES_PER_S, LevelNormalizer, LogMelStream
from lipsync.recognition.intake import SoundIntake
from lipsync.recognition.network import NetworkWeights, StreamingNetwork

Array = NDArray[np.float32]

LATENCY_S = 0.095
#: The window of the newest frame ends 25 ms after its start.
_WINDOW_S = 0.025
#: Where no band reaches this log power there is no sound: digital silence gives -16.1, white noise
#: at -100 dBFS -13.7. Higher it must not be: of speech turned down by 30 dB, 6 % of the frames have
#: no band above -13 and 13 % none above -11 (20 LibriSpeech utterances, measured).
INAUDIBLE = -15.5


class NetworkRecognizer:
    """A `LiveRecognizer`; hears any rate, any block size, gaps as silence.

    latency_s: 25 ms plus so many frames as a head of the network waits, or more. It may change its
    mind only about what is not final. Memory stays bounded as long as `updates` is called.
    settings: of the decoder; None for those that fit the latency.
    """

    def __init__(
        self,
        weights: NetworkWeights,
        latency_s: float = LATENCY_S,
        settings: DecoderSettings | None = None,
    ) -> None:
        self._weights = weights
        self._delay = frames_of_delay(latency_s)
        has_lookahead = self._delay > weights.delays[0]
        self._settings = settings or (SMOOTH if has_lookahead else QUICK)
        least_s = _WINDOW_S + weights.delays[0] / FRAMES_PER_S
        if latency_s < least_s - 1e-9:
            raise ValueError(f"latency_s is {latency_s}; the network needs at least {least_s}")
        self.reset()

    @property
    def latency_s(self) -> float:
        """At sound time t the phonemes before t - latency_s are settled."""
        return _WINDOW_S + self._delay / FRAMES_PER_S

    def reset(self) -> None:
        """Forget everything, ready for a new stream at sound time 0."""
        self._intake = SoundIntake()
        self._log_mel = LogMelStream()
        self._normalizer = LevelNormalizer(self._weights.scale)
        self._network = StreamingNetwork(self._weights)
        self._decoder = SwitchDecoder(self._weights.delays, self._delay, self._settings)
        self._belief = FrameBelief(FRAMES_PER_S, self._delay + 1)
        # Of the last frames, the newest last: whether there was anything to hear.
        self._audible = deque([True] * (self._weights.delays[-1] + 1), self._weights.delays[-1] + 1)
        self._n_heard = 0  # frames whose window was heard, those jumped over among them
        self._n_said = 0
        self._settled: list[int] = []  # from the belief's border on
        self._open: list[int] = []  # the frames after them that a head has spoken about

    def feed(self, block: AudioBlock) -> None:
        """Hear the next block: any size, any rate; a gap before it is heard as silence.

        Raises ValueError for a block that starts before the last one's end, and for another rate
        than the stream began with.
        """
        silence, jump_s, samples = self._intake.take(block)
        if len(silence) > 0:
            self._hear(silence)
        if jump_s > 0.0:
            n_frames = round(jump_s * FRAMES_PER_S)
            # All that the decoder still holds is silence by now.
            self._settled.extend([SILENCE_INDEX] * n_frames)
            self._n_heard += n_frames
        self._hear(samples)

    def updates(self) -> list[PhonemeUpdate]:
        """One update if a frame's window was completed since the last call, else none."""
        if self._n_heard == self._n_said:
            return []
        self._n_said = self._n_heard
        border = self._belief.border
        known = self._settled + self._open
        # The newest frame's window reaches 15 ms beyond its end; one frame more has been heard.
        n_missing = self._n_heard + 1 - border - len(known)
        known += [known[-1] if known else SILENCE_INDEX] * n_missing
        update = self._belief.update([PHONEMES[index] for index in known])
        del self._settled[: self._belief.border - border]
        return [update]

    def _hear(self, samples: Array) -> None:
        for frame in self._log_mel.push(samples):
            posteriors = self._network.push(self._normalizer.push(frame[None]))[0]
            self._audible.append(bool(frame.max() >= INAUDIBLE))
            for head, delay in enumerate(self._weights.delays):
                if not self._audible[-1 - delay]:  # each head speaks about a frame of its own
                    posteriors[head] = 0.0
                    posteriors[head, SILENCE_INDEX] = 1.0
            settled, self._open = self._decoder.push(posteriors)
            if settled is not None:
                self._settled.append(settled)
            self._n_heard += 1


def frames_of_delay(latency_s: float) -> int:
    """How many frames are heard after one before it is settled."""
    return int((latency_s - _WINDOW_S) * FRAMES_PER_S + 1e-6)
