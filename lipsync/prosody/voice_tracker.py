"""Sound becomes `VoiceFrame`s, 10 ms after 10 ms. Causal; nothing in it grows."""

import math

import numpy as np

from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.prosody.arousal import ArousalTracker
from lipsync.prosody.gain_jumps import GainJumpDetector
from lipsync.prosody.pitch import PitchTracker
from lipsync.prosody.sound_window import BLOCK_SAMPLES, WINDOW_SAMPLES, analyse_window
from lipsync.prosody.speaker_baseline import SpeakerBaseline
from lipsync.prosody.speech_gate import SpeechGate
from lipsync.prosody.voice_frame import VoiceFrame

#: Standard deviations to begin with: loudness in dB, pitch in semitones, tilt in dB.
_PRIOR_SDS = (6.0, 2.5, 4.0)
#: What the old loudness baseline is worth after a jump of the microphone's gain.
_AFTER_JUMP_S = 2.0


class VoiceTracker:
    """What blocks of sound say of the voice in them; one speaker, or the mean of several.

    The z of a frame is against the frames before it. All z are 0 where nobody speaks, and the
    baselines stand still there.
    """

    def __init__(self) -> None:
        self._time_s = 0.0
        self._window: Array32 = np.zeros(WINDOW_SAMPLES, np.float32)
        self._pitch = PitchTracker()
        self._gate = SpeechGate()
        self._gain_jumps = GainJumpDetector()
        self._loudness, self._pitch_st, self._tilt = map(SpeakerBaseline, _PRIOR_SDS)
        self._arousal = ArousalTracker()

    def feed(self, samples: Array32, end_s: float | None = None) -> VoiceFrame:
        """The frame that samples (160,) float32 at 16 kHz complete.

        The last block of a stream may be shorter. What is no number counts as silence, what is
        beyond full scale as full scale. end_s: sound time of their end; None: they follow the last
        block without a gap. Raises ValueError for more than 160.
        """
        n_samples = len(samples)
        if n_samples > BLOCK_SAMPLES:
            raise ValueError(f"a block of {n_samples} samples; at most {BLOCK_SAMPLES}")
        self._time_s = self._time_s + n_samples / SAMPLE_RATE_HZ if end_s is None else end_s
        window = self._window
        window[:-BLOCK_SAMPLES] = window[BLOCK_SAMPLES:]
        block = window[-BLOCK_SAMPLES:]
        block[n_samples:] = 0.0
        block[:n_samples] = samples
        peak = float(max(block.max(), -block.min()))
        if not peak <= 1.0:  # NaN too
            np.nan_to_num(block, copy=False, posinf=0.0, neginf=0.0)
            np.clip(block, -1.0, 1.0, out=block)
            peak = float(np.abs(block).max())
        return self._frame(peak)

    def _frame(self, peak: float) -> VoiceFrame:
        sound = analyse_window(self._window)
        loud_db = sound.loudness_db
        tilt_db = sound.high_db - sound.low_db
        pitch_hz = self._pitch.push(sound.newest)
        is_voiced = pitch_hz == pitch_hz
        pitch_st = 12.0 * math.log2(pitch_hz) if is_voiced else math.nan
        voice_db = max(sound.low_db, sound.high_db)
        is_speech = self._gate.push(voice_db, pitch_st)
        if self._gain_jumps.push(voice_db):
            self._loudness.doubt(_AFTER_JUMP_S)
        if not is_speech:
            arousal = self._arousal.push_silence()
            z = (0.0, 0.0, 0.0)
        else:
            pitch_z = self._pitch_st.z(pitch_st) if is_voiced else 0.0
            z = (self._loudness.z(loud_db), pitch_z, self._tilt.z(tilt_db))
            if is_voiced:
                self._loudness.push(loud_db)
                self._pitch_st.push(pitch_st)
                self._tilt.push(tilt_db)
                arousal = self._arousal.push_voiced(*z, self._gain_jumps.trust)
            else:
                arousal = self._arousal.push_unvoiced()
        return VoiceFrame(self._time_s, peak, loud_db, pitch_hz, tilt_db, is_speech, *z, arousal)
