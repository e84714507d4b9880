"""Lips against sound at the encoders, of what a synthesiser says and knows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from lipservo_lab.bench.sync.closure_events import (
    matched_errors_s,
    seen_closures,
    sounding_closures,
)
from lipservo_lab.bench.sync.performed_texts import performed_stream
from lipservo_lab.bench.sync.simulated_loudspeaker import SimulatedLoudspeaker
from lipservo_lab.bench.sync.speaking_robot import SpeakingRobot, Watched, spoken_stream
from lipsync.arrays import Array
from lipsync.audio.playout_events import PlayoutRequest
from lipsync.markers import CLOSED_GAP_MM
from lipsync.motion.closure_plan import BILABIALS
from lipsync.offline.performance import Performance
from lipsync.phonemes import PhonemeEvent
from lipsync.text_to_speech.spoken_text import SpokenText

#: A closure hit (docs/motion.md): closed from 40 ms before the phoneme to 40 ms after it.
_WINDOW_S: Final = 0.040
#: How much the figures owe to what counts as closed.
_OTHER_GAPS_MM: Final = (0.9, 1.5, 2.0, 3.0)
#: Of full scale; an onset passes it within a millisecond or two.
_LOUD: Final = 0.02
#: The face is brought up, the sound is late, and the mouth goes to rest at the end.
_AROUND_S: Final = 2.5


@dataclass(frozen=True, slots=True)
class SpeechTiming:
    """Of all sentences: how much later lips close and part than the sound says, seconds.

    n_asked, n_unmatched: closings and partings together. n_closures, n_hits: of P B M.
    errors_by_closed_mm_s: the same errors where lips count as closed at another gap.
    """

    errors_s: Array
    n_asked: int
    n_unmatched: int
    n_closures: int
    n_hits: int
    errors_by_closed_mm_s: Mapping[float, Array]


def speech_timing(
    texts: Sequence[SpokenText],
    *,
    knows: bool,
    performances: Sequence[Performance] | None = None,
    loudspeaker_seed: int = 0,
) -> SpeechTiming:
    """Say each by a robot of its own. knows: the phonemes come with the sound; else it listens.

    performances: of the texts, which are performed then.

    Every loudspeaker is another: its latency 20 to 120 ms, its clock up to 200 parts in a million
    off, its reports up to 5 ms.
    """
    rendered = [None] * len(texts) if performances is None else performances
    rng = np.random.default_rng(loudspeaker_seed)
    errors_s: list[Array] = []
    others_s: dict[float, list[Array]] = {closed_mm: [] for closed_mm in _OTHER_GAPS_MM}
    n_asked = n_unmatched = n_closures = n_hits = 0
    for text, performance in zip(texts, rendered, strict=True):
        watched, sound_s = _said(text, _loudspeaker(rng), performance, knows=knows)
        times_s = watched.times_s - sound_s
        asked, seen = sounding_closures(text), seen_closures(times_s, watched.gap_mm)
        for asked_s, seen_s in (
            (asked.closing_s, seen.closing_s),
            (asked.parting_s, seen.parting_s),
        ):
            late_s, n_missing = matched_errors_s(asked_s, seen_s)
            errors_s.append(late_s)
            n_asked += len(asked_s)
            n_unmatched += n_missing
        for closed_mm, found_s in others_s.items():
            other = seen_closures(times_s, watched.gap_mm, closed_mm)
            found_s.append(matched_errors_s(asked.closing_s, other.closing_s)[0])
            found_s.append(matched_errors_s(asked.parting_s, other.parting_s)[0])
        hits = _closure_hits(text.phonemes, times_s, watched.gap_mm)
        n_closures += len(hits)
        n_hits += sum(hits)
    by_gap_s = {closed_mm: np.concatenate(found_s) for closed_mm, found_s in others_s.items()}
    return SpeechTiming(
        np.concatenate(errors_s), n_asked, n_unmatched, n_closures, n_hits, by_gap_s
    )


def _loudspeaker(rng: np.random.Generator) -> SimulatedLoudspeaker:
    return SimulatedLoudspeaker(
        latency_s=float(rng.uniform(0.02, 0.12)),
        skew=float(rng.uniform(-200e-6, 200e-6)),
        jitter_s=0.005,
        rng=rng,
    )


def _said(
    text: SpokenText,
    loudspeaker: SimulatedLoudspeaker,
    performance: Performance | None,
    *,
    knows: bool,
) -> tuple[Watched, float]:
    """What was seen, and when the first sample of the text left the loudspeaker."""
    robot = SpeakingRobot(loudspeaker, hears=not knows, performance=performance)
    if performance is None:
        stream = spoken_stream(text, robot.playout, knows=knows)
    else:
        stream = performed_stream(text, performance, robot.playout)
    robot.playout.requests.append(PlayoutRequest("say", stream))
    watched = robot.run(text.duration_s + _AROUND_S)
    return watched, first_sample_s(text, loudspeaker)


def first_sample_s(text: SpokenText, loudspeaker: SimulatedLoudspeaker) -> float:
    """When a text's first sample left the loudspeaker.

    The loudspeaker's samples are counted, not its reports believed. The first loud one tells:
    quieter ones may be a resampler's ringing.
    """
    samples, times_s = loudspeaker.played()
    began = int(np.flatnonzero(np.abs(samples) > _LOUD)[0])
    wanted = int(np.flatnonzero(np.abs(text.samples) > _LOUD)[0])
    return float(times_s[began]) - wanted / text.sample_rate_hz


def _closure_hits(phonemes: Sequence[PhonemeEvent], times_s: Array, gap_mm: Array) -> list[bool]:
    hits = []
    for event in phonemes:
        if event.phoneme not in BILABIALS or event.end_s is None:
            continue
        near = (times_s >= event.start_s - _WINDOW_S) & (times_s <= event.end_s + _WINDOW_S)
        hits.append(bool(gap_mm[near].min(initial=np.inf) <= CLOSED_GAP_MM))
    return hits
