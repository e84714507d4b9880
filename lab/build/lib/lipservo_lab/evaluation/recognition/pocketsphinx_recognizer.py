"""A recogniser to compare with: pocketsphinx in allphone mode, behind voice activity detection.

The detector in front is not optional: pocketsphinx alone called 90 % of the frames of faint white
noise speech. It needs the extra `align`; no face listens through it (docs/decisions/0038).
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pocketsphinx import Decoder, get_model_path

from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock
from lipsync.phonemes import SILENCE, VISEME_OF, PhonemeUpdate
from lipsync.recognition.streaming import UpdateBuilder
from lipsync.recognition.voice_activity import (
    FRAMES_PER_S,
    HANG_OVER_S,
    OPEN_AFTER_S,
    VoiceActivityDetector,
    level_db,
)

FRAME_SAMPLES = SAMPLE_RATE_HZ // FRAMES_PER_S
#: Of the decoder's visemes 86 % are what they will stay after 100 ms, 95 % after 150 ms (measured).
LATENCY_S = 0.15
#: Sound before the first loud frame that is decoded too: weak onsets (F, HH) lie there.
PRE_ROLL_S = 0.10
#: A pause of this length ends the utterance, and with it the decoder's memory of it.
PAUSE_S = 0.30
#: An utterance without a pause is cut here: the decoder's memory and search grow with its length.
LONGEST_UTTERANCE_S = 15.0
#: Of a longer gap between blocks only this much is filled with silence, then time jumps to its end;
#: by then the utterance is over and the detector has forgotten the noise floor.
HEARD_GAP_S = 2.0


class PocketsphinxRecognizer:
    """A `LiveRecognizer` that loads in 30 ms and costs about 0.5 ms for 10 ms of speech.

    It gives one phoneme for each 10 ms frame of sound time. What the decoder changes later than
    `latency_s` is not reported.
    Memory stays bounded as long as `updates` is called from time to time.
    """

    def __init__(self, latency_s: float = LATENCY_S) -> None:
        if not 0.0 <= latency_s < LONGEST_UTTERANCE_S:
            raise ValueError(f"latency_s is {latency_s}; it must be 0 to {LONGEST_UTTERANCE_S}")
        self._latency_frames = _frames(latency_s)
        self.reset()

    @property
    def latency_s(self) -> float:
        """At sound time t the phonemes before t - latency_s are settled."""
        return self._latency_frames / FRAMES_PER_S

    def reset(self) -> None:
        """Forget everything, ready for a new stream at sound time 0."""
        self._decoder = _AllphoneDecoder()
        self._activity = VoiceActivityDetector()
        self._updates = UpdateBuilder(FRAMES_PER_S, self._latency_frames)
        self._part_frame = np.zeros(0, dtype=np.float32)
        self._n_heard = 0  # whole frames
        self._n_reported = 0  # whole frames heard at the last update
        # The phonemes from the first frame not final on, up to where the utterance begins.
        self._settled: list[str] = []
        self._utterance: _Utterance | None = None
        self._recent: deque[NDArray[np.float32]] = deque(maxlen=_frames(PRE_ROLL_S + OPEN_AFTER_S))

    def feed(self, block: AudioBlock) -> None:
        """Take the next block: any size, at 16 kHz; a gap before it counts as silence.

        Raises ValueError for another rate and for a block that starts before the last one's end.
        """
        if block.sample_rate_hz != SAMPLE_RATE_HZ:
            raise ValueError(f"sound at {block.sample_rate_hz} Hz; {SAMPLE_RATE_HZ} Hz is needed")
        n_fed = self._n_heard * FRAME_SAMPLES + len(self._part_frame)
        n_missing = round(block.start_s * SAMPLE_RATE_HZ) - n_fed
        if n_missing < 0:
            raise ValueError(
                f"the block starts at {block.start_s} s, but sound was heard until "
                f"{n_fed / SAMPLE_RATE_HZ} s; feed blocks in order, or reset for a new stream"
            )
        if n_missing > 0:
            self._hear_gap(n_missing)
        self._process(block.samples)

    def updates(self) -> list[PhonemeUpdate]:
        """One update if a whole frame was heard since the last call, else none."""
        if self._n_heard == self._n_reported:
            return []
        self._n_reported = self._n_heard
        n_final = self._updates.n_final
        update = self._updates.update(self._settled + self._unsettled())
        del self._settled[: self._updates.n_final - n_final]
        return [update]

    def _hear_gap(self, n_missing: int) -> None:
        n_heard = min(n_missing, round(HEARD_GAP_S * SAMPLE_RATE_HZ))
        self._process(np.zeros(n_heard, dtype=np.float32))
        n_skipped_frames, n_rest = divmod(n_missing - n_heard, FRAME_SAMPLES)
        self._settled.extend([SILENCE] * n_skipped_frames)
        self._n_heard += n_skipped_frames
        self._process(np.zeros(n_rest, dtype=np.float32))

    def _process(self, samples: NDArray[np.float32]) -> None:
        samples = np.concatenate((self._part_frame, samples))
        n_whole = len(samples) - len(samples) % FRAME_SAMPLES
        for frame in samples[:n_whole].reshape(-1, FRAME_SAMPLES):
            self._hear_frame(frame)
        self._part_frame = samples[n_whole:].copy()

    def _hear_frame(self, frame: NDArray[np.float32]) -> None:
        """The detector gets every frame, the decoder those of an utterance and its pre-roll."""
        was_open, is_open = self._activity.is_open, self._activity.push(level_db(frame))
        self._recent.append(frame.copy())
        self._n_heard += 1
        if self._utterance is None:
            self._settled.append(SILENCE)
            if is_open:
                self._begin_utterance()
                del self._settled[-len(self._recent) :]
            return
        self._decoder.push(frame)
        self._utterance.push(is_open, n_onset=0 if was_open else len(self._recent))
        if self._utterance.n_closed >= _frames(PAUSE_S - HANG_OVER_S):
            self._end_utterance()
        elif self._utterance.n_frames >= _frames(LONGEST_UTTERANCE_S):
            self._end_utterance()
            self._begin_utterance()

    def _begin_utterance(self) -> None:
        """Give the decoder the recent frames first; where they are settled they stay so."""
        self._decoder.begin()
        for frame in self._recent:
            self._decoder.push(frame)
        n_recent = len(self._recent)
        self._utterance = _Utterance(self._n_heard - n_recent, [True] * n_recent)

    def _end_utterance(self) -> None:
        self._decoder.end()
        self._settled.extend(self._unsettled())
        self._utterance = None

    def _unsettled(self) -> list[str]:
        """The utterance's phonemes, one a frame, from the last settled frame on."""
        if self._utterance is None:
            return []
        n_settled = self._updates.n_final + len(self._settled) - self._utterance.first_frame
        return self._utterance.phonemes(self._decoder.segments())[n_settled:]


@dataclass(slots=True)
class _Utterance:
    """The frames that the decoder has heard since it began, and which of them are speech."""

    first_frame: int
    in_speech: list[bool]
    n_closed: int = 0

    @property
    def n_frames(self) -> int:
        return len(self.in_speech)

    def push(self, is_open: bool, n_onset: int) -> None:
        """One more frame; when speech begins at it, the `n_onset` before it are speech too."""
        self.in_speech.append(is_open)
        self.n_closed = 0 if is_open else self.n_closed + 1
        if is_open and n_onset > 0:
            n_onset = min(n_onset, self.n_frames)
            self.in_speech[-n_onset:] = [True] * n_onset

    def phonemes(self, segments: list[tuple[str, int]]) -> list[str]:
        """One phoneme a frame from segments (phoneme, end frame): the last one goes on to now.

        Frames outside speech are silence, and so is an utterance that has no segment yet.
        """
        heard: list[str] = []
        for phoneme, end in segments:
            heard.extend([phoneme] * (end - len(heard)))
        heard.extend([heard[-1] if heard else SILENCE] * (self.n_frames - len(heard)))
        return [p if spoken else SILENCE for p, spoken in zip(heard, self.in_speech, strict=False)]


class _AllphoneDecoder:
    """pocketsphinx with phones for words; context-independent, as triphones are not real time.

    Its partial answer ends five frames behind the sound.
    """

    def __init__(self) -> None:
        # Language weight 1 to 4 and wider beams gave the same accuracy, 6.5 a lower one.
        self._decoder = Decoder(
            allphone=get_model_path("en-us/en-us-phone.lm.bin"),
            lm=None,
            dict=None,
            lw=2.0,
            pip=0.3,
            beam=1e-20,
            pbeam=1e-20,
            loglevel="FATAL",
        )

    def begin(self) -> None:
        self._decoder.start_utt()

    def push(self, frame: NDArray[np.float32]) -> None:
        pcm = np.rint(np.clip(frame, -1.0, 1.0) * np.float32(32767)).astype(np.int16)
        self._decoder.process_raw(pcm.tobytes(), no_search=False, full_utt=False)

    def end(self) -> None:
        self._decoder.end_utt()

    def segments(self) -> list[tuple[str, int]]:
        """(phoneme, frame after its last) in order, without gaps from frame 0; maybe none.

        Noises (+NSN+, +BREATH+ and the like) move no mouth: they are silence.
        """
        if self._decoder.hyp() is None:
            return []
        return [
            (segment.word if segment.word in VISEME_OF else SILENCE, segment.end_frame + 1)
            for segment in self._decoder.seg()
        ]


def _frames(duration_s: float) -> int:
    return round(duration_s * FRAMES_PER_S)
