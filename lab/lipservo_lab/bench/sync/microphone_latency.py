"""From a sample at the microphone to the first goal that depends on it, on a virtual clock.

How soon the mouth follows a microphone, and how right it is: what a puppeteer chooses of.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.clock import ManualClock, ticks
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import assemble_face
from lipservo.runtime.speech.speech import Delay
from lipservo.runtime.street import make_street
from lipservo.terminal.output import Advance
from lipservo_lab.bench.sync.speaking_robot import FACE, RATE_HZ
from lipservo_lab.evaluation.recognition.heard_motion import (
    Closure,
    closure_figures,
    closure_hits,
    heard_motion,
)
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.audio.file import FileSource
from lipsync.audio.source import BLOCK_SAMPLES
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock
from lipsync.motion.finishing import Style
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.network import find_weights
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.recognizers import make_recognizer

#: A piece of 10 ms is handed over when it is full and has passed the driver.
_DRIVER_S: Final = 0.010
_SAME_DEG: Final = 1e-6
#: Of the bundled clip, so much is enough.
_CLIP_S: Final = 3.0


class SimulatedMicrophone:
    """A live `AudioSource` of known samples (n,) at 16 kHz, on a virtual clock."""

    name, duration_s, is_live, lost_blocks = "simulated microphone", None, True, 0

    def __init__(self, samples: NDArray[np.float32], clock: ManualClock) -> None:
        self._samples = samples
        self._clock = clock
        self._n_given = 0

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Return the blocks that have passed the driver by now, whatever `until_s`."""
        del until_s
        n_ready = math.floor((self._clock.now() - _DRIVER_S) / BLOCK_S + 1e-6)
        n_ready = min(n_ready, len(self._samples) // BLOCK_SAMPLES)
        n_before, self._n_given = self._n_given, max(self._n_given, n_ready)
        return [
            AudioBlock(self._samples[n * BLOCK_SAMPLES : (n + 1) * BLOCK_SAMPLES], n * BLOCK_S)
            for n in range(n_before, self._n_given)
        ]

    def __enter__(self) -> "SimulatedMicrophone":
        return self

    def __exit__(self, *exc: object) -> None:
        """Release nothing."""


def clip_to_bus_s(motion: MotionOptions, n_times: int) -> Array:
    """Return `microphone_to_bus_s` of the bundled clip, at the same random instants each time.

    Parameters
    ----------
    motion : MotionOptions
        How motion is made.
    n_times : int
        Number of instants.

    Returns
    -------
    Array
        (n,) s.
    """
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        blocks = FileSource(clip).blocks(_CLIP_S)
    samples = np.concatenate([block.samples for block in blocks])
    duration_s = len(samples) / SAMPLE_RATE_HZ
    times_s = np.sort(np.random.default_rng(0).uniform(0.5, duration_s - 0.5, n_times))
    return microphone_to_bus_s(samples, times_s.tolist(), motion)


def microphone_to_bus_s(
    samples: NDArray[np.float32], changed_s: Sequence[float], motion: MotionOptions
) -> Array:
    """Return how long after an instant of the sound the first goal is sent that depends on it.

    The sound is played twice, the second time silent from that instant on; the delay is up to the
    first tick whose goals differ. Instants after which no goal differs within a second are left
    out.

    Parameters
    ----------
    samples : NDArray[np.float32]
        (m,) at 16 kHz.
    changed_s : Sequence[float]
        The instants, sound time.
    motion : MotionOptions
        How motion is made.

    Returns
    -------
    Array
        (n,) s.
    """
    whole_deg = _goals_deg(samples, motion)
    delays_s = []
    for silent_from_s in changed_s:
        first_sample = round(silent_from_s * SAMPLE_RATE_HZ)
        silenced = samples[: first_sample + SAMPLE_RATE_HZ].copy()
        silenced[first_sample:] = 0.0
        silenced_deg = _goals_deg(silenced, motion)
        n = min(len(silenced_deg), len(whole_deg))
        is_different = (np.abs(silenced_deg[:n] - whole_deg[:n]) > _SAME_DEG).any(axis=1)
        if is_different.any():
            delays_s.append(int(is_different.argmax()) / RATE_HZ - silent_from_s)
    return np.array(delays_s)


def _goals_deg(samples: NDArray[np.float32], motion: MotionOptions) -> Array:
    """Return the goals sent in each tick from the first sample on, (n_ticks, n_servos) degrees."""
    face = assemble_face(FACE, None)
    clock = ManualClock()
    recognizer = make_recognizer(motion.engine, None, motion.weights, motion.recognizer_latency_s)
    synthesizer = make_synthesizer(face.model, motion)
    sent_deg: list[Array] = []
    with SimulatedBus(face.joints, clock) as bus:
        source = SimulatedMicrophone(samples, clock)
        street = make_street(face, source, bus, RATE_HZ, recognizer, synthesizer)
        street.bridge.start(lambda: True)
        street.begin(clock.now())
        for time_s, late in ticks(clock, RATE_HZ):
            sent_deg.append(street.tick(time_s, late).report.sent_deg)
            if time_s > len(samples) / SAMPLE_RATE_HZ:
                break
    return np.array(sent_deg)


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
    """Return a row of delays and closures for each recogniser latency and look-ahead.

    `declared_delay_ms` is what `run` prints at its start; `microphone_to_bus_p95_ms` is measured on
    the bundled clip at `n_times` instants; closures are those of `recordings`, played by `face`.
    weights: of the recogniser. accuracy: returns further figures of a recogniser by its latency, s.
    """
    n_rows = len(LATENCIES_S) * len(LOOKAHEADS_S)
    rows: list[dict[str, object]] = []
    for latency_s in LATENCIES_S:
        accuracy_figures = accuracy(latency_s)
        for lookahead_s in LOOKAHEADS_S:
            advance("table", len(rows), n_rows)
            motion = MotionOptions(
                weights=weights, style=Style(lookahead_s), recognizer_latency_s=latency_s
            )
            delays_s = clip_to_bus_s(motion, n_times)
            closures = _closures(recordings, face, motion)
            rows.append(
                {
                    "lookahead_ms": _ms(lookahead_s),
                    "latency_ms": _ms(latency_s),
                    "declared_delay_ms": _ms(declared_delay_s(motion)),
                    "microphone_to_bus_p95_ms": _ms(float(np.percentile(delays_s, 95))),
                    **closure_figures(closures),
                    **accuracy_figures,
                }
            )
    advance("table", n_rows, n_rows)
    return rows


def declared_delay_s(motion: MotionOptions) -> float:
    """Return the delay from sound to face that a face declares, s, without the servos' lag."""
    recognizer = make_recognizer(latency_s=motion.recognizer_latency_s, weights=motion.weights)
    return Delay(recognizer.latency_s, motion.style.lookahead_s).total_s


def _closures(
    recordings: Sequence[Recording], face: TrainedModel, motion: MotionOptions
) -> list[Closure]:
    """Return the closures of all recordings, in motion made from a live recogniser's phonemes."""
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
