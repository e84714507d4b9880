"""The methods to move a mouth that a study shows, all on one face, at the frames of the recording.

Each gets what it has in use: ours live recognises the sound, with or without knowing the words; all
others know every phoneme with its times beforehand, as in their papers.
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
#: Label of each method in the report.
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
#: Phonemes whose recorded mouths a shape is the mean of; X is the mouth at rest.
_DRAWN_BY: Final[Mapping[Shape, tuple[str, ...]]] = {
    "A": ("P", "B", "M"), "B": ("K", "S", "T", "IY"), "C": ("EH", "AE"), "D": ("AA",),
    "E": ("AO", "ER"), "F": ("UW", "OW", "W"), "G": ("F", "V"), "H": ("L",),
}  # fmt: skip
#: Time from one shape to the next on a head; a drawing jumps.
_BLEND_S: Final = 0.08

FacesOf = Callable[[str, Utterance], Array]


@dataclass(frozen=True, slots=True)
class RhubarbMethod:
    """Mouth shapes by Rhubarb's rules; each is the mean recorded mouth of some phonemes."""

    name: str = "rhubarb"
    looks_ahead: bool = False

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees all
        """Return faces from the whole sentence, one shape after the other; see `Method`.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

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
            # The mouth moves for half the blend time at each end of a shape, and holds it in
            # between.
            half_s = min(_BLEND_S, stop_s - start_s) / 2.0
            knots_s += [start_s + half_s, stop_s - half_s]
            faces += [_shape_face(cue.shape, model)] * 2
        columns = [np.interp(times_s, knots_s, column) for column in np.array(faces).T]
        return np.stack(columns, axis=1)


def _shape_face(shape: Shape, model: TrainedModel) -> Array:
    """Return the face of a mouth shape, (n_components,): the mean of its phonemes.

    Phonemes are weighted by how often the corpus has them. X is the rest face.
    """
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
    """The mouth at rest throughout."""

    name: str = "still"
    looks_ahead: bool = False

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees nothing
        """Return the same face at all times.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        return np.repeat(model.rest[None], len(times_s), axis=0)


def chosen_methods(text: str) -> tuple[str, ...]:
    """Parse method names with commas between. Raises StudyError."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    unknown = [name for name in names if name not in METHODS]
    if unknown:
        raise StudyError(f"--methods {unknown[0]}: use one of {', '.join(METHODS)}")
    return names


def faces_of_methods(model: TrainedModel, corpus: Corpus) -> FacesOf:
    """Return a function from a method's name and a sentence to faces, (n_frames, n_components).

    model: was not trained on the test sentences. corpus: labelled, with the sentences that it was
    trained on. Raises MissingExtraError at once if the offline method's library is missing.
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
    """Return the words spoken at each place; nothing if sentences have different lengths."""
    word_lists = [tuple(words) for words in sentences]
    if len({len(words) for words in word_lists}) != 1:
        return ()
    return tuple(tuple(sorted(set(place))) for place in zip(*word_lists, strict=True))
