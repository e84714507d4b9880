"""Everything that `lipservo bench face` prints."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path

from lipservo_lab.bench.face.page_ready import page_ready_s
from lipservo_lab.bench.face.play_queue import play_figures
from lipservo_lab.bench.face.served_head import served_head
from lipservo_lab.bench.face.streams import stream_figures
from lipservo_lab.bench.face.twin_figures import twin_figures
from lipservo_lab.evaluation.expression.expression_figures import expression_figures
from lipsync.audio.file import FileSource
from lipsync.expression.live_expression import LiveExpression
from lipsync.face.model import load_face
from lipsync.prosody.voice_frame import VoiceFrame
from lipsync.prosody.voice_tracker import VoiceTracker

Progress = Callable[[str, int, int], None]


def face_figures(voices: Sequence[Path], seconds: float, progress: Progress) -> dict[str, object]:
    """Twin, streams, plays, expression, page. voices: sound files of one speaker or several.

    Without one, the bundled clip speaks. seconds: how long each window of the streams takes.
    """
    figures: dict[str, object] = dict(asdict(twin_figures(load_face())))
    progress("twin", 1, 1)
    figures |= stream_figures(seconds, lambda done, of: progress("streams", done, of))
    figures |= play_figures(seconds)
    progress("plays", 1, 1)
    frames, step_ms = heard(voices)
    figures |= asdict(expression_figures(lambda: LiveExpression(1), frames))
    figures["voice_step_ms"] = step_ms
    progress("expression", 1, 1)
    with served_head() as address:
        figures["page_ready_s"] = page_ready_s(address, times=5)
    progress("page", 1, 1)
    return figures


def heard(voices: Sequence[Path]) -> tuple[list[VoiceFrame], float]:
    """What a tracker says of sound files, one after the other, and its median time for 10 ms, ms.

    Without a file, of the bundled clip. Raises SoundError.
    """
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        frames, took_s = [], []
        tracker = VoiceTracker()
        for path in voices or [clip]:
            with FileSource(path) as source:
                for block in source.blocks(float("inf")):
                    begun_s = time.perf_counter()
                    frames.append(tracker.feed(block.samples))
                    took_s.append(time.perf_counter() - begun_s)
    return frames, 1e3 * statistics.median(took_s)
