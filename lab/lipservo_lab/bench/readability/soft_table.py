"""The table of `lipservo learn soft --table`: a mouth by what other weights hear, beside the bars.

Face models are trained without what is read off them and fitted to the same weights; what is read
is the default strategy at its look-ahead. Lips are watched at 100 Hz in the held-out sentences of
known words.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from lipservo.settings.motion_names import DEFAULT_STRATEGY
from lipservo_lab.bench.hearing.recognizer_bench import measured_recognizer
from lipservo_lab.bench.motion_figures import PHONEMES_RECOGNIZED, Row, Track
from lipservo_lab.bench.readability.readability_figures import (
    HEADLINE_LOOKAHEAD_MS,
    headline,
    reading_question,
    reading_rows,
)
from lipservo_lab.corpus.utterance import Corpus
from lipservo_lab.evaluation.motion.measures import lip_speed, lip_speed_figures
from lipservo_lab.evaluation.motion.motion_scores import Part
from lipservo_lab.evaluation.readability.reading_scores import KNOWN
from lipservo_lab.evaluation.recognition.heard_motion import (
    closure_figures,
    closure_hits,
    heard_motion,
)
from lipservo_lab.learning.motion.model_teacher import ModelTeacher
from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S
from lipsync.recognition.network import LATENCY_S

#: What weights should reach; what the shipped ones do: docs/benchmarks.md.
_BARS: Final = {
    "known_recognized": ">= 0.86",
    "new_a_recognized": ">= 0.46",
    "new_b_recognized": ">= 0.60",
    "gap_r_recognized": ">= 0.835",
    "closure_hits": ">= 0.95",
    "heard_closure_hits": ">= 0.985",
    "labiodental_hits": ">= 0.95",
    "gap_steps_per_s": "<= 0.02",
    "widest_gap_step_mm": "<= 4.5",
}


def soft_table(
    corpus: Corpus, parts: Sequence[Part], teacher: ModelTeacher, weights: str, track: Track
) -> list[Row]:
    """Train models and return a row for each bar: figure, bar, measured value.

    A value is None if the parts do not give it. parts: of the labelled corpus, as `reading_parts`
    returns them. teacher: trains a model with the recogniser's `weights`. Raises TrainingError,
    BenchError.
    """
    models = {part.split: teacher(corpus.keep(set(part.train))) for part in parts}
    reading = reading_question(
        DEFAULT_STRATEGY, str(HEADLINE_LOOKAHEAD_MS), PHONEMES_RECOGNIZED, robot=False
    )
    rows = reading_rows(
        corpus,
        parts,
        lambda part: models[part.split],
        replace(reading, weights=weights),
        track,
        lambda *_: None,
    )
    recognizer = measured_recognizer("network", LATENCY_S, weights)()
    known = next(part for part in parts if part.split == KNOWN)
    closures, speeds, face = [], [], models[KNOWN]
    for utterance in track("closing", list(corpus.keep(set(known.test)).utterances)):
        motion = heard_motion(utterance.sound_path, recognizer, face, DEFAULT_LOOKAHEAD_S)
        closures += closure_hits(motion, utterance.phones, face)
        speeds.append(lip_speed(face, motion.faces, motion.spoken_s))
    found = headline(rows) | closure_figures(closures) | lip_speed_figures(speeds)
    return [{"figure": f, "bar": bar, "measured": found.get(f)} for f, bar in _BARS.items()]
