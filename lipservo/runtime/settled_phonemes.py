"""The phonemes of a sound source, each yielded once the recogniser will not change it any more."""

import math
import time
from collections.abc import Iterator
from dataclasses import replace

from lipsync.audio.file import log_once
from lipsync.audio.source import AudioSource, SilenceAfter
from lipsync.audio_block import BLOCK_S
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.recognition.fallback import FallbackRecognizer
from lipsync.recognition.streaming import RecognizerStream, SoundAhead
from lipsync.timeline import PhonemeTimeline

#: How often a microphone is asked for what has come.
_ASK_EVERY_S = 0.02

#: Without speech for so long, a warning is logged.
_MINUTE_S = 60.0
#: Phonemes that are followed in a text become final so much later than recognised ones.
_TAIL_S = 0.15


def settled_events(source: AudioSource, recognizer: FallbackRecognizer) -> Iterator[PhonemeEvent]:
    """Yield every phoneme of a source, with start and end, once the recogniser cannot change it.

    A file is recognised to its end, as fast as the computer can. A microphone is recognised until
    the caller stops iterating; the recogniser then needs a clock, to notice that it is too slow.
    """
    length_s = source.duration_s
    sound = source if length_s is None else SilenceAfter(source)
    ahead, stream = SoundAhead(sound, recognizer), RecognizerStream(recognizer)
    end_s = math.inf if length_s is None else length_s
    timeline, settled_until_s, heard_s = PhonemeTimeline(), 0.0, 0.0
    has_spoken = False
    with sound:
        while heard_s < end_s + recognizer.latency_s + _TAIL_S:
            # A microphone gives all that has come; a file one block, and silence after its end.
            heard_s = math.inf if length_s is None else heard_s + BLOCK_S
            step = stream.feed(ahead.blocks(heard_s))
            if length_s is None:
                heard_s = step.blocks[-1].end_s if step.blocks else 0.0
                time.sleep(0.0 if step.blocks else _ASK_EVERY_S)
            for update in step.updates:
                timeline.apply(update)
            for event in _final_events(timeline, settled_until_s, end_s):
                settled_until_s = event.end_s or settled_until_s
                has_spoken |= event.phoneme != SILENCE
                yield event
            if not has_spoken and settled_until_s >= min(end_s, _MINUTE_S) - BLOCK_S:
                has_spoken = True  # so that the warning is logged once
                log_once(
                    f"{source.name}: no speech in {settled_until_s:.0f} s; the mouth stays at "
                    "rest: check file, --channel and level"
                )


def _final_events(
    timeline: PhonemeTimeline, settled_until_s: float, length_s: float
) -> Iterator[PhonemeEvent]:
    """Yield the timeline's final phonemes that end after `settled_until_s`, cut at `length_s`.

    settled_until_s: end of the last phoneme yielded before. length_s: length of the sound; inf: not
    known.
    """
    for event in timeline.events:
        end_s = min(math.inf if event.end_s is None else event.end_s, length_s)
        if end_s <= settled_until_s + 1e-9 or event.start_s >= length_s:
            continue
        # A phoneme that lasts until `final_until_s` may get longer, but not beyond the sound's end.
        if end_s < timeline.final_until_s - 1e-9 or timeline.final_until_s >= length_s:
            yield replace(event, end_s=end_s)
