"""The recogniser of the live path: posteriors of a network and a Viterbi decoder, in NumPy."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from lipsync.arrays import Array, Array32
from lipsync.audio_block import AudioBlock
from lipsync.phonemes import (
    PHONEMES,
    FramePosteriors,
    Hearing,
    PhonemeUpdate,
    RecognizerKind,
)
from lipsync.recognition.decoder import (
    QUICK,
    SILENCE_INDEX,
    SMOOTH,
    DecoderSettings,
    ViterbiDecoder,
)
from lipsync.recognition.features import FRAMES_PER_S, HOP, WINDOW
from lipsync.recognition.network import LATENCY_S, NetworkWeights, WeightsError, find_weights
from lipsync.recognition.own_noise import OwnNoise
from lipsync.recognition.posteriors import PosteriorStream
from lipsync.recognition.streaming import AudioInput, UpdateBuilder
from lipsync.recognition.text_decoder import FOLLOWING, OUTSIDE_TEXT, MovedBy, TextDecoder
from lipsync.spoken_text import PronouncedWord

#: The window of the newest frame ends 25 ms after its start.
_WINDOW_S = 0.025
#: Sound that is worked on at once where nobody waits for it: 64 frames make one matrix product.
_AHEAD_S = 0.64
#: Noise counts as lasting so long after a noticeable frame, as between two key strokes.
_NOISE_LASTS_S = 0.5


#: Seconds until a phoneme found in a given text is final; a recognised one is earlier.
FOLLOWING_LATENCY_S: Final = _WINDOW_S + FOLLOWING.settled_frames / FRAMES_PER_S


class NetworkRecognizer:
    """A `PreparingRecognizer` of phonemes; accepts any rate and block size, gaps count as silence.

    Where words are given it is a `TextFollower`: phonemes found in the text are reported as early
    as recognised ones, but are final later, when the network's last head has scored them. A motion
    with look-ahead waits as long anyway; so recognised ones too are final up to 20 ms later than
    they are due (`patience_frames`).

    latency_s: 25 ms plus the frames that a head of the network waits, or more; ValueError for less.
    Only phonemes that are not final are revised. Memory stays bounded as long as `updates` is
    called. settings: of the decoder; None for those that fit the latency.
    """

    def __init__(
        self,
        weights: NetworkWeights,
        latency_s: float = LATENCY_S,
        settings: DecoderSettings | None = None,
    ) -> None:
        """Create the recogniser, for a stream from sound time 0; parameters as in the class."""
        self._weights = weights
        self._delay = delay_frames(latency_s)
        self._settling = self._delay + patience_frames(self._delay, weights.delays)
        self._settings = settings or (SMOOTH if self._delay > weights.delays[0] else QUICK)
        self._text: TextDecoder | None = None
        least_s = _WINDOW_S + weights.delays[0] / FRAMES_PER_S
        if latency_s < least_s - 1e-9:
            raise ValueError(f"latency_s is {latency_s} s; the network needs at least {least_s} s")
        self._own_noise: OwnNoise | None = None
        self.reset()

    @property
    def latency_s(self) -> float:
        """Seconds until a phoneme is due: at sound time t, those before t - latency_s are."""
        return _WINDOW_S + self._delay / FRAMES_PER_S

    @property
    def ahead_s(self) -> float:
        """Seconds of sound that are best given to `prepare` at once, 0.64."""
        return _AHEAD_S

    @property
    def hearing(self) -> Hearing:
        """The class of the newest final sound: speech until a pause, then noise or silence."""
        if self._decoder.is_awake:
            return "speech"
        quiet_s = (self._n_frames - self._last_noticed) / FRAMES_PER_S
        return "noise" if quiet_s < self.latency_s + _NOISE_LASTS_S else "silence"

    @property
    def moved_by(self) -> MovedBy:
        """`text` if the phonemes now final were found in a given text, `sound` if recognised."""
        return "text" if self._in_text and self._in_text[0] != OUTSIDE_TEXT else "sound"

    @property
    def saying(self) -> tuple[tuple[str, ...], int]:
        """The words around the one being spoken, and its index among them; ((), 0) without text."""
        return ((), 0) if self._text is None else self._text.saying

    def forget(self) -> None:
        """Drop the words given by `tell` that are not spoken yet."""
        if self._text is not None:
            self._text.forget()

    def tell(self, words: Sequence[PronouncedWord], behind_s: float = 0.0) -> None:
        """Add the words that come next in the sound, after all words given before.

        Raises TextError for too many words.

        behind_s: seconds of these words' sound that were fed already.
        """
        if not words:
            return
        if self._text is None:
            self._text = TextDecoder(self._posteriors.format, FRAMES_PER_S, self._n_frames)
        self._text.tell(words, behind_s)

    def reset(self) -> None:
        """Forget the stream, ready for a new one from time 0; keep the learned servo noise."""
        self._input = AudioInput()
        if self._own_noise is not None:
            self._own_noise.begin()
        self._posteriors = PosteriorStream(self._weights, self._own_noise)
        self._n_samples = 0  # at 16 kHz, that the posteriors were computed from
        self._prepared: deque[_PreparedBlock] = deque()
        self._decoder = ViterbiDecoder(self._posteriors.format, self._settling, self._settings)
        self._updates = UpdateBuilder(FRAMES_PER_S, self._delay + 1)
        self._n_frames = 0  # frames whose window was heard, those jumped over among them
        self._n_reported = 0
        self._last_noticed = -(10**9)  # the last frame that a person would have noticed
        self._evidence: list[Array32] = []  # posteriors of the frames heard since the last update
        self._settled: list[int] = []  # phonemes from the first frame not final on
        self._provisional: list[int] = []  # of later frames, scored by a head; may change
        self._text = None
        self._in_text: list[int] = []  # of the newest frames, found in the text

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """Store the speeds of the robot's servos, so that their noise is not recognised as voice.

        The noise is learned while sound is fed, and kept through `reset`.

        Parameters
        ----------
        sound_s : float
            Seconds of sound time.
        speeds_deg_s : Array
            (n_servos,) in deg/s; NaN: not known.
        """
        if self._own_noise is None:
            self._own_noise = OwnNoise(self._weights.delays[-1] + round(_AHEAD_S * FRAMES_PER_S))
            self._posteriors.use_own_noise(self._own_noise)
        self._own_noise.note_speeds(sound_s, speeds_deg_s)

    def prepare(self, blocks: Sequence[AudioBlock]) -> None:
        """Compute the scores of the blocks that will be fed next, all in one pass.

        Raises ValueError for blocks that `feed` refuses, WeightsError where the network overflows;
        after that only `reset` helps.
        """
        # Of each block: its start, frames of silence in its gap, frames skipped, frames of sound.
        samples: list[Array32] = []
        spans: list[tuple[float, int, int, int]] = []
        for block in blocks:
            silence, jump_s, sound = self._input.convert(block)
            samples += [silence, sound]
            n_silent = self._count_frames(len(silence))
            n_jumped = round(jump_s * FRAMES_PER_S)
            spans.append((block.start_s, n_silent, n_jumped, self._count_frames(len(sound))))
        until_s = blocks[-1].end_s if blocks else 0.0
        posteriors = self._posteriors.push(
            np.concatenate(samples), until_s, is_awake=self._decoder.is_awake
        )
        scores: Sequence[Array32] | Array32 = [self._decoder.silence] * len(posteriors)
        if not self._posteriors.is_silent:
            if not np.isfinite(posteriors).all():
                raise WeightsError("the weights compute no finite numbers; train them again")
            scores = self._decoder.scores(posteriors)
        noticeable = self._posteriors.noticeable
        end = 0
        for start_s, n_silent, n_jumped, n_sound in spans:
            first, middle, end = end, end + n_silent, end + n_silent + n_sound
            is_noticed = bool(noticeable[first:end].any())
            gap, heard = (
                _Frames(posteriors[span], scores[span])
                for span in (slice(first, middle), slice(middle, end))
            )
            self._prepared.append(_PreparedBlock(start_s, gap, n_jumped, heard, is_noticed))

    def feed(self, block: AudioBlock) -> None:
        """Process the next block of any size; a gap before it counts as silence.

        Raises ValueError for a block that starts before the last one's end, for another sample rate
        than the stream began with, and for another block than the one prepared.
        """
        if not self._prepared:
            self.prepare([block])
        prepared = self._prepared.popleft()
        if prepared.start_s != block.start_s:
            raise ValueError(
                f"feed() got the block of sound at {block.start_s} s, but prepare() that at "
                f"{prepared.start_s} s; feed blocks as prepared"
            )
        self._decode(prepared.silence)
        # All that the decoder still holds is silence by now.
        self._settled.extend([SILENCE_INDEX] * prepared.n_jumped)
        self._n_frames += prepared.n_jumped
        if prepared.n_jumped:
            self._evidence.clear()
        if self._text is not None:
            self._text.jump(prepared.n_jumped)
        self._decode(prepared.sound)
        if prepared.is_noticed:
            self._last_noticed = self._n_frames

    def updates(self) -> list[PhonemeUpdate]:
        """Return one update if a 25 ms frame was completed since the last call, else []."""
        if self._n_frames == self._n_reported:
            return []
        self._n_reported = self._n_frames
        n_final = self._updates.n_final
        phonemes = self._settled + self._provisional
        # Of the newest frames, phonemes found in the text replace the recognised ones.
        n_unsettled = self._settling - self._delay
        if self._text is not None:
            n_unsettled = max(n_unsettled, FOLLOWING.settled_frames - self._delay)
            for age in range(1, min(len(phonemes), len(self._in_text)) + 1):
                if self._in_text[-age] != OUTSIDE_TEXT:
                    phonemes[-age] = self._in_text[-age]
        # The newest frame's window reaches 15 ms beyond its end; one frame more has been heard.
        n_missing = self._n_frames + 1 - n_final - len(phonemes)
        phonemes += [phonemes[-1] if phonemes else SILENCE_INDEX] * n_missing
        update = self._updates.update([PHONEMES[index] for index in phonemes], n_unsettled)
        del self._settled[: self._updates.n_final - n_final]
        if self._evidence:
            # Phonemes found in a text are certain: motion is not to blend in others.
            is_recognised = all(each == OUTSIDE_TEXT for each in self._in_text)
            values = np.stack(self._evidence)
            first = self._n_frames - len(values)
            heard = FramePosteriors(FRAMES_PER_S, first, self._weights.delays, values)
            update = replace(update, evidence=heard, posteriors=heard if is_recognised else None)
        self._evidence.clear()
        return [update]

    def _count_frames(self, n_samples: int) -> int:
        """Add `n_samples` to the samples counted; return how many frames they complete."""
        n_before = _complete_frames(self._n_samples)
        self._n_samples += n_samples
        return _complete_frames(self._n_samples) - n_before

    def _decode(self, frames: "_Frames") -> None:
        """Push frames to the decoder, and to the text's decoder until its words are over.

        Settled phonemes are appended; those of newer frames, provisional and found in the text, are
        replaced.
        """
        self._evidence.extend(frames.posteriors)
        for frame in frames.scores:
            settled, self._provisional = self._decoder.push(frame)
            if settled is not None:
                self._settled.append(settled)
            self._n_frames += 1
            if self._text is not None:
                self._in_text = self._text.push(frame)
                if self._text.is_over:
                    self._text, self._in_text = None, []


@dataclass(frozen=True, slots=True)
class _Frames:
    """Posteriors of frames and the decoder's scores of them, (n, n_heads, n_phonemes) each."""

    posteriors: Array32
    scores: Sequence[Array32] | Array32


@dataclass(frozen=True, slots=True)
class _PreparedBlock:
    """The frames that a block completes, and the number of frames jumped over in a gap before it.

    In order: the silence put in place of a gap, the jump over the rest of it, the block's sound.
    is_noticed: whether a person would hear something in the block.
    """

    start_s: float
    silence: _Frames
    n_jumped: int
    sound: _Frames
    is_noticed: bool


def delay_frames(latency_s: float) -> int:
    """Return how many frames later a frame is settled, for a latency in seconds."""
    return int((latency_s - _WINDOW_S) * FRAMES_PER_S + 1e-6)


def patience_frames(delay: int, delays: tuple[int, ...]) -> int:
    """Return how many frames later than it is due a phoneme is final.

    They smooth it more, and a motion with look-ahead has not shown it by then. The quickest head
    has nothing to smooth by, and decisions of the slowest get no better (docs/decisions/ears.md).
    """
    return 2 if delays[0] < delay < delays[-1] else 0


def _complete_frames(n_samples: int) -> int:
    """Return how many 25 ms frames, one each 10 ms, are complete in `n_samples` at 16 kHz."""
    return max(0, (n_samples - WINDOW) // HOP + 1)


NETWORK = RecognizerKind(
    lambda weights, latency_s: NetworkRecognizer(find_weights(weights), latency_s)
)
