"""Table 3 of Wei and Deng: what a phoneme costs, stage by stage, beside the printed numbers.

Their clips were of two minutes, ours are sentences of three seconds, and their machine was another:
orders of magnitude compare, no more.
"""

import time
from collections.abc import Callable

import numpy as np

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.evaluation.motion.methods import Heard, script_of
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.animpho.blending import blend, choose_connected, sample_derivatives, translate
from lipsync.animpho.selection import STRATEGIES, Choice
from lipsync.animpho.trajectory import Trajectory
from lipsync.animpho.units import AnimPhoUnits
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, LiveSynthesizer, Style
from lipsync.phonemes import SILENCE, PhonemeEvent, stand_in

Row = dict[str, object]
Listen = Callable[[Utterance], Heard]

#: As printed, of three clips. The total is more than the sum of its parts there too.
PRINTED: dict[str, tuple[float, float, float]] = {
    "recognition_ms": (76.73, 90.13, 93.80),
    "synthesis_ms": (38.56, 39.10, 44.89),
    "blending_ms": (0.16, 0.14, 0.15),
    "total_ms": (128.28, 144.40, 142.23),
    "phonemes_per_s": (8.84, 7.29, 7.43),
    "frames_per_s": (25.62, 30.03, 26.77),
}
#: Equation (6) counts frames at this rate.
_FRAMES_HZ = 30.0


def cost_rows(model: TrainedModel, clip: Utterance, number: int, listen: Listen) -> list[Row]:
    """A row for each line of the table: printed, by the priority strategy, by ours.

    Means over the phonemes that the recogniser heard in the clip, silences left out. synthesis:
    selection, equations (1) and (2); blending: equations (3) to (5) and Algorithm 1 at 30 Hz; ours
    has no such parts, all its work is synthesis. phonemes_per_s: how fast the clip is spoken.
    frames_per_s: equation (6), frames of a phoneme at 30 Hz over its computing time.
    """
    began = time.process_time()
    heard = listen(clip)
    recognition_ms = (time.process_time() - began) * 1e3
    spoken = [e for e in heard.events if e.phoneme != SILENCE and e.end_s is not None]
    n = max(1, len(spoken))
    seconds = sum((e.end_s or e.start_s) - e.start_s for e in spoken)
    synthesis_ms, blending_ms = _published_ms(model, heard)
    stages = {
        "priority": (recognition_ms / n, synthesis_ms / n, blending_ms / n),
        LIVE_STRATEGY: (recognition_ms / n, _live_ms(model, heard) / n, None),
    }
    rows: list[Row] = []
    for line, printed in PRINTED.items():
        row: Row = {"clip": clip.name, "of_a_phoneme": line, "printed": printed[number]}
        for name, (recognition, synthesis, blending) in stages.items():
            total = recognition + synthesis + (blending or 0.0)
            row[name] = {
                "recognition_ms": recognition,
                "synthesis_ms": synthesis,
                "blending_ms": blending,
                "total_ms": total,
                "phonemes_per_s": n / seconds if seconds else None,
                "frames_per_s": seconds * _FRAMES_HZ / (total * n / 1e3),
            }[line]
        rows.append(row)
    return rows


def _published_ms(model: TrainedModel, heard: Heard) -> tuple[float, float]:
    """Selection and blending of a whole sentence by the priority strategy, ms each."""
    strategy = STRATEGIES["priority"]
    selecting = blending = 0.0
    choice: Choice | None = None
    position = model.rest
    for event in heard.events:
        if event.phoneme == SILENCE:
            choice, position = None, model.rest
            continue
        for part in stand_in(event.phoneme, model.animphos.known_phonemes):
            began = time.perf_counter()
            last = choice
            choice = (
                strategy.first(model.animphos, part)
                if last is None
                else strategy.following(model.animphos, part, last)
            )
            selected = time.perf_counter()
            position = _blended(model.animphos, event, last, choice, position)
            selecting += selected - began
            blending += time.perf_counter() - selected
    return selecting * 1e3, blending * 1e3


def _blended(
    units: AnimPhoUnits,
    event: PhonemeEvent,
    last: Choice | None,
    choice: Choice,
    position: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The samples of a phoneme and its frames; where it ends."""
    connected = (
        choice.animpho if last is None else choose_connected(units, last.animpho, choice.animpho)
    )
    samples = blend(translate(units.samples[connected], position), units.samples[choice.animpho])
    duration_s = (event.end_s or event.start_s) - event.start_s
    derivatives = sample_derivatives(samples, np.zeros_like(position))
    trajectory = Trajectory(event.start_s, max(duration_s, 1e-3), samples, derivatives)
    for frame in range(round(duration_s * _FRAMES_HZ)):
        trajectory.at(event.start_s + frame / _FRAMES_HZ)
    return np.asarray(samples[-1])


def _live_ms(model: TrainedModel, heard: Heard) -> float:
    """All that ours computes for a sentence, asked at 30 Hz, with its default look-ahead; ms."""
    style = Style()
    synthesizer = LiveSynthesizer(model, model.expectation, style)
    script = script_of(heard, style.lookahead_s)
    end_s = heard.events[-1].end_s or 0.0
    began = time.perf_counter()
    for frame in range(round(end_s * _FRAMES_HZ)):
        for update in script.updates(frame / _FRAMES_HZ):
            synthesizer.push(update)
        synthesizer.frame_at(frame / _FRAMES_HZ)
    return (time.perf_counter() - began) * 1e3
