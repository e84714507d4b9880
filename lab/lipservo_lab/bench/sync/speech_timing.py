"""Lips against sound at the encoders, of what a synthesiser says and knows.

When lips close and part, against when the sound says that they do.

A synthesiser's speech, rendered as `render` does, and played as `perform` does.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import soxr

from lipservo.rendering.rendered import load_speaker, rendered_faces
from lipservo.runtime.speech.performed_line import line_of
from lipservo_lab.bench.sync.speaking_robot import (
    SimulatedLoudspeaker,
    SpeakingRobot,
    Watched,
    spoken_stream,
)
from lipsync.arrays import Array
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.markers import CLOSED_GAP_MM
from lipsync.motion.finishing import BILABIALS
from lipsync.offline.line_methods import DEFAULT_METHOD, Line
from lipsync.offline.performance import Performance, PerformedSound
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.spoken_text import UnitKind
from lipsync.text_to_speech.synthesis import SynthesizedSpeech

#: An event belongs to the nearest of its kind within this time.
MATCHED_S: Final = 0.200
#: Of full scale; a synthesiser's closures are silent to the last bit or two.
_SILENT: Final = 0.002
_LEAST_CLOSURE_S: Final = 0.010


@dataclass(frozen=True, slots=True)
class Crossings:
    """When lips close and when they part, seconds in ascending order, (n,) and (m,)."""

    closing_s: Array
    parting_s: Array


def sounding_closures(text: SynthesizedSpeech) -> Crossings:
    """Return when lips should close and part: from the onset of each P, B, M to its release.

    The release is where the closure's silence ends, at the burst; without silence the end of the
    phoneme. Neighbouring P, B, M are one closure. Beside a silence lips may rest closed: there no
    closing or parting is wanted.
    """
    phonemes = text.phonemes
    closing_s: list[float] = []
    parting_s: list[float] = []
    previous = SILENCE
    next_phonemes = [*(each.phoneme for each in phonemes[1:]), SILENCE]
    for event, next_phoneme in zip(phonemes, next_phonemes, strict=True):
        if event.phoneme in BILABIALS:
            if previous not in (*BILABIALS, SILENCE):
                closing_s.append(event.start_s)
            if next_phoneme not in (*BILABIALS, SILENCE) and event.end_s is not None:
                parting_s.append(_release_s(text, event.start_s, event.end_s))
        previous = event.phoneme
    return Crossings(np.array(closing_s), np.array(parting_s))


def _release_s(text: SynthesizedSpeech, start_s: float, end_s: float) -> float:
    """Return the second at which a closure's longest silence within a phoneme ends: the burst.

    The phoneme's end where it has no silence of `_LEAST_CLOSURE_S`.
    """
    first = round(start_s * text.sample_rate_hz)
    is_sounding = np.abs(text.samples[first : round(end_s * text.sample_rate_hz)]) >= _SILENT
    # The longest stretch without sound: from one sample that sounds to the next.
    sounding_samples = np.concatenate(([-1], np.flatnonzero(is_sounding)))
    gap_lengths = np.diff(sounding_samples)
    if len(gap_lengths) == 0 or gap_lengths.max() < _LEAST_CLOSURE_S * text.sample_rate_hz:
        return end_s
    return start_s + float(sounding_samples[int(gap_lengths.argmax()) + 1]) / text.sample_rate_hz


def seen_closures(times_s: Array, gap_mm: Array, closed_mm: float = CLOSED_GAP_MM) -> Crossings:
    """Return when the lip gap crossed `closed_mm`, interpolated linearly between samples.

    Parameters
    ----------
    times_s,gap_mm : Array
        (n,), the lip gap over time.
    closed_mm : float
        Lips with a smaller gap are closed.

    Returns
    -------
    Crossings
        Closings and partings in s.
    """
    is_closed = gap_mm < closed_mm
    last_before = np.flatnonzero(is_closed[1:] != is_closed[:-1])
    fraction = (closed_mm - gap_mm[last_before]) / (gap_mm[last_before + 1] - gap_mm[last_before])
    at_s = times_s[last_before] + fraction * (times_s[last_before + 1] - times_s[last_before])
    return Crossings(at_s[is_closed[last_before + 1]], at_s[~is_closed[last_before + 1]])


def matched_errors_s(wanted_s: Array, seen_s: Array) -> tuple[Array, int]:
    """Return how much later wanted events were seen, and how many were not seen.

    Each wanted event is matched to the nearest one seen, at most `MATCHED_S` away.

    Parameters
    ----------
    wanted_s : Array
        (n,), times of the wanted events.
    seen_s : Array
        (m,), times of the events seen.

    Returns
    -------
    tuple[Array, int]
        Delays of those matched, (n_matched,) s, and the number of the others.
    """
    if len(seen_s) == 0 or len(wanted_s) == 0:
        return np.zeros(0), len(wanted_s)
    late_s = seen_s[None] - wanted_s[:, None]
    nearest_s = late_s[np.arange(len(wanted_s)), np.abs(late_s).argmin(axis=1)]
    is_matched = np.abs(nearest_s) <= MATCHED_S
    return nearest_s[is_matched], int(np.sum(~is_matched))


def performances_of(texts: Sequence[SynthesizedSpeech]) -> list[Performance]:
    """Render each text with the shipped models and the default method, its phonemes known."""
    return [_render_text(text) for text in texts]


def performed_stream(
    text: SynthesizedSpeech, performance: Performance, playout: Playout
) -> PlayoutStream:
    """Return a rendered line as a stream that has ended. text: its sound."""
    line = line_of(performance, "text", text.samples, text.sample_rate_hz)
    stream = line.stream(playout)
    for chunk in line.chunks():
        stream.push(chunk)
    stream.end()
    return stream


def _render_text(text: SynthesizedSpeech) -> Performance:
    """Return a text rendered with the shipped models as a performance, its phonemes known."""
    speaker = load_speaker(None, None)
    samples = soxr.resample(text.samples, text.sample_rate_hz, SAMPLE_RATE_HZ)
    faces, _ = rendered_faces(speaker, Line(text.phonemes, samples), DEFAULT_METHOD)
    return Performance(
        speaker.face.checksum,
        faces.astype(np.float32),
        text.phonemes,
        PerformedSound("text", "", None),
        DEFAULT_METHOD,
    )


#: A closure hit (docs/motion.md): closed from 40 ms before the phoneme to 40 ms after it.
_WINDOW_S: Final = 0.040
#: Of full scale; an onset passes it within a millisecond or two.
_LOUD: Final = 0.02
#: The face is brought up, the sound is late, and the mouth goes to rest at the end.
_AROUND_S: Final = 2.5


@dataclass(frozen=True, slots=True)
class SpeechTiming:
    """Timing of the lips in all sentences.

    errors_s: how much later lips close and part than they should by the sound, (n_matched,).
    n_wanted, n_unmatched: closings and partings together. n_closures, n_hits: P, B and M, and those
    of them with closed lips.
    """

    errors_s: Array
    n_wanted: int
    n_unmatched: int
    n_closures: int
    n_hits: int


def speech_timing(
    texts: Sequence[SynthesizedSpeech],
    *,
    kind: UnitKind | None = None,
    performances: Sequence[Performance] | None = None,
) -> SpeechTiming:
    """Let a simulated robot speak each text; return how late its lips close and part.

    kind: of the units sent beside the stream, while the robot recognises phonemes; None: the text's
    phonemes come with the sound. performances: rendered motion of the texts, which is played
    instead.

    Loudspeakers are drawn: latency 20 to 120 ms, a clock up to 200 parts in a million off, reports
    up to 5 ms off.
    """
    performance_of_text = [None] * len(texts) if performances is None else performances
    rng = np.random.default_rng(0)
    errors_s: list[Array] = []
    n_wanted = n_unmatched = n_closures = n_hits = 0
    for text, performance in zip(texts, performance_of_text, strict=True):
        watched, sound_s = _speak_text(text, _loudspeaker(rng), performance, kind)
        times_s = watched.times_s - sound_s
        wanted, seen = sounding_closures(text), seen_closures(times_s, watched.gap_mm)
        for wanted_s, seen_s in (
            (wanted.closing_s, seen.closing_s),
            (wanted.parting_s, seen.parting_s),
        ):
            errors_of_kind_s, n_missing = matched_errors_s(wanted_s, seen_s)
            errors_s.append(errors_of_kind_s)
            n_wanted += len(wanted_s)
            n_unmatched += n_missing
        hits = _closure_hits(text.phonemes, times_s, watched.gap_mm)
        n_closures += len(hits)
        n_hits += sum(hits)
    return SpeechTiming(np.concatenate(errors_s), n_wanted, n_unmatched, n_closures, n_hits)


def _loudspeaker(rng: np.random.Generator) -> SimulatedLoudspeaker:
    return SimulatedLoudspeaker(
        latency_s=float(rng.uniform(0.02, 0.12)),
        skew=float(rng.uniform(-200e-6, 200e-6)),
        jitter_s=0.005,
        rng=rng,
    )


def _speak_text(
    text: SynthesizedSpeech,
    loudspeaker: SimulatedLoudspeaker,
    performance: Performance | None,
    kind: UnitKind | None,
) -> tuple[Watched, float]:
    """Let a robot speak a text; return what it did, and when the text's first sample was played, s.

    performance: rendered motion to play; None: motion is made live. kind: as in `speech_timing`.
    """
    robot = SpeakingRobot(loudspeaker, is_listening=kind is not None, performance=performance)
    if performance is None:
        stream = spoken_stream(text, robot.playout, knows=kind is None, kind=kind)
    else:
        stream = performed_stream(text, performance, robot.playout)
    robot.playout.requests.append(PlayoutRequest("say", stream))
    watched = robot.run(text.duration_s + _AROUND_S)
    return watched, first_sample_s(text, loudspeaker)


def first_sample_s(text: SynthesizedSpeech, loudspeaker: SimulatedLoudspeaker) -> float:
    """Return when the loudspeaker played a text's first sample, s (monotonic).

    Found from the first loud sample, since quieter ones may be a resampler's ringing; the
    loudspeaker's reports are not used, for they have errors.
    """
    samples, times_s = loudspeaker.played()
    first_loud = int(np.flatnonzero(np.abs(samples) > _LOUD)[0])
    first_loud_of_text = int(np.flatnonzero(np.abs(text.samples) > _LOUD)[0])
    return float(times_s[first_loud]) - first_loud_of_text / text.sample_rate_hz


def _closure_hits(phonemes: Sequence[PhonemeEvent], times_s: Array, gap_mm: Array) -> list[bool]:
    """Return for each P, B and M whether lips closed during it or `_WINDOW_S` beside it.

    times_s, gap_mm: (n,), lip gap over the sound's time.
    """
    hits = []
    for event in phonemes:
        if event.phoneme not in BILABIALS or event.end_s is None:
            continue
        near = (times_s >= event.start_s - _WINDOW_S) & (times_s <= event.end_s + _WINDOW_S)
        hits.append(bool(gap_mm[near].min(initial=np.inf) <= CLOSED_GAP_MM))
    return hits
