"""Prosody of live sound: a `VoiceFrame` for every 10 ms. Causal, in bounded memory.

Arousal is by rule, after Bone, Lee and Narayanan, "Robust unsupervised arousal rating", IEEE Trans.
Affective Computing 5(2), 2014: a score of how loud, high and bright the voice is against the
speaker's own baseline, then their fusion. Weights and times are design choices. Anger and joy are
not distinguished. After a jump of a microphone's automatic gain loudness counts less for a while.

Speech is sound that is loud above the noise, voiced now and then, and unlike music. Loudness is
decided by `VoiceActivityDetector` (noise floor by minimum statistics): to it steady noise is no
speech after 1.2 s. Speech is voiced for a good part of its time, and its pitch glides; notes do
not. Thresholds were measured on grid_s1, LibriSpeech, speechocean762 (speech), and on synthetic
chords, bands and coloured noise (docs/expression.md). Whispering does not count as speech.
"""

import math
from collections import deque
from typing import Final

import numpy as np

from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.prosody.pitch import BLOCK_SAMPLES, WINDOW_SAMPLES, PitchTracker, analyse_window
from lipsync.prosody.voice_frame import VoiceFrame
from lipsync.recognition.voice_activity import FRAMES_PER_S, VoiceActivityDetector

_FRAME_S = 0.010
_LOUDNESS_WEIGHT, _PITCH_WEIGHT, _TILT_WEIGHT = 0.40, 0.35, 0.25
#: So much voiced time until the scores count in full, as the baseline is learned from it.
_CONFIDENT_S = 10.0
_ATTACK_S, _RELEASE_S, _DECAY_S = 0.4, 1.5, 2.0
#: The fused score is averaged over so long, as it rises and falls with each syllable.
_SYLLABLES_S = 0.5


def score(z: float) -> float:
    """Return 2 Phi(z) - 1 for z standard deviations, Phi the cumulative normal: -1 to 1."""
    return math.erf(z / math.sqrt(2.0))


class ArousalTracker:
    """Tracker of a speaker's arousal, -1 (sleepy) to 1 (excited), by 10 ms frames.

    Time constants: it rises with 0.4 s, falls with 1.5 s, and decays to 0 in silence with 2 s.
    """

    def __init__(self) -> None:
        self._voiced_s = 0.0
        self._fused = 0.0
        self.arousal = 0.0

    def push_voiced(
        self, loudness_z: float, pitch_z: float, tilt_z: float, loudness_trust: float
    ) -> float:
        """Add a voiced frame, in standard deviations from the baseline; return the arousal.

        loudness_trust: 0 to 1, by which the loudness is weighted.
        """
        self._voiced_s += _FRAME_S
        fused = (
            _LOUDNESS_WEIGHT * loudness_trust * score(loudness_z)
            + _PITCH_WEIGHT * score(pitch_z)
            + _TILT_WEIGHT * score(tilt_z)
        )
        self._fused += _FRAME_S / _SYLLABLES_S * (fused - self._fused)
        return self.push_unvoiced()

    def push_unvoiced(self) -> float:
        """Add an unvoiced speech frame; return the arousal, eased towards the last voiced score."""
        target = min(1.0, self._voiced_s / _CONFIDENT_S) * self._fused
        time_constant_s = _ATTACK_S if target > self.arousal else _RELEASE_S
        self.arousal += _FRAME_S / time_constant_s * (target - self.arousal)
        return self.arousal

    def push_silence(self) -> float:
        """Add a frame without speech: let the arousal decay towards 0, and return it."""
        self.arousal -= _FRAME_S / _DECAY_S * self.arousal
        self._fused -= _FRAME_S / _DECAY_S * self._fused
        return self.arousal


_FRAMES_PER_S = 100
#: The floors of 3 s are compared with those of the 3 s before: any speech has a pause in them.
_SECONDS = 3
#: Least change of the floor that is a gain jump: fans and traffic change by less.
_JUMP_DB = 6.0
#: Floors below it are not compared: digital silence between played words, no microphone's noise.
_LEAST_FLOOR_DB = -75.0
#: Frames after a jump until loudness counts in full again.
_RECOVERY_FRAMES = 20.0 * _FRAMES_PER_S


class GainJumpDetector:
    """Detector of jumps of a microphone's gain: the gain changes the noise floor and the voice.

    A voice that grows louder, or comes nearer, leaves the noise floor as it is. A noise that is
    switched on is detected as a jump as well; this only reduces the weight of loudness for a while.
    """

    def __init__(self) -> None:
        self._floors_db: deque[float] = deque(maxlen=2 * _SECONDS)
        self._lowest_db = 0.0
        self._n_in_second = 0
        self._n_since_jump = _RECOVERY_FRAMES

    @property
    def trust(self) -> float:
        """The weight of loudness, 0 to 1: 0 just after a gain jump, 1 after 20 s without one."""
        return min(1.0, self._n_since_jump / _RECOVERY_FRAMES)

    def push(self, level_db: float) -> bool:
        """Add the level of the next 10 ms, speech or not; return whether a jump is detected.

        Once a second the noise floor of the last 3 s is compared with that of the 3 s before.
        """
        self._n_since_jump += 1
        self._lowest_db = min(self._lowest_db, level_db)
        self._n_in_second += 1
        if self._n_in_second < _FRAMES_PER_S:
            return False
        self._floors_db.append(self._lowest_db)
        self._lowest_db, self._n_in_second = 0.0, 0
        if len(self._floors_db) < 2 * _SECONDS:
            return False
        floors_db = list(self._floors_db)
        before_db, now_db = min(floors_db[:_SECONDS]), min(floors_db[_SECONDS:])
        if min(before_db, now_db) < _LEAST_FLOOR_DB or abs(now_db - before_db) < _JUMP_DB:
            return False
        self._n_since_jump = 0.0
        # The next jump is looked for from here on.
        self._floors_db.clear()
        return True


#: The prior standard deviation counts as so many frames.
_PRIOR_FRAMES = 10.0 * _FRAMES_PER_S
_MOST_Z = 4.0


class SpeakerBaseline:
    """Mean and standard deviation of a feature over voiced frames, forgotten over `memory_s`.

    Before `memory_s` of voiced time the mean is over all frames. The standard deviation is mixed
    with `prior_sd`, which counts as 10 s: it is never below 0.38 of that, for 60 s of memory, so
    that small variations of a monotone voice do not count as large.
    """

    def __init__(self, prior_sd: float, memory_s: float = 60.0) -> None:
        self._prior_variance = prior_sd * prior_sd
        self._most_frames = memory_s * _FRAMES_PER_S
        self._n_frames = 0.0
        self._mean = 0.0
        self._variance = 0.0

    def push(self, value: float) -> None:
        """Add the feature's value in one more voiced frame."""
        self._n_frames = min(self._n_frames + 1.0, self._most_frames)
        share = 1.0 / self._n_frames
        deviation = value - self._mean
        self._mean += share * deviation
        self._variance += share * ((1.0 - share) * deviation * deviation - self._variance)

    def z(self, value: float) -> float:
        """Return (value - mean) / deviation, clipped to -4 to 4; 0 before the first frame."""
        if self._n_frames == 0.0:
            return 0.0
        n_all = self._n_frames + _PRIOR_FRAMES
        prior = _PRIOR_FRAMES * self._prior_variance
        sd = math.sqrt((self._n_frames * self._variance + prior) / n_all)
        return min(_MOST_Z, max(-_MOST_Z, (value - self._mean) / sd))

    def limit_weight(self, weight_s: float) -> None:
        """Let all frames so far count as at most `weight_s` seconds, so that new ones prevail."""
        self._n_frames = min(self._n_frames, weight_s * _FRAMES_PER_S)


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
    """Detector of speech in live sound, from level and pitch of each 10 ms frame."""

    def __init__(self) -> None:
        self._activity = VoiceActivityDetector()
        self._pitches_st: deque[float] = deque([math.nan] * _STEADY_FRAMES, maxlen=_STEADY_FRAMES)
        self._steady_share, self._voiced_share = _USUAL_STEADY, _USUAL_VOICED
        self._n_unvoiced = math.inf

    @property
    def floor_db(self) -> float:
        """The present noise floor in dB."""
        return self._activity.floor_db

    def push(self, level_db: float, pitch_st: float) -> bool:
        """Add a 10 ms frame; return whether it is speech. pitch_st: semitones, NaN if unvoiced."""
        is_voiced = pitch_st == pitch_st  # not NaN
        moved_st = abs(pitch_st - self._pitches_st[0])
        self._pitches_st.append(pitch_st)
        self._n_unvoiced = 0 if is_voiced else self._n_unvoiced + 1
        if not self._activity.push(level_db):
            # In a pause the shares go back to those of speech.
            self._steady_share += (_USUAL_STEADY - self._steady_share) / _MEMORY_FRAMES
            self._voiced_share += (_USUAL_VOICED - self._voiced_share) / _MEMORY_FRAMES
            return False
        if moved_st == moved_st:  # not NaN: this frame and the one 50 ms before are voiced
            is_steady = moved_st < _STEADY_ST
            self._steady_share += (is_steady - self._steady_share) / _STEADY_MEMORY_FRAMES
        self._voiced_share += (is_voiced - self._voiced_share) / _MEMORY_FRAMES
        return (
            self._n_unvoiced <= _LONGEST_UNVOICED_FRAMES
            and self._voiced_share >= _LEAST_VOICED
            and self._steady_share <= _MOST_STEADY
        )


#: Standard deviations to begin with: loudness in dB, pitch in semitones, tilt in dB.
_PRIOR_SDS = (6.0, 2.5, 4.0)
#: The old loudness baseline counts as so long after a jump of the microphone's gain.
_AFTER_JUMP_S = 2.0


class VoiceTracker:
    """Tracker of the voice in a stream of sound, one `VoiceFrame` per block, for one speaker.

    Several speakers count as one. The z of a frame compare it with the frames before it. All z are
    0 outside speech, and the baselines do not change there.
    """

    def __init__(self) -> None:
        """Start at sound time 0 after silence, without a baseline of the speaker."""
        self._time_s = 0.0
        self._window: Array32 = np.zeros(WINDOW_SAMPLES, np.float32)
        self._pitch = PitchTracker()
        self._gate = SpeechGate()
        self._gain_jumps = GainJumpDetector()
        self._loudness, self._pitch_st, self._tilt = map(SpeakerBaseline, _PRIOR_SDS)
        self._arousal = ArousalTracker()

    def feed(self, samples: Array32, end_s: float | None = None) -> VoiceFrame:
        """Add the next block of 10 ms of samples; return its `VoiceFrame`.

        The last block of a stream may be shorter. NaN and infinite samples count as silence; others
        are clipped to full scale.

        Parameters
        ----------
        samples : Array32
            (160,) float32 at 16 kHz.
        end_s : float | None
            Sound time in s of the block's end; None: it follows the last block without a gap.

        Returns
        -------
        VoiceFrame
            10 ms of prosody.

        Raises
        ------
        ValueError
            More than 160 samples.
        """
        n_samples = len(samples)
        if n_samples > BLOCK_SAMPLES:
            raise ValueError(f"a block of {n_samples} samples; give at most {BLOCK_SAMPLES}")
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
        """Return the `VoiceFrame` of the window's newest block; update baselines and arousal.

        peak: the block's greatest amplitude, 0 to 1. Baselines change in voiced speech only, after
        the frame was compared with them.
        """
        sound = analyse_window(self._window)
        loud_db = sound.loudness_db
        tilt_db = sound.high_db - sound.low_db
        pitch_hz = self._pitch.push(sound.newest)
        is_voiced = pitch_hz == pitch_hz  # not NaN
        pitch_st = 12.0 * math.log2(pitch_hz) if is_voiced else math.nan
        voice_db = max(sound.low_db, sound.high_db)
        is_speech = self._gate.push(voice_db, pitch_st)
        if self._gain_jumps.push(voice_db):
            self._loudness.limit_weight(_AFTER_JUMP_S)
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
