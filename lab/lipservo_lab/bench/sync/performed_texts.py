"""What a synthesiser says, rendered as `render` does, and said as `perform` does."""

from collections.abc import Sequence

import numpy as np
import soxr

from lipservo.rendering.rendered import load_speaker, rendered_faces
from lipservo.speech.performed_line import line_of
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutStream
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.offline.line_methods import DEFAULT_METHOD, Line
from lipsync.offline.performance import Performance, PerformedSound
from lipsync.text_to_speech.spoken_text import SpokenText


def performances_of(texts: Sequence[SpokenText]) -> list[Performance]:
    """Of each text, by the shipped models and the default method, its phonemes known."""
    return [_performance(text) for text in texts]


def performed_stream(text: SpokenText, performance: Performance, playout: Playout) -> PlayoutStream:
    """The whole line as a stream that has ended."""
    line = line_of(performance, "text", text.samples, text.sample_rate_hz)
    stream = line.stream(playout)
    for chunk in line.chunks():
        stream.push(chunk)
    stream.end()
    return stream


def _performance(text: SpokenText) -> Performance:
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
