"""How soon the mouth follows a microphone, and how right it is: what a puppeteer chooses of."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from lipservo.speech.delay import Delay
from lipservo.street.motion_options import MotionOptions, make_recognizer
from lipservo_lab.bench.sync.microphone_latency import clip_to_bus_s
from lipservo_lab.evaluation.recognition.closure_hits import Closure, closure_figures, closure_hits
from lipservo_lab.evaluation.recognition.heard_motion import heard_motion
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.motion.live_synthesizer import Style
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.weights import find_weights

#: How one says how far it has got: what, number, of how many.
Advance = Callable[[str, int, int], None]
#: A recording, and the phones that are spoken in it.
Recording = tuple[Path, Sequence[PhonemeEvent]]

LOOKAHEADS_S: Final = (0.0, 0.05, 0.1)
#: Of the recogniser: the network's two heads that are quick enough.
LATENCIES_S: Final = (0.045, 0.095)
_N_TIMES: Final = 20


def microphone_table(
    recordings: Sequence[Recording],
    face: TrainedModel,
    weights: str,
    accuracy: Callable[[float], Mapping[str, object]],
    advance: Advance,
    *,
    n_times: int = _N_TIMES,
) -> list[dict[str, object]]:
    """A row for each look-ahead and each recogniser.

    `declared_delay_ms` is what `run` says at its start; `microphone_to_bus_p95_ms` is measured on
    the bundled clip at `n_times` instants; the closures are those of the recordings. accuracy: more
    figures of a recogniser, by its latency in seconds, which no look-ahead changes.
    """
    n_rows = len(LATENCIES_S) * len(LOOKAHEADS_S)
    rows: list[dict[str, object]] = []
    for latency_s in LATENCIES_S:
        accurate = accuracy(latency_s)
        for lookahead_s in LOOKAHEADS_S:
            advance("table", len(rows), n_rows)
            motion = MotionOptions(
                weights=weights, style=Style(lookahead_s), recognizer_latency_s=latency_s
            )
            bus_s = clip_to_bus_s(motion, n_times)
            met = _closures(recordings, face, motion)
            rows.append(
                {
                    "lookahead_ms": _ms(lookahead_s),
                    "latency_ms": _ms(latency_s),
                    "declared_delay_ms": _ms(declared_delay_s(motion)),
                    "microphone_to_bus_p95_ms": _ms(float(np.percentile(bus_s, 95))),
                    **closure_figures(met),
                    **accurate,
                }
            )
    advance("table", n_rows, n_rows)
    return rows


def declared_delay_s(motion: MotionOptions) -> float:
    """From sound to face, as a face says it whose servos are not made up for."""
    recognizer = make_recognizer(latency_s=motion.recognizer_latency_s, weights=motion.weights)
    return Delay(recognizer.latency_s, motion.style.lookahead_s).total_s


def _closures(
    recordings: Sequence[Recording], face: TrainedModel, motion: MotionOptions
) -> list[Closure]:
    recognizer = NetworkRecognizer(find_weights(motion.weights), motion.recognizer_latency_s)
    lookahead_s = motion.style.lookahead_s
    return [
        closure
        for sound, phones in recordings
        for closure in closure_hits(
            heard_motion(sound, recognizer, face, lookahead_s), phones, face
        )
    ]


def _ms(seconds: float) -> float:
    return round(seconds * 1e3, 1)
