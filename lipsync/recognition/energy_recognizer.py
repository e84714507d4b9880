"""The last fallback recognisers: a jaw that follows the level of the sound, and a closed mouth."""

import math

import numpy as np

from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock
from lipsync.phonemes import SILENCE, PhonemeEvent, PhonemeUpdate, RecognizerKind
from lipsync.recognition.streaming import AudioInput, UpdateBuilder
from lipsync.recognition.voice_activity import FRAMES_PER_S, VoiceActivityDetector, level_db

_FRAME_SAMPLES = SAMPLE_RATE_HZ // FRAMES_PER_S
#: Voice activity begins 30 ms after the onset; two frames more let a plosive's burst pass.
LATENCY_S = 0.05
#: The jaw opens wide (AA) for frames within this of the peak, which falls by 10 dB a second.
_WIDE_BELOW_PEAK_DB = 8.0
_PEAK_FALL_DB = 0.1
_QUIET, _WIDE = "AH", "AA"


class EnergyRecognizer:
    """A `LiveRecognizer` by sound level alone: it reports AA (loud), AH (quieter) and silence."""

    def __init__(self) -> None:
        self.reset()

    @property
    def latency_s(self) -> float:
        """Seconds until a phoneme is final: at sound time t, those before t - latency_s are."""
        return LATENCY_S

    def reset(self) -> None:
        """Forget all sound and phonemes; the next block begins a new stream, from time 0 on."""
        self._input = AudioInput()
        self._activity = VoiceActivityDetector()
        self._updates = UpdateBuilder(FRAMES_PER_S, round(LATENCY_S * FRAMES_PER_S))
        self._waiting = np.zeros(0, np.float32)
        self._peak_db = -math.inf
        self._heard: list[str] = []
        self._n_heard = self._n_reported = 0

    def feed(self, block: AudioBlock) -> None:
        """Process the next block of any size and rate; a gap before it counts as silence.

        Raises ValueError for a block before the last one's end, or of another rate.
        """
        silence, jump_s, samples = self._input.convert(block)
        self._classify_frames(silence)
        n_jumped = round(jump_s * FRAMES_PER_S)
        self._heard.extend([SILENCE] * n_jumped)
        self._n_heard += n_jumped
        self._classify_frames(samples)

    def updates(self) -> list[PhonemeUpdate]:
        """Return one update if a 10 ms frame was completed since the last call, else []."""
        if self._n_heard == self._n_reported:
            return []
        self._n_reported = self._n_heard
        n_final = self._updates.n_final
        update = self._updates.update(self._heard)
        del self._heard[: self._updates.n_final - n_final]
        return [update]

    def _classify_frames(self, samples: np.ndarray) -> None:
        """Append AA (loud), AH (quieter) or silence to `_heard` for each 10 ms that is complete.

        samples: (n,) float32 at 16 kHz; an incomplete rest waits for the next call.
        """
        self._waiting = np.concatenate((self._waiting, samples))
        n_whole = len(self._waiting) - len(self._waiting) % _FRAME_SAMPLES
        for frame in self._waiting[:n_whole].reshape(-1, _FRAME_SAMPLES):
            frame_db = level_db(frame)
            self._peak_db = max(frame_db, self._peak_db - _PEAK_FALL_DB)
            is_wide = frame_db > self._peak_db - _WIDE_BELOW_PEAK_DB
            phoneme = (_WIDE if is_wide else _QUIET) if self._activity.push(frame_db) else SILENCE
            self._heard.append(phoneme)
            self._n_heard += 1
        self._waiting = self._waiting[n_whole:].copy()


ENERGY = RecognizerKind(lambda _weights, _latency_s: EnergyRecognizer(), LATENCY_S)


class NeutralRecognizer:
    """A `LiveRecognizer` that reports silence only: the mouth stays closed. It cannot fail."""

    latency_s = 0.0

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all sound and phonemes; the next block begins a new stream, from time 0 on."""
        self._heard_s = self._reported_s = 0.0

    def feed(self, block: AudioBlock) -> None:
        """Store the end time of the block, up to which silence is reported; ignore its sound."""
        self._heard_s = max(self._heard_s, block.end_s)

    def updates(self) -> list[PhonemeUpdate]:
        """Return one update of silence if sound was fed since the last call, else []."""
        if self._heard_s <= self._reported_s:
            return []
        replace_from_s, self._reported_s = self._reported_s, self._heard_s
        silence = PhonemeEvent(SILENCE, 0.0, None)
        return [PhonemeUpdate(replace_from_s, self._heard_s, self._heard_s, (silence,))]
