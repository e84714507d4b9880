"""Whether somebody speaks: loud above the noise, voiced now and then, and not as music is.

The level opens the gate (`VoiceActivityDetector`: noise floor by minimum statistics), so steady
noise closes it within 1.2 s. Speech is voiced for a good part of its time, and its pitch glides;
notes stand still. Bars measured on grid_s1, LibriSpeech, speechocean762 (speech), on made-up
chords, bands and coloured noise (docs/expression-voice.md). Whispering is no speech here.
"""

import math
from collections import deque
from typing import Final

from lipsync.recognition.voice_activity import FRAMES_PER_S, VoiceActivityDetector

#: A voiced frame is steady when 50 ms before it the pitch was within so many semitones.
_STEADY_FRAMES, _STEADY_ST = 5, 0.15
#: Steady share of the voiced frames: monotone speech loses a tenth of its time at most.
_MOST_STEADY = 0.45
#: Voiced share of the frames while the level is high: speech above 0.25, bands below 0.13.
_LEAST_VOICED = 0.12
_MEMORY_FRAMES: Final = 2.0 * FRAMES_PER_S
_STEADY_MEMORY_FRAMES: Final = 1.0 * FRAMES_PER_S
#: Shares of speech, to begin with and to go back to in silence.
_USUAL_STEADY, _USUAL_VOICED = 0.15, 0.5
#: The longest that speech goes on without voice: a long fricative beside a stop.
_LONGEST_UNVOICED_FRAMES = 0.4 * FRAMES_PER_S


class SpeechGate:
    """Level and pitch of one 10 ms frame after the other; says whether speech is going on."""

    def __init__(self) -> None:
        self._activity = VoiceActivityDetector()
        self._pitches_st: deque[float] = deque([math.nan] * _STEADY_FRAMES, maxlen=_STEADY_FRAMES)
        self._steady_share, self._voiced_share = _USUAL_STEADY, _USUAL_VOICED
        self._n_unvoiced = math.inf

    @property
    def floor_db(self) -> float:
        """The noise floor now."""
        return self._activity.floor_db

    def push(self, level_db: float, pitch_st: float) -> bool:
        """Take the next frame; pitch_st: in semitones re anything, NaN where unvoiced."""
        is_voiced = pitch_st == pitch_st
        moved_st = abs(pitch_st - self._pitches_st[0])
        self._pitches_st.append(pitch_st)
        self._n_unvoiced = 0 if is_voiced else self._n_unvoiced + 1
        if not self._activity.push(level_db):
            # What was heard before a pause says less and less of what comes after it.
            self._steady_share += (_USUAL_STEADY - self._steady_share) / _MEMORY_FRAMES
            self._voiced_share += (_USUAL_VOICED - self._voiced_share) / _MEMORY_FRAMES
            return False
        if moved_st == moved_st:
            is_steady = moved_st < _STEADY_ST
            self._steady_share += (is_steady - self._steady_share) / _STEADY_MEMORY_FRAMES
        self._voiced_share += (is_voiced - self._voiced_share) / _MEMORY_FRAMES
        return (
            self._n_unvoiced <= _LONGEST_UNVOICED_FRAMES
            and self._voiced_share >= _LEAST_VOICED
            and self._steady_share <= _MOST_STEADY
        )
