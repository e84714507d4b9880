"""The motion at 100 Hz that a recording causes through the live recogniser.

Also what the recogniser reports for a recording, update by update, as the mouth would get it; and
for how many of the P, B, M and F, V that are spoken, and recognised, the mouth closes.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lipservo.settings.motion_names import DEFAULT_STRATEGY
from lipservo_lab.evaluation.motion.measures import CLOSING, closes, is_bilabial
from lipservo_lab.evaluation.motion.methods import Heard, all_methods
from lipservo_lab.evaluation.recognition.recognition_scores import SLACK_FRAMES
from lipservo_lab.evaluation.recognition.stream_observers import UpdateLog
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.audio.file import FileSource
from lipsync.audio.source import SilenceAfter
from lipsync.audio_block import BLOCK_S
from lipsync.face.model import FaceModel
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import SILENCE, VISEME_OF, LiveRecognizer, PhonemeEvent
from lipsync.recognition.features import FRAMES_PER_S
from lipsync.recognition.streaming import RecognizerStream, SoundAhead
from lipsync.recognition.text_decoder import TextFollower
from lipsync.spoken_text import PronouncedWord

#: Silence after the recording, until the last phoneme is settled.
_TAIL_S = 0.5


def recognize_file(
    recognizer: LiveRecognizer, recording: Path, words: Sequence[PronouncedWord] = ()
) -> Heard:
    """Run a recogniser, which is reset, on a recording; return its updates of every 10 ms.

    words: the text, for a recogniser that follows one. Without any phoneme the result is silence.
    """
    recognizer.reset()
    if words and isinstance(recognizer, TextFollower):
        recognizer.tell(words)
    log = UpdateLog()
    stream = RecognizerStream(recognizer, (log,))
    with SilenceAfter(FileSource(recording)) as source:
        ahead = SoundAhead(source, recognizer)
        until_s = (source.duration_s or 0.0) + recognizer.latency_s + _TAIL_S
        for step in range(1, math.ceil(until_s / BLOCK_S) + 1):
            stream.feed(ahead.blocks(step * BLOCK_S))
    events = [
        PhonemeEvent(e.phoneme, e.start_s, until_s if e.end_s is None else e.end_s, e.confidence)
        for e in log.timeline.events
        if e.start_s < until_s
    ]
    if not events:
        events = [PhonemeEvent(SILENCE, 0.0, until_s)]
    return Heard(tuple(events), tuple(log.updates), recognizer.latency_s)


@dataclass(frozen=True, slots=True)
class HeardMotion:
    """The motion that a recording caused.

    faces: coefficients (n, n_components) at times_s (n,), a tick apart. spoken_s: time recognised
    as speech. heard: phonemes as finally decided. sound_s: length of the recording; the faces go on
    in half a second of silence after it.
    """

    times_s: Array
    faces: Array
    spoken_s: float
    heard: tuple[PhonemeEvent, ...]
    sound_s: float = 0.0


def heard_motion(
    recording: Path, recognizer: LiveRecognizer, model: TrainedModel, lookahead_s: float
) -> HeardMotion:
    """Run a recogniser, which is reset, on a recording, and move the face by what it recognises.

    The motion is that of the default strategy.
    """
    heard = recognize_file(recognizer, recording)
    n_ticks = round((heard.events[-1].end_s or 0.0) / TICK_S)
    times_s = np.arange(n_ticks, dtype=np.float64) * TICK_S
    spoken_s = sum(
        (event.end_s or 0.0) - event.start_s for event in heard.events if event.phoneme != SILENCE
    )
    faces = all_methods()[DEFAULT_STRATEGY].faces(model, heard, times_s, lookahead_s)
    with FileSource(recording) as source:
        return HeardMotion(times_s, faces, spoken_s, heard.events, source.duration_s)


@dataclass(frozen=True, slots=True)
class Closure:
    """A spoken phone for which the mouth must close.

    is_reached: whether the mouth closed for it. is_heard: whether a phone of its viseme class was
    recognised at its time.
    """

    phone: PhonemeEvent
    is_reached: bool
    is_heard: bool


def closure_hits(
    motion: HeardMotion, phones: Iterable[PhonemeEvent], model: FaceModel
) -> list[Closure]:
    """Return a closure for each phone that needs one, in order.

    phones: spoken in the recording. A closure is reached as in `bench motion` (docs/motion.md):
    lips at most 1 mm apart, or for F V 4.6 mm, at any instant from 40 ms before the phone to 40 ms
    after it.
    """
    gaps_mm = model.lip_gaps_mm(model.markers_mm(motion.faces))
    return [
        Closure(phone, closes(phone, motion.times_s, gaps_mm), is_heard(phone, motion.heard))
        for phone in phones
        if phone.phoneme in CLOSING
    ]


def is_heard(phone: PhonemeEvent, events: Iterable[PhonemeEvent]) -> bool:
    """Return whether a phone of the same viseme class was recognised at a phone's time.

    It may be off by `SLACK_FRAMES`, as for the recall of `bench recognition`. events: recognised.
    """

    def frames(event_or_phone: PhonemeEvent) -> tuple[int, int]:
        end_s = event_or_phone.start_s if event_or_phone.end_s is None else event_or_phone.end_s
        return round(event_or_phone.start_s * FRAMES_PER_S), round(end_s * FRAMES_PER_S)

    first, end = frames(phone)
    return any(
        VISEME_OF[event.phoneme] == VISEME_OF[phone.phoneme]
        and frames(event)[0] < end + SLACK_FRAMES
        and frames(event)[1] > first - SLACK_FRAMES
        for event in events
    )


def closure_figures(closures: Iterable[Closure]) -> dict[str, object]:
    """Return counts and shares of closures, of P B M and of F V; shares are None without any.

    Names that begin with heard_ are of recognised phones only.
    """
    figures: dict[str, object] = {}
    found = list(closures)
    for name, is_lips in (("closure", True), ("labiodental", False)):
        spoken = [c for c in found if is_bilabial(c.phone.phoneme) == is_lips]
        figures |= _counts(name, spoken)
        figures |= _counts(f"heard_{name}", [c for c in spoken if c.is_heard])
    return figures


def _counts(name: str, closures: Sequence[Closure]) -> dict[str, object]:
    n_reached = sum(c.is_reached for c in closures)
    return {
        f"{name}s": len(closures),
        f"{name}s_met": n_reached,
        f"{name}_hits": n_reached / len(closures) if closures else None,
    }
