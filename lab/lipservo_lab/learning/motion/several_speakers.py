"""Corpora of several speakers become one corpus, as if one face had said everything."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from lipservo_lab.corpus.frame_rate import at_frame_rate
from lipservo_lab.corpus.utterance import Corpus, CorpusError, Utterance
from lipservo_lab.learning.motion.face_map import (
    FaceMap,
    FaceMapError,
    PhonemeFaces,
    fit_face_map,
    phoneme_faces,
)
from lipservo_lab.learning.motion.rest_face import closed_mouth_mm

#: Between a speaker and a sentence in the name of a sentence of several speakers.
SEPARATOR = "/"
#: Weights beyond these are slips of the pen, and the larger ones take hours.
_SMALLEST_WEIGHT, _LARGEST_WEIGHT = 0.001, 100.0


def on_one_face(
    corpora: Sequence[Corpus],
    *,
    face_of: str | None = None,
    weights: Mapping[str, float] | None = None,
) -> tuple[Corpus, dict[str, FaceMap]]:
    """One corpus of all labelled sentences, each speaker's motion on one speaker's face.

    And how the others' motion came to that face, by their names.

    corpora: of one layout, each of one speaker, who is called as the corpus is. face_of: whose face
    it is, None for the first's; its head and its frame rate are taken too. weights: how often a
    frame of a speaker counts, 1 where none is given. A sentence is called SPEAKER/NAME; a single
    corpus keeps its names. Raises CorpusError for a name that is there twice or not at all, a
    weight that is none, and a speaker whose face cannot be compared.
    """
    of_speaker = {corpus.name: corpus for corpus in corpora}
    check_speakers([corpus.name for corpus in corpora], face_of, weights or {})
    for corpus in corpora:
        if not corpus.labelled().utterances:
            raise CorpusError(f"corpus {corpus.name}: no sentence has a phones tier")
    target = corpora[0] if face_of is None else of_speaker[face_of]
    if len(corpora) == 1:
        return corpora[0].labelled(), {}
    faces = {corpus.name: _phoneme_faces(corpus) for corpus in corpora}
    maps: dict[str, FaceMap] = {}
    utterances: list[Utterance] = []
    for corpus in corpora:
        said = corpus.labelled().utterances
        if corpus is not target:
            try:
                maps[corpus.name] = fit_face_map(faces[corpus.name], faces[target.name])
            except FaceMapError as error:
                raise CorpusError(f"{corpus.name} beside {target.name}: {error}") from error
            said = _moved(said, maps[corpus.name], target.labelled().utterances[0].frame_rate_hz)
        weight = (weights or {}).get(corpus.name, 1.0)
        utterances += [
            replace(u, name=f"{corpus.name}{SEPARATOR}{u.name}", weight=weight) for u in said
        ]
    skipped = tuple(line for corpus in corpora for line in corpus.skipped)
    name = "+".join(of_speaker)
    return Corpus(name, target.layout, tuple(utterances), target.head_reference_mm, skipped), maps


def speaker_name(name: str) -> str:
    """Whose sentence of several speakers' it is; "" where it is of one speaker's corpus."""
    return name.rpartition(SEPARATOR)[0]


def sentence_name(name: str) -> str:
    """The name of a sentence in its own speaker's folder."""
    return name.rpartition(SEPARATOR)[2]


def check_speakers(names: Sequence[str], face_of: str | None, weights: Mapping[str, float]) -> None:
    """Raises CorpusError for a name that is there twice or not at all, a weight that is none.

    names: of the corpora.
    """
    for name in names:
        if names.count(name) > 1:
            raise CorpusError(
                f"{names.count(name)} corpora are called {name!r}; rename folders, for a folder's "
                "name says whose sentences they are"
            )
    for name in (*weights, *([] if face_of is None else [face_of])):
        if name not in names:
            raise CorpusError(f"no corpus is called {name!r}; there are {', '.join(names)}")
    for name, weight in weights.items():
        if not _SMALLEST_WEIGHT <= weight <= _LARGEST_WEIGHT:
            raise CorpusError(
                f"weight {weight:g} of {name}: from {_SMALLEST_WEIGHT} to {_LARGEST_WEIGHT:g}; "
                "leave the corpus out if it is to count nothing"
            )


def _moved(
    said: Sequence[Utterance], face_map: FaceMap, frame_rate_hz: float
) -> tuple[Utterance, ...]:
    """A speaker's sentences on the target's face, at its frame rate."""
    on_target = [
        replace(u, markers_mm=face_map.on_target(u.markers_mm).astype(np.float32)) for u in said
    ]
    return tuple(at_frame_rate(utterance, frame_rate_hz) for utterance in on_target)


def _phoneme_faces(corpus: Corpus) -> PhonemeFaces:
    said = corpus.labelled().utterances
    for utterance in said:
        if not np.isfinite(utterance.markers_mm).all():
            raise CorpusError(
                f"corpus {corpus.name}: {utterance.name} has markers that are not numbers; leave "
                "the sentence out or track it again"
            )
    return phoneme_faces(said, closed_mouth_mm(said, corpus.layout))
