"""The figures of `bench sync`, by the names under which they are documented.

Sentences that `bench sync` says: every P, B and M beside many neighbours.

How far lips and sound drift apart over minutes, where the sound card's clock is wrong.
"""

from typing import Final

import numpy as np

from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.runtime.motion_options import (
    MotionOptions,
    make_synthesizer,
)
from lipservo.runtime.servos.assembly import assemble_face
from lipservo.runtime.speech.speech_side import make_speech_side
from lipservo.terminal.output import Advance
from lipservo_lab.bench.sync.speaking_robot import FACE, RATE_HZ, Deaf, SimulatedLoudspeaker
from lipservo_lab.bench.sync.speech_timing import SpeechTiming, performances_of, speech_timing
from lipservo_lab.bench.sync.stream_timing import barge_in, first_seen, stuck_open_s
from lipsync.audio.playout import Playout
from lipsync.spoken_text import UnitKind
from lipsync.text_to_speech.synthesizers import synthesizer_for

SENTENCES = (
    "The ship moved past the pier before midnight.",
    "Maybe somebody left an umbrella at the museum.",
    "A hungry bear climbed the apple tree in April.",
    "Put both lamps above the piano, not below it.",
    "Remember to bring pumpkin soup for my grandmother.",
    "Nobody complained about the camping trip in May.",
    "The mayor's speech began with a simple example.",
    "He keeps a pile of broken umbrellas by the pump.",
    "Is it possible to climb that mountain by bicycle?",
    "Seven bumpy buses stopped at the empty market.",
    "My best map shows a small bridge near the camp.",
    "Keep the cabin warm and sweep up the bread crumbs.",
)


#: Found within a second of the start, the device's own latency is no drift.
_SETTLED_S: Final = 5.0
_DEVICE_HZ: Final = 8_000


def drift_s(skew: float, duration_s: float, *, jitter_s: float = 0.005) -> float:
    """Return the largest time between the sound that is shown and that which is heard, s.

    A simulated loudspeaker plays for `duration_s`. skew: how much too fast its clock runs, as a
    share; jitter_s: largest error of the times that it reports. The first `_SETTLED_S` do not
    count.
    """
    face = assemble_face(FACE, None)
    loudspeaker = SimulatedLoudspeaker(_DEVICE_HZ, 0.08, skew, jitter_s)
    playout = Playout(loudspeaker)
    synthesizer = make_synthesizer(face.model, MotionOptions())
    side = make_speech_side(face, playout, Deaf(), synthesizer, MemoryTargetChannel(), start_s=0.0)
    ticks_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    shown_s = np.empty(len(ticks_s))
    loudspeaker.advance(0.0)
    side.begin(0.0)
    for n, time_s in enumerate(ticks_s):
        loudspeaker.advance(float(time_s))
        side.advance(float(time_s))
        shown_s[n] = side.speech.sound_time_s(float(time_s))
    samples, left_at_s = loudspeaker.played()
    positions_s = np.arange(len(samples)) / _DEVICE_HZ - playout.preroll_s
    is_compared = (ticks_s > _SETTLED_S) & (ticks_s < left_at_s[-1])
    heard_s = np.interp(ticks_s[is_compared], left_at_s, positions_s)
    return float(np.abs(shown_s[is_compared] - heard_s).max())


#: The largest error of a sound card's clock.
_SKEW: Final = 200e-6
_DRIFT_DURATION_S: Final = 600.0
#: Streams whose first byte is already speech.
_OPENINGS: Final = ("Apples are here.", "My name is Bob.", "Open the door.", "Hello there.")
#: The slowest rate of a face, and that of a speech side in a process of its own.
_RATES_HZ: Final = (30.0, 100.0)
#: Of the first sentence, so long after its beginning: vowels, with the lips open.
_INTERRUPTED_AFTER_S: Final = (0.35, 0.62, 0.9, 1.3, 1.6)


def sync_figures(advance: Advance, *, quick: bool = False) -> dict[str, object]:
    """Return all figures of `bench sync`, by the names under which docs/benchmarks.md has them.

    quick: fewer sentences, and a minute of drift instead of ten. advance: called with the step's
    name, its number, and the number of steps.
    """
    voice = synthesizer_for()
    sentences = SENTENCES[:3] if quick else SENTENCES
    spoken_texts = [voice.speak(sentence) for sentence in sentences]
    steps = 6
    advance("known phonemes", 0, steps)
    known = speech_timing(spoken_texts)
    advance("what is told", 1, steps)
    kinds: tuple[UnitKind, ...] = ("phoneme", "word", "text")
    by_kind = {kind: speech_timing(spoken_texts, kind=kind) for kind in kinds}
    advance("performances", 2, steps)
    performed = speech_timing(spoken_texts, performances=performances_of(spoken_texts))
    advance("drift", 3, steps)
    minutes_s = 60.0 if quick else _DRIFT_DURATION_S
    drifts_s = [drift_s(skew, minutes_s) for skew in (-_SKEW, _SKEW)]
    advance("streams", 4, steps)
    first_seen_times = [first_seen(voice.speak(opening)) for opening in _OPENINGS]
    barge_ins = [
        barge_in(spoken_texts[0], after_s, rate_hz)
        for rate_hz in _RATES_HZ
        for after_s in _INTERRUPTED_AFTER_S
    ]
    advance("jitter", 5, steps)
    stuck_s, opening_s, n_underruns = stuck_open_s(spoken_texts, np.random.default_rng(0))
    return {
        **_timing_figures("playback", known),
        **_timing_figures("stream_phonemes", by_kind["phoneme"]),
        **_timing_figures("stream_words", by_kind["word"]),
        **_timing_figures("stream_text", by_kind["text"]),
        **_timing_figures("performed", performed),
        "drift_10min_ms": _ms(max(drifts_s)),
        "stream_first_motion_ms": _ms(max(each.motion_s for each in first_seen_times)),
        "stream_first_sound_ms": _ms(max(each.sound_s for each in first_seen_times)),
        "barge_in_ms": _ms(max(each.closed_s for each in barge_ins)),
        "played_error_ms": _ms(max(each.played_error_s for each in barge_ins)),
        "say_closure_hits": round(known.n_hits / known.n_closures, 4),
        "stuck_open_s": round(stuck_s, 3),
        "stuck_and_opening_s": round(stuck_s + opening_s, 3),
        "jitter_underruns": n_underruns,
        "sentences": len(spoken_texts),
        "drift_duration_s": minutes_s,
    }


def _timing_figures(name: str, timing: SpeechTiming) -> dict[str, object]:
    """Return one way of playing as figures in ms and shares, under names that begin with `name`."""
    error_s = np.abs(timing.errors_s)
    return {
        f"{name}_median_ms": _ms(np.median(error_s)),
        f"{name}_p95_ms": _ms(np.percentile(error_s, 95)),
        f"{name}_late_ms": _ms(np.median(timing.errors_s)),
        f"{name}_unmatched": round(timing.n_unmatched / timing.n_wanted, 4),
        f"{name}_events": timing.n_wanted,
        f"{name}_closure_hits": round(timing.n_hits / timing.n_closures, 4),
    }


def _ms(seconds: float | np.floating) -> float:
    return round(float(seconds) * 1e3, 1)
