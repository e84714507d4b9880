"""What the live recogniser gives for a recording, update by update, as the mouth would get it."""

import math
from pathlib import Path

from lipservo_lab.evaluation.motion.methods import Heard
from lipservo_lab.evaluation.recognition.stream_observers import UpdateLog
from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter
from lipsync.audio_block import BLOCK_S
from lipsync.phonemes import SILENCE, LiveRecognizer, PhonemeEvent
from lipsync.recognition.streaming import RecognizerStream, SoundAhead

#: Silence after the recording, until the last phoneme is settled.
_TAIL_S = 0.5


def recognize_file(recognizer: LiveRecognizer, recording: Path) -> Heard:
    """Play a recording to a recogniser, which is reset; updates are asked for every 10 ms."""
    recognizer.reset()
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
