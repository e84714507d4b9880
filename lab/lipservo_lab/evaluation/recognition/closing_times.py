"""How soon the mouth closes when a voice stops.

Recordings are cut off in the middle of a vowel, or silence is inserted before a stop consonant,
where the mouth should not close; recogniser and synthesiser run as they do live. All times are
sound time: the face that belongs to an instant of the sound. It is shown a constant time later
(`ClosingBench.delay_s`), which contains the look-ahead; so a mouth may begin to close before the
voice stops.

Everything is measured once with digital silence in the pauses and once with room noise 40 dB below
the speech throughout.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ
from lipsync.motion.finishing import Style, lip_gap_of
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.phonemes import LiveRecognizer
from lipsync.recognition.streaming import RecognizerStream, StreamStep, blocks_of

Samples = NDArray[np.float32]
#: (phoneme, first frame, frame after the last), 10 ms each.
Phones = Sequence[tuple[str, int, int]]

_VOWELS = frozenset(
    ["AA", "AE", "AH", "AO", "AW", "AY", "EH", "ER", "EY", "IH", "IY", "OW", "OY", "UH", "UW"]
)
#: Stop consonants without P and B, for which the lips do close.
_STOPS = frozenset(["T", "D", "K", "G"])
_HOP = round(BLOCK_S * SAMPLE_RATE_HZ)
#: Sound before the cut, and silence after it, s.
_BEFORE_S, _AFTER_S = 2.0, 0.8
_LEAST_BEFORE_S = 0.5
#: Cuts, and stop consonants with gaps, that are tried in each recording.
_CUTS, _STOPS_EACH = 3, 1
GAPS_S = (0.04, 0.08, 0.12)
#: A mouth that goes to rest until so long after a gap does so because of the gap.
_GAP_MARGIN_S = 0.05
_ROOM_DB = -40.0
#: Samples of the longest sound that is played.
_LONGEST = round((2 * _BEFORE_S + _AFTER_S + max(GAPS_S)) * SAMPLE_RATE_HZ)
_LEAST_VOWEL_FRAMES = 6
#: A mouth that is less open at the cut is not counted, mm beyond the gap at rest.
_LEAST_OPENING_MM = 2.0
#: Shares of the opening that are gone when closing has begun, and when it is complete.
_BEGUN, _COMPLETE = 0.1, 0.9


@dataclass(frozen=True, slots=True)
class Mouth:
    """The mouth from an instant of sound on, every 10 ms.

    opening_mm: (n,), lip gap less the one at rest; is_resting: (n,), whether the mouth is at rest
    or moving to rest.
    """

    opening_mm: Array
    is_resting: NDArray[np.bool_]


class ClosingBench:
    """A live recogniser, and a mouth that moves by what it recognises."""

    def __init__(self, recognizer: LiveRecognizer, model: TrainedModel, lookahead_s: float) -> None:
        """Connect a recogniser to a mouth of a model, with a look-ahead in s."""
        self._recognizer = recognizer
        self._synthesizer = LiveSynthesizer(
            model, model.expectation, Style(lookahead_s), soft=model.soft
        )
        self._gap = lip_gap_of(model)
        self._rest_mm = self._width_mm(model.rest)

    @property
    def delay_s(self) -> float:
        """The constant delay from sound to face, without servos, s."""
        return self._recognizer.latency_s + self._synthesizer.lookahead_s + BLOCK_S

    def watch(self, samples: Samples, from_s: float) -> Mouth:
        """Play samples (n,) to a mouth at rest; return the mouth from `from_s` to the end."""
        self._recognizer.reset()
        self._synthesizer.reset()
        n_behind = math.ceil(self.delay_s / BLOCK_S - 1e-6)
        padded = np.concatenate((samples, np.zeros(n_behind * _HOP, np.float32)))
        observer = _MouthObserver(self._synthesizer, n_behind, self.opening_mm)
        whole_blocks = padded[: len(padded) // _HOP * _HOP]
        RecognizerStream(self._recognizer, (observer,)).run(blocks_of(whole_blocks))
        first = round(from_s / BLOCK_S)
        return Mouth(np.array(observer.openings_mm[first:]), np.array(observer.resting[first:]))

    def opening_mm(self, face: Array) -> float:
        """Return the lip gap of a face beyond the one at rest.

        Parameters
        ----------
        face : Array
            (n_components,), coefficients.

        Returns
        -------
        float
            mm.
        """
        return self._width_mm(face) - self._rest_mm

    def _width_mm(self, face: Array) -> float:
        return float(np.linalg.norm(self._gap.at_mean_mm + face @ self._gap.per_face))


class _MouthObserver:
    """The mouth at each step of the recogniser's stream.

    n_behind: steps by which the mouth is later than the sound.
    """

    def __init__(
        self, synthesizer: LiveSynthesizer, n_behind: int, opening_mm: Callable[[Array], float]
    ) -> None:
        self.openings_mm: list[float] = []
        self.resting: list[bool] = []
        self._synthesizer = synthesizer
        self._opening_mm = opening_mm
        self._number = -n_behind

    def observe(self, step: StreamStep) -> None:
        """Give the mouth the updates of a step, and note its opening."""
        self._number += 1
        for update in step.updates:
            self._synthesizer.push(update)
        if self._number >= 0:
            face = self._synthesizer.frame_at(self._number * BLOCK_S).coefficients
            self.openings_mm.append(self._opening_mm(face))
            self.resting.append(self._synthesizer.is_resting)


def closing_figures(
    bench: ClosingBench,
    recordings: Iterable[tuple[Samples, Phones]],
    rng: np.random.Generator,
) -> dict[str, float]:
    """Return how soon the mouth closes where speech stops, and how often gaps close it, by name.

    Each recording is cut off in some of its vowels and gets gaps before some of its stops, once
    with digital silence there and once with room noise 40 dB below the speech throughout.
    """
    cuts: list[tuple[float, float]] = []
    is_brought_to_rest: dict[float, list[bool]] = {gap_s: [] for gap_s in GAPS_S}
    n_cuts = 0
    for samples, phones in recordings:
        room_sound = room_noise(rng, samples, _LONGEST)
        for cut_s in _drawn_instants(rng, vowel_cuts(phones), _CUTS):
            for noise in (None, room_sound):
                sound, at_s = cut_dead(samples, cut_s)
                n_cuts += 1
                times = closing_times(bench.watch(_with_noise(noise, sound), at_s).opening_mm)
                if times is not None:
                    cuts.append(times)
        for at_s in _drawn_instants(rng, stop_onsets(phones), _STOPS_EACH):
            for gap_s in GAPS_S:
                for noise in (None, room_sound):
                    sound, from_s = with_gap(samples, at_s, gap_s)
                    mouth = bench.watch(_with_noise(noise, sound), from_s)
                    n_gap = round((gap_s + _GAP_MARGIN_S) / BLOCK_S)
                    is_brought_to_rest[gap_s].append(bool(mouth.is_resting[:n_gap].any()))
    figures: dict[str, float] = {"closing_cuts": n_cuts, "closing_cuts_with_open_mouth": len(cuts)}
    for name, column in (("begins", 0), ("complete", 1)):
        times_ms = 1e3 * np.array([times[column] for times in cuts] or [math.nan])
        for percent in (50, 95, 100):
            # method="higher": infinite times cannot be interpolated.
            value = np.percentile(times_ms, percent, method="higher")
            figures[f"closing_{name}_ms_p{percent}"] = float(value)
    for gap_s, rested in is_brought_to_rest.items():
        figures[f"gap_{1e3 * gap_s:.0f}_ms_brought_to_rest"] = _share(rested)
    figures["gaps_of_each_length"] = len(is_brought_to_rest[GAPS_S[0]])
    figures["closing_delay_ms"] = 1e3 * bench.delay_s
    return figures


def _share(flags: list[bool]) -> float:
    return sum(flags) / len(flags) if flags else math.nan


def _drawn_instants(rng: np.random.Generator, instants_s: list[float], n: int) -> list[float]:
    """Draw at most n of the instants, s, that have half a second of sound before them."""
    late = [instant_s for instant_s in instants_s if instant_s >= _LEAST_BEFORE_S]
    return [float(x) for x in rng.choice(late, min(n, len(late)), replace=False)] if late else []


def room_noise(rng: np.random.Generator, samples: Samples, n: int) -> Samples:
    """Return white noise, (n,), 40 dB below a recording."""
    level = float(np.sqrt(np.mean(np.square(samples)))) * 10.0 ** (_ROOM_DB / 20.0)
    noise: Samples = np.asarray(level * rng.standard_normal(n), np.float32)
    return noise


def _with_noise(noise: Samples | None, sound: Samples) -> Samples:
    return sound if noise is None else sound + noise[: len(sound)]


def vowel_cuts(phones: Phones) -> list[float]:
    """Return the middles of all vowels of 60 ms or more, s."""
    return [
        (first + end) / 2 * BLOCK_S
        for phone, first, end in phones
        if phone in _VOWELS and end - first >= _LEAST_VOWEL_FRAMES
    ]


def stop_onsets(phones: Phones) -> list[float]:
    """Return the onsets of stop consonants (without P and B) after a vowel, s."""
    return [
        onset * BLOCK_S
        for (before, _, _), (phone, onset, _) in pairwise(phones)
        if before in _VOWELS and phone in _STOPS
    ]


def cut_dead(samples: Samples, cut_s: float) -> tuple[Samples, float]:
    """Return up to two seconds before a cut, followed by digital silence, and the time of the cut.

    cut_s: in the recording; the returned time, s, is in the returned sound.
    """
    cut = round(cut_s * SAMPLE_RATE_HZ)
    spoken = samples[max(0, cut - round(_BEFORE_S * SAMPLE_RATE_HZ)) : cut]
    silence = np.zeros(round(_AFTER_S * SAMPLE_RATE_HZ), np.float32)
    return np.concatenate((spoken, silence)), len(spoken) / SAMPLE_RATE_HZ


def with_gap(samples: Samples, at_s: float, gap_s: float) -> tuple[Samples, float]:
    """Return sound around an instant with silence inserted there, and when the silence begins, s.

    at_s: the instant in the recording; the returned time is in the returned sound.
    """
    gap_at, reach = round(at_s * SAMPLE_RATE_HZ), round(_BEFORE_S * SAMPLE_RATE_HZ)
    before, after = samples[max(0, gap_at - reach) : gap_at], samples[gap_at : gap_at + reach // 2]
    silence = np.zeros(round(gap_s * SAMPLE_RATE_HZ), np.float32)
    return np.concatenate((before, silence, after)), len(before) / SAMPLE_RATE_HZ


def closing_times(opening_mm: Array) -> tuple[float, float] | None:
    """Return when closing begins and when it is complete, s after the cut.

    Closing has begun when a tenth of the greatest opening in the 0.4 s after the cut is gone; it is
    complete when nine tenths are gone for good. Infinite: not until the end.

    Parameters
    ----------
    opening_mm : Array
        (n,), every 10 ms from the cut on.

    Returns
    -------
    tuple[float, float] | None
        Seconds; None for a mouth that was not open at the cut.
    """
    if opening_mm[0] < _LEAST_OPENING_MM:
        return None
    widest = int(opening_mm[: round(0.4 / BLOCK_S)].argmax())
    widest_mm = opening_mm[widest]
    is_falling = opening_mm[widest:] <= (1.0 - _BEGUN) * widest_mm
    if not is_falling.any():
        return math.inf, math.inf
    still_open = np.flatnonzero(opening_mm > (1.0 - _COMPLETE) * widest_mm)
    n_open = int(still_open[-1]) + 1
    complete_s = math.inf if n_open == len(opening_mm) else n_open * BLOCK_S
    return (widest + int(is_falling.argmax())) * BLOCK_S, complete_s
