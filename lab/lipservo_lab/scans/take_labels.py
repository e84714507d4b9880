"""What is said in a take, and when: its labels, else its text, else as it is recognised."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.scans.scan import ScanError
from lipservo_lab.scans.takes import Take
from lipservo_lab.video.clip_labels import label_clip
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.recognition.speech_file import read_speech
from lipsync.textgrid import Interval, read_tiers

#: As a corpus's reader allows.
_LENGTH_TOLERANCE_S = 0.25


@dataclass(frozen=True, slots=True)
class TakeSound:
    """samples (n,) at 16 kHz; tiers of a TextGrid; source: `labels`, `text` or `recognised`."""

    samples: NDArray[np.float32]
    tiers: dict[str, tuple[Interval, ...]]
    source: str


def take_sound(take: Take, rate_hz: float) -> TakeSound:
    """Sound and labels of a take that has a sound.

    Raises ScanError for sound that is not as long as the scans, or labels without phones; UserError
    for a sound, labels or text that cannot be used.
    """
    if take.sound is None:
        raise ScanError(
            f"no sound {take.name}.wav or .flac, so it is no sentence of a corpus; "
            "-o FILE.npz keeps motion alone"
        )
    samples = read_speech(take.sound)
    sound_s, scans_s = len(samples) / SAMPLE_RATE_HZ, len(take.scans) / rate_hz
    if abs(sound_s - scans_s) > _LENGTH_TOLERANCE_S:
        raise ScanError(
            f"{sound_s:.2f} s of sound, {len(take.scans)} scans at {rate_hz:g} a second are "
            f"{scans_s:.2f} s; would --rate-hz {len(take.scans) / sound_s:.3g} be right?"
        )
    if take.labels is None:
        said = label_clip(samples, take.text)
        tiers = {name: tier for name, tier in said.tiers().items() if tier}
        return TakeSound(samples, tiers, said.source)
    labels = dict(read_tiers(take.labels))
    if not labels.get("phones"):
        raise ScanError(f"{take.labels}: no tier 'phones'")
    return TakeSound(samples, labels, "labels")
