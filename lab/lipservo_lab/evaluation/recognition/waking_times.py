"""How soon the mouth leaves rest when somebody begins to speak.

Each recording is played after a pause, once with digital silence there and once with room noise
40 dB below the speech all over, to a mouth at rest. Times are sound time, as in closing_times.py: a
mouth that looks ahead leaves rest before the onset that it gets ready for.
"""

import math
from collections.abc import Iterable

import numpy as np

from lipservo_lab.evaluation.recognition.closing_times import (
    ClosingBench,
    Phones,
    Samples,
    room_noise,
)
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ
from lipsync.phonemes import SILENCE

#: A pause before the recording, and so much of it is played, s.
_PAUSE_S, _PLAYED_S = 0.6, 1.5


def waking_figures(
    bench: ClosingBench, recordings: Iterable[tuple[Samples, Phones]], rng: np.random.Generator
) -> dict[str, float]:
    """From the onset of the first phone until the mouth leaves rest, ms: median, 95th percentile.

    A mouth that has not left rest when the sound ends counts as infinitely late.
    """
    waking_ms: list[float] = []
    for samples, phones in recordings:
        onset_s = next((first * BLOCK_S for phone, first, _ in phones if phone != SILENCE), None)
        if onset_s is None:
            continue
        pause = np.zeros(round(_PAUSE_S * SAMPLE_RATE_HZ), np.float32)
        played = samples[: round((onset_s + _PLAYED_S) * SAMPLE_RATE_HZ)]
        sound = np.concatenate((pause, played))
        noise = room_noise(rng, samples, len(sound))
        for noisy in (sound, sound + noise):
            left = np.flatnonzero(~bench.watch(noisy, 0.0).is_resting)
            left_s = float(left[0]) * BLOCK_S if len(left) else math.inf
            waking_ms.append(1e3 * (left_s - onset_s - _PAUSE_S))
    found = np.array(waking_ms or [math.nan])
    return {
        "waking_ms_p50": float(np.percentile(found, 50, method="higher")),
        "waking_ms_p95": float(np.percentile(found, 95, method="higher")),
        "waking_onsets": len(waking_ms),
    }
