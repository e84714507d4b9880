"""The ways to move a mouth that a study shows, all on one face, at the frames of the recording.

What each knows is what it has when it is used: ours live recognises the sound, without the words or
with them; all others know every phoneme with its times beforehand, as their papers have it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Final

import numpy as np

from lipservo.settings.motion_names import DEFAULT_STRATEGY
from lipservo_lab.baselines.baselines import Baselines
from lipservo_lab.bench.motion_figures import live_listener
from lipservo_lab.bench.offline_models import models_of, visemes_of
from lipservo_lab.corpus.utterance import Corpus, Utterance
from lipservo_lab.evaluation.motion.as_printed import AS_PRINTED, PrintedMethod
from lipservo_lab.evaluation.motion.methods import (
    DominanceMethod,
    Heard,
    Method,
    PublishedMethod,
    all_methods,
)
from lipservo_lab.evaluation.motion.motion_scores import Listen, true_phonemes
from lipservo_lab.evaluation.motion.offline_methods import ContextVisemeMethod, OfflineMethod
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipservo_lab.study.sheets import StudyError
from lipsync.animpho.selection import STRATEGIES
from lipsync.arrays import Array
from lipsync.export.mouth_cues import CENTISECOND_S, Shape, rule_cues
from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S
from lipsync.phonemes import PHONEMES

RECORDED: Final = "recorded"
#: Of each method, what the report calls it.
METHODS: Final[Mapping[str, str]] = MappingProxyType(
    {
        RECORDED: "recorded face",
        "ears": "ours, live, by ear",
        "words": "ours, live, words known",
        "scripted": "ours, scripted line",
        "wei-deng": "Wei and Deng, our AnimPhos",
        AS_PRINTED: "Wei and Deng, as printed",
        "edge": "Edge, Hilton and Jackson",
        "cohen-massaro": "Cohen and Massaro",
        "catmull-rom": "Catmull-Rom, context visemes",
        "rhubarb": "Rhubarb's rules",
        "still": "still face",
    }
)
#: The recorded mouths that a shape is drawn after; X is the mouth at rest.
_DRAWN_BY: Final[Mapping[Shape, tuple[str, ...]]] = {
    "A": ("P", "B", "M"), "B": ("K", "S", "T", "IY"), "C": ("EH", "AE"), "D": ("AA",),
    "E": ("AO", "ER"), "F": ("UW", "OW", "W"), "G": ("F", "V"), "H": ("L",),
}  # fmt: skip
#: From one shape to the next, as whoever shows them on a head does; a drawing jumps.
_BLEND_S: Final = 0.08

FacesOf = Callable[[str, Utterance], Array]


@dataclass(frozen=True, slots=True)
class RhubarbMethod:
    """Shapes by Rhubarb's rules, each the mean recorded mouth that it is drawn after."""

    name: str = "rhubarb"
    looks_ahead: bool = False

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees all
        """Return faces from the whole sentence, one shape after the other; see `Method`.

        Parameters
        ----------
        times_s : Array
            (n,).

        Returns
        -------
        Array
            (n, n_components).
        """
        end_s = float(times_s[-1]) + CENTISECOND_S
        cues = rule_cues(heard.events, end_s)
        knots_s: list[float] = []
        faces: list[Array] = []
        for cue in cues:
            start_s, stop_s = cue.start_cs * CENTISECOND_S, cue.end_cs * CENTISECOND_S
            half_s = min(_BLEND_S, stop_s - start_s) / 2.0
            knots_s += [start_s + half_s, stop_s - half_s]
            faces += [_shape_face(cue.shape, model)] * 2
        columns = [np.interp(times_s, knots_s, column) for column in np.array(faces).T]
        return np.stack(columns, axis=1)


def _shape_face(shape: Shape, model: TrainedModel) -> Array:
    if shape == "X":
        return model.rest
    baselines: Baselines = model.baselines
    rows = [PHONEMES.index(phone) for phone in _DRAWN_BY[shape]]
    weights = baselines.counts[rows]
    return np.asarray(
        np.average(baselines.centres[rows], axis=0, weights=weights if weights.any() else None)
    )


@dataclass(frozen=True, slots=True)
class StillMethod:
    """The mouth at rest."""

    name: str = "still"
    looks_ahead: bool = False

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees nothing
        """Return the same face at all times.

        Parameters
        ----------
        times_s : Array
            (n,).

        Returns
        -------
        Array
            (n, n_components).
        """
        return np.repeat(model.rest[None], len(times_s), axis=0)


def chosen_methods(text: str) -> tuple[str, ...]:
    """From the command line, with commas. Raises StudyError."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    unknown = [name for name in names if name not in METHODS]
    if unknown:
        raise StudyError(f"--methods {unknown[0]}: use one of {', '.join(METHODS)}")
    return names


def faces_of_methods(model: TrainedModel, corpus: Corpus) -> FacesOf:
    """The faces (n_frames, n_components) of a sentence by the name of a method.

    model: one that has not learned the test sentences. corpus: labelled, what it has learned.
    Raises MissingExtraError, before the work, where the offline method's library is missing.
    """
    offline = models_of(corpus, "a study with `edge` or `scripted`")
    ours = all_methods()[DEFAULT_STRATEGY]
    ears, words = live_listener(), live_listener(with_text=True)
    printed = cache(lambda: PrintedMethod.of(model, corpus))
    known: Mapping[str, tuple[Method, Listen]] = {
        "ears": (ours, ears),
        "words": (ours, words),
        "scripted": (OfflineMethod("heard", offline), true_phonemes),
        "wei-deng": (PublishedMethod(STRATEGIES["priority"]), true_phonemes),
        "edge": (OfflineMethod("model-based", offline), true_phonemes),
        "cohen-massaro": (DominanceMethod("cohen-massaro", tuned=True), true_phonemes),
        "catmull-rom": (ContextVisemeMethod(visemes_of(corpus)), true_phonemes),
        "rhubarb": (RhubarbMethod(), true_phonemes),
        "still": (StillMethod(), true_phonemes),
    }

    def faces(name: str, utterance: Utterance) -> Array:
        if name == RECORDED:
            return model.coefficients(utterance.markers_mm)
        method, listen = known[name] if name != AS_PRINTED else (printed(), true_phonemes)
        times_s = np.arange(len(utterance.markers_mm)) / utterance.frame_rate_hz
        return method.faces(model, listen(utterance), times_s, DEFAULT_LOOKAHEAD_S)

    return faces


def vocabulary_of(sentences: Iterable[Sequence[str]]) -> tuple[tuple[str, ...], ...]:
    """The words that are spoken at each place, where all sentences have as many; else nothing."""
    word_lists = [tuple(words) for words in sentences]
    if len({len(words) for words in word_lists}) != 1:
        return ()
    return tuple(tuple(sorted(set(place))) for place in zip(*word_lists, strict=True))
