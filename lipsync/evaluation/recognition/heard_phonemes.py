"""What the live recogniser makes of a recording, update by update, as the mouth would learn it."""

import math
from pathlib import Path

from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter
from lipsync.evaluation.motion.methods import Heard
from lipsync.phonemes import SILENCE, LiveRecognizer, PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline

#: Sound is fed, and updates are asked for, this often.
_STEP_S = 0.01
#: Silence after the recording, until the last phoneme is settled.
_TAIL_S = 0.5


def heard_by(recognizer: LiveRecognizer, recording: Path) -> Heard:
    """Play a recording to a fresh or reset recogniser."""
    recognizer.reset()
    timeline = PhonemeTimeline(horizon_s=math.inf)
    updates: list[PhonemeUpdate] = []
    with SilenceAfter(FileSource(recording)) as source:
        until_s = (source.duration_s or 0.0) + recognizer.latency_s + _TAIL_S
        for step in range(1, math.ceil(until_s / _STEP_S) + 1):
            for block in source.blocks(step * _STEP_S):
                recognizer.feed(block)
            for update in recognizer.updates():
                timeline.apply(update)
                updates.append(update)
    events = [
        PhonemeEvent(e.phoneme, e.start_s, until_s if e.end_s is None else e.end_s, e.confidence)
        for e in timeline.events
        if e.start_s < until_s
    ]
    if not events:
        events = [PhonemeEvent(SILENCE, 0.0, until_s)]
    return Heard(tuple(events), tuple(updates), recognizer.latency_s)
