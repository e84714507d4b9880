"""How soon the mouth closes when a voice stops, and whether a stop gap in a word closes it too.

Recordings are cut dead in the middle of a vowel, or silence is put before a stop consonant, and
recogniser and synthesiser run as they do live. All times are sound time: the face that belongs to
an instant of the sound. Shown it is a constant later (`Closing.delay_s`), in which the look-ahead
was spent; so a mouth may begin to close before the voice stops.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.animpho.closure import lip_gap_of
from lipsync.animpho.live import LiveSynthesizer, Style
from lipsync.animpho.model import FaceModel
from lipsync.audio.block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock
from lipsync.phonemes import LiveRecognizer

Array = NDArray[np.float64]
Samples = NDArray[np.float32]
#: (phoneme, first frame, frame after the last), 10 ms each.
Phones = Sequence[tuple[str, int, int]]

_VOWELS = frozenset("AA AE AH AO AW AY EH ER EY IH IY OW OY UH UW".split())
#: P and B are stops too, but there the lips do close.
_STOPS = frozenset("T D K G".split())
_HOP = round(BLOCK_S * SAMPLE_RATE_HZ)
#: Heard before the cut, and silence after it.
_BEFORE_S, _AFTER_S = 2.0, 0.8
_LEAST_VOWEL_FRAMES = 6
#: A mouth less open than this at the cut has nothing to close, mm beyond the gap at rest.
_LEAST_OPENING_MM = 2.0
#: Closing has begun, and is complete, when so much of the opening is gone.
_BEGUN, _COMPLETE = 0.1, 0.9


class SpeakingRecognizer(LiveRecognizer, Protocol):
    """A recogniser that says whether somebody speaks."""

    @property
    def is_speaking(self) -> bool:
        """Whether speech is going on."""


@dataclass(frozen=True, slots=True)
class Mouth:
    """What the mouth does after an instant of sound.

    opening_mm (n,): lip gap beyond the one at rest, every 10 ms from the instant on; is_speaking
    (n,): the recogniser's voice activity when that much sound was heard.
    """

    opening_mm: Array
    is_speaking: NDArray[np.bool_]


class ClosingBench:
    """A recogniser and a mouth to be watched."""

    def __init__(self, recognizer: SpeakingRecognizer, model: FaceModel, lookahead_s: float) -> None:
        self._recognizer = recognizer
        self._synthesizer = LiveSynthesizer(model, Style(lookahead_s))
        self._gap = lip_gap_of(model)
        self._rest_mm = self._width_mm(model.rest)

    @property
    def delay_s(self) -> float:
        """How much later than its sound a face is known: the constant part, servos apart."""
        return self._recognizer.latency_s + self._synthesizer.lookahead_s + BLOCK_S

    def watch(self, samples: Samples, from_s: float) -> Mouth:
        """Play samples (n,) from silence on; the mouth from `from_s` to the end."""
        self._recognizer.reset()
        self._synthesizer.reset()
        openings, speaking = [], []
        n_behind = math.ceil(self.delay_s / BLOCK_S - 1e-6)
        padded = np.concatenate((samples, np.zeros(n_behind * _HOP, np.float32)))
        for number in range(len(padded) // _HOP):
            start = number * _HOP
            self._recognizer.feed(AudioBlock(padded[start : start + _HOP], start / SAMPLE_RATE_HZ))
            for update in self._recognizer.updates():
                self._synthesizer.push(update)
            speaking.append(self._recognizer.is_speaking)
            if number + 1 >= n_behind:
                face = self._synthesizer.coefficients_at((number + 1 - n_behind) * BLOCK_S)
                openings.append(self._width_mm(face) - self._rest_mm)
        # Openings are those at 0, 10, 20 ms; the activity is that after 10, 20, 30 ms of sound.
        first = round(from_s / BLOCK_S)
        n = len(openings)
        return Mouth(np.array(openings[first:]), np.array(speaking[first - 1 : n - 1]))

    def _width_mm(self, face: Array) -> float:
        return float(np.linalg.norm(self._gap.at_mean_mm + face @ self._gap.per_face))


def vowel_cuts(phones: Phones) -> list[float]:
    """The middles of all long enough vowels, s."""
    return [
        (first + end) / 2 * BLOCK_S
        for phone, first, end in phones
        if phone in _VOWELS and end - first >= _LEAST_VOWEL_FRAMES
    ]


def stop_onsets(phones: Phones) -> list[float]:
    """Where a stop consonant follows a vowel, s."""
    return [
        onset * BLOCK_S
        for (before, _, _), (phone, onset, _) in zip(phones, phones[1:], strict=False)
        if before in _VOWELS and phone in _STOPS
    ]


def cut_dead(samples: Samples, cut_s: float) -> tuple[Samples, float]:
    """The last two seconds before the cut, then digital silence; and where in it the cut is, s."""
    cut = round(cut_s * SAMPLE_RATE_HZ)
    spoken = samples[max(0, cut - round(_BEFORE_S * SAMPLE_RATE_HZ)) : cut]
    silence = np.zeros(round(_AFTER_S * SAMPLE_RATE_HZ), np.float32)
    return np.concatenate((spoken, silence)), len(spoken) / SAMPLE_RATE_HZ


def with_gap(samples: Samples, at_s: float, gap_s: float) -> tuple[Samples, float]:
    """Two seconds around an instant with silence put in there; and where the gap begins, s."""
    at, reach = round(at_s * SAMPLE_RATE_HZ), round(_BEFORE_S * SAMPLE_RATE_HZ)
    before, after = samples[max(0, at - reach) : at], samples[at : at + reach // 2]
    silence = np.zeros(round(gap_s * SAMPLE_RATE_HZ), np.float32)
    return np.concatenate((before, silence, after)), len(before) / SAMPLE_RATE_HZ


def closing_times(opening_mm: Array) -> tuple[float, float] | None:
    """When closing begins and when it is complete, s after the cut at index 0.

    Begun: a tenth of the greatest opening since the cut is gone; complete: nine tenths are, and
    stay away. None for a mouth that was not open at the cut.
    """
    if opening_mm[0] < _LEAST_OPENING_MM:
        return None
    widest = int(opening_mm[: round(0.4 / BLOCK_S)].argmax())
    most_mm = opening_mm[widest]
    is_falling = opening_mm[widest:] <= (1.0 - _BEGUN) * most_mm
    if not is_falling.any():
        return math.inf, math.inf
    open_ones = np.flatnonzero(opening_mm > (1.0 - _COMPLETE) * most_mm)
    n_open = int(open_ones[-1]) + 1
    complete_s = math.inf if n_open == len(opening_mm) else n_open * BLOCK_S
    return (widest + int(is_falling.argmax())) * BLOCK_S, complete_s
