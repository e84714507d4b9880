"""How much speech a silent robot that could speak recognises in the noise of its own servos."""

from typing import Final

import numpy as np

from lipservo.runtime.speech.phoneme_sources import SpokenPhonemes
from lipsync.arrays import Array, Array32
from lipsync.audio.playout import ListenedMicrophone, Playout
from lipsync.audio.source import BLOCK_SAMPLES
from lipsync.audio_block import BLOCK_S, AudioBlock
from lipsync.phonemes import SILENCE, LiveRecognizer
from lipsync.recognition.own_noise import ServoSpeeds
from lipsync.timeline import PhonemeTimeline

#: A sound card hands over pieces of 40 ms, 20 ms late.
_PIECE_BLOCKS: Final = 4
_LATE_BLOCKS: Final = 2


class PieceMicrophone:
    """A microphone that hands recorded sound over in pieces, late, as sound cards do."""

    name, duration_s, is_live, lost_blocks = "microphone", None, True, 0

    def __init__(self, samples: Array32) -> None:
        """samples: (n,) at 16 kHz, captured from time 0 on."""
        self._samples = samples
        self._n_given = 0
        self._now_s = 0.0

    def advance(self, now_s: float) -> None:
        """Capture until `now_s`, s."""
        self._now_s = now_s

    def blocks(self, _until_s: float) -> list[AudioBlock]:
        """Return the blocks of 10 ms in whole pieces that the sound card has handed over by now."""
        n_available = round(self._now_s / BLOCK_S) - _LATE_BLOCKS
        n_available = min(max(0, n_available), len(self._samples) // BLOCK_SAMPLES)
        n_available -= n_available % _PIECE_BLOCKS
        first, self._n_given = self._n_given, max(n_available, self._n_given)
        return [
            AudioBlock(self._samples[n * BLOCK_SAMPLES :][:BLOCK_SAMPLES], n * BLOCK_S)
            for n in range(first, self._n_given)
        ]

    def __enter__(self) -> "PieceMicrophone":
        return self

    def __exit__(self, *exc: object) -> None: ...


def half_duplex_false_speech(
    recognizer: LiveRecognizer, samples: Array32, servos_deg: Array | None
) -> float:
    """Return the share of time in which sound without speech is recognised as speech.

    The recogniser runs behind a microphone as in a half-duplex robot that stays silent.

    Parameters
    ----------
    recognizer : LiveRecognizer
        Is reset first.
    samples : Array32
        (n,) at 16 kHz.
    servos_deg : Array | None
        (n // 160, n_servos), encoder readings every 10 ms, from which the recogniser gets the
        servos' speeds; None: it gets none.

    Returns
    -------
    float
        0 to 1.
    """
    recognizer.reset()
    microphone = PieceMicrophone(samples)
    playout = Playout(None, ListenedMicrophone(microphone))
    source, timeline, speeds = SpokenPhonemes(playout, recognizer), PhonemeTimeline(), ServoSpeeds()
    is_speech = []
    for number in range(len(samples) // BLOCK_SAMPLES):
        now_s = (number + 1) * BLOCK_S
        microphone.advance(now_s)
        playout.advance(now_s)
        found = None if servos_deg is None else speeds.take(now_s, servos_deg[number])
        if found is not None:
            source.note_servo_speeds(*found)
        for update in source.updates(now_s):
            timeline.apply(update)
        event = timeline.event_at(now_s - source.latency_s - BLOCK_S)
        is_speech.append(event is not None and event.phoneme != SILENCE)
    return float(np.mean(is_speech))
