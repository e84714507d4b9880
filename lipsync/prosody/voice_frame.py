"""Measurements of the voice in one block of sound, besides its phonemes."""

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class VoiceFrame:
    """Measurements of the voice in 10 ms of sound, made from this and earlier sound only.

    time_s: sound time of the end. peak: greatest amplitude, 0 to 1. loudness_db: root mean square,
    dB re full scale. pitch_hz: NaN where unvoiced. tilt_db: level of 500 to 4,000 Hz less that of
    80 to 500 Hz. is_speech: whether a person speaks. loudness_z, pitch_z, tilt_z: in standard
    deviations from the speaker's own mean; 0 outside speech, pitch_z also where unvoiced. arousal:
    -1 (sleepy) to 1 (excited), 0 before any speech.
    """

    time_s: float
    peak: float
    loudness_db: float
    pitch_hz: float
    tilt_db: float
    is_speech: bool
    loudness_z: float
    pitch_z: float
    tilt_z: float
    arousal: float


#: Before anything was heard.
SILENT_VOICE: Final = VoiceFrame(0.0, 0.0, -120.0, math.nan, 0.0, False, 0.0, 0.0, 0.0, 0.0)
