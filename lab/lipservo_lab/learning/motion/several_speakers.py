"""Join corpora of several speakers into one, as if one face had spoken everything.

A speaker's motion is mapped to the target speaker's face by a rotation, and a scale for each axis:

    y = rest' + A R (x - rest)

x: a marker of the speaker, rest: where it is in the speaker's closed mouth, rest': where it is in
the target's. Displacements from a rest face are carried over, turned and scaled, as in Noh and
Neumann, "Expression cloning" (SIGGRAPH 2001, section 3), but with one scale an axis for the whole
mouth in place of one a vertex. R: Procrustes rotation of rest onto rest', with a scale for each
axis of the target (Bennani Dosse and Ten Berge, "Anisotropic orthogonal Procrustes analysis",
Journal of Classification 27, 2010), so that a longer face is not taken for a nodding one. A:
diagonal; a_i^2 is the ratio of how much phonemes differ on both faces along axis i:

    a_i^2 = sum_p w_p |d'_pi|^2 / sum_p w_p |d_pi|^2

d_p: the mean face in the middle of phoneme p, turned, less the mean over phonemes; d'_p: the same
of the target; w_p: how often the rarer of both says p. Phonemes and not frames are compared,
because two speakers read different texts; and differences between phonemes, not from rest, because
a mouth may rest ajar.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.utterance import Corpus, CorpusError, Utterance, at_frame_rate
from lipservo_lab.learning.motion.frame_statistics import closed_mouth_mm
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.face.head_motion import fit_similarity
from lipsync.phonemes import PHONEMES, SILENCE

#: A phoneme said once says little about a face.
_FEWEST_TIMES = 2
#: Fewer phonemes span no three axes.
_FEWEST_PHONEMES = 4
#: A larger scale means coordinates in another unit than mm, or a face that does not speak.
_LARGEST_SCALE = 4.0
#: Rounds in which rotation and scales are fitted in turn: exact to rounding on a face turned by 30
#: degrees and stretched by a half.
_ROUNDS = 200


class FaceMapError(UserError):
    """Two speakers cannot be brought to one face; the message says why."""


@dataclass(frozen=True, slots=True)
class PhonemeFaces:
    """A speaker's closed mouth, and the mean face in the middle of each phoneme.

    rest_mm: (n_points, 3); means_mm: (40, n_points, 3), 0 for phonemes not spoken; counts: (40,),
    phones of each phoneme.
    """

    rest_mm: Array
    means_mm: Array
    counts: Array


@dataclass(frozen=True, slots=True)
class FaceMap:
    """The map of a speaker's motion to the target's face, y = rest' + A R (x - rest).

    rest_mm, target_rest_mm: rest and rest' (n_points, 3); rotation: R (3, 3); scale: the diagonal
    of A, (3,), for x, y and z.
    """

    rest_mm: Array
    target_rest_mm: Array
    rotation: Array
    scale: Array

    @property
    def angle_deg(self) -> float:
        """The angle by which the speaker's head is turned against the target's, degrees."""
        return float(np.degrees(np.arccos(np.clip((np.trace(self.rotation) - 1.0) / 2.0, -1, 1))))

    def on_target(self, markers_mm: NDArray[np.floating]) -> Array:
        """Return a speaker's motion as markers on the target's face.

        Parameters
        ----------
        markers_mm : NDArray[np.floating]
            (n_frames, n_points, 3) of the speaker.

        Returns
        -------
        Array
            (n_frames, n_points, 3) mm.
        """
        turned_mm = (markers_mm - self.rest_mm) @ self.rotation.T
        return np.asarray(self.target_rest_mm + turned_mm * self.scale)


def phoneme_faces(utterances: Sequence[Utterance], rest_mm: Array) -> PhonemeFaces:
    """Return the mean face in the middle of each phoneme, interpolated between frames.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Sentences of one speaker, with phone labels.
    rest_mm : Array
        (n_points, 3), the speaker's closed mouth; stored in the result.

    Returns
    -------
    PhonemeFaces
        Means of shape (40, n_points, 3).
    """
    counts, sums = np.zeros(len(PHONEMES)), np.zeros((len(PHONEMES), *rest_mm.shape))
    for utterance in utterances:
        last_frame = len(utterance.markers_mm) - 1
        for phone in utterance.phones:
            if phone.phoneme == SILENCE or phone.end_s is None:
                continue
            middle = min(last_frame, (phone.start_s + phone.end_s) / 2.0 * utterance.frame_rate_hz)
            before = min(last_frame - 1, int(middle))
            first, second = utterance.markers_mm[before : before + 2].astype(np.float64)
            index = PHONEMES.index(phone.phoneme)
            counts[index] += 1
            sums[index] += first + (middle - before) * (second - first)
    return PhonemeFaces(rest_mm, sums / np.maximum(counts, 1.0)[:, None, None], counts)


def fit_face_map(speaker: PhonemeFaces, target: PhonemeFaces) -> FaceMap:
    """Fit the map from a speaker's motion to a target's face (see the module).

    Raises FaceMapError where fewer than four phonemes are said twice by both, or where one face
    moves more than four times as much as the other along an axis.
    """
    common_counts = np.minimum(speaker.counts, target.counts)
    known = np.flatnonzero(common_counts >= _FEWEST_TIMES)
    if len(known) < _FEWEST_PHONEMES:
        raise FaceMapError(
            f"only {len(known)} phonemes are said {_FEWEST_TIMES} times by both speakers, "
            f"{_FEWEST_PHONEMES} are needed to compare their faces; record more sentences"
        )
    rotation = _rotation(speaker.rest_mm, target.rest_mm)
    weights = common_counts[known] / common_counts[known].sum()
    speaker_mm2 = _differences(speaker.means_mm[known] @ rotation.T, weights)
    target_mm2 = _differences(target.means_mm[known], weights)
    scale = np.sqrt(target_mm2 / np.maximum(speaker_mm2, 1e-12))
    for axis, factor in zip("xyz", scale, strict=True):
        if not 1.0 / _LARGEST_SCALE <= factor <= _LARGEST_SCALE:
            raise FaceMapError(
                f"one face moves {max(factor, 1.0 / max(factor, 1e-6)):.3g} times as much as the "
                f"other along {axis}; more than {_LARGEST_SCALE:g} times is a fault of tracking: "
                "look at the landmarks of both"
            )
    return FaceMap(speaker.rest_mm, target.rest_mm, rotation, scale)


def _differences(means_mm: Array, weights: Array) -> Array:
    """Return how much phonemes differ along each axis, (3,) mm^2, summed over the points.

    means_mm: (n, n_points, 3) mean faces; weights: (n,), of sum 1.
    """
    deviations_mm = means_mm - np.tensordot(weights, means_mm, axes=1)
    return np.asarray(np.tensordot(weights, deviations_mm**2, axes=1).sum(axis=0))


def _rotation(source: Array, target: Array) -> Array:
    """Return the rotation R, (3, 3), of `target ~ b R source`, with a scale b for each axis.

    source, target: (n_points, 3) faces, which are centred here. Rotation and scales are fitted in
    turn.
    """
    source, target = source - source.mean(axis=0), target - target.mean(axis=0)
    stretch = np.ones(3)
    for _ in range(_ROUNDS):
        rotation: Array = fit_similarity(source[None], target / stretch)[1][0]
        turned = source @ rotation.T
        stretch = (target * turned).sum(axis=0) / (turned**2).sum(axis=0)
    return rotation


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
    """Join labelled sentences of several speakers, with all motion on one speaker's face.

    Return the corpus, and the map of each other speaker to that face, by name.

    corpora: of one layout, each of one speaker, named as the corpus. face_of: speaker whose face,
    head and frame rate are used; None: the first. weights: how often a frame of a speaker counts;
    default 1. A sentence is named SPEAKER/NAME; a single corpus keeps its names. Raises CorpusError
    for a name that occurs twice or is unknown, a weight out of range, and a speaker whose face
    cannot be compared.
    """
    corpus_of = {corpus.name: corpus for corpus in corpora}
    check_speakers([corpus.name for corpus in corpora], face_of, weights or {})
    for corpus in corpora:
        if not corpus.labelled().utterances:
            raise CorpusError(f"corpus {corpus.name}: no sentence has a tier `phones` in labels/")
    target = corpora[0] if face_of is None else corpus_of[face_of]
    if len(corpora) == 1:
        return corpora[0].labelled(), {}
    faces = {corpus.name: _checked_phoneme_faces(corpus) for corpus in corpora}
    maps: dict[str, FaceMap] = {}
    utterances: list[Utterance] = []
    for corpus in corpora:
        spoken = corpus.labelled().utterances
        if corpus is not target:
            try:
                maps[corpus.name] = fit_face_map(faces[corpus.name], faces[target.name])
            except FaceMapError as error:
                raise CorpusError(f"{corpus.name} beside {target.name}: {error}") from error
            spoken = _on_target_face(
                spoken, maps[corpus.name], target.labelled().utterances[0].frame_rate_hz
            )
        weight = (weights or {}).get(corpus.name, 1.0)
        utterances += [
            replace(u, name=f"{corpus.name}{SEPARATOR}{u.name}", weight=weight) for u in spoken
        ]
    skipped = tuple(line for corpus in corpora for line in corpus.skipped)
    name = "+".join(corpus_of)
    return Corpus(name, target.layout, tuple(utterances), target.head_reference_mm, skipped), maps


def speaker_name(name: str) -> str:
    """Return the speaker in a name SPEAKER/NAME; "" in a single speaker's corpus."""
    return name.rpartition(SEPARATOR)[0]


def sentence_name(name: str) -> str:
    """Return the name of a sentence in its own speaker's folder."""
    return name.rpartition(SEPARATOR)[2]


def check_speakers(names: Sequence[str], face_of: str | None, weights: Mapping[str, float]) -> None:
    """Raise CorpusError for corpora of the same name, unknown speakers or weights out of range.

    names: of the corpora. face_of: the speaker whose face is used, or None. weights: by speaker.
    """
    for name in names:
        if names.count(name) > 1:
            raise CorpusError(
                f"{names.count(name)} corpora are called {name!r}; rename folders: their names "
                "tell the speakers apart"
            )
    for name in (*weights, *([] if face_of is None else [face_of])):
        if name not in names:
            raise CorpusError(f"no corpus is called {name!r}; use one of {', '.join(names)}")
    for name, weight in weights.items():
        if not _SMALLEST_WEIGHT <= weight <= _LARGEST_WEIGHT:
            raise CorpusError(
                f"--weight {name}={weight:g}: give {_SMALLEST_WEIGHT} to {_LARGEST_WEIGHT:g}, or "
                "leave out a corpus that shall not count"
            )


def _on_target_face(
    spoken: Sequence[Utterance], face_map: FaceMap, frame_rate_hz: float
) -> tuple[Utterance, ...]:
    """Return a speaker's sentences mapped to the target's face, at the target's frame rate."""
    on_target = [
        replace(u, markers_mm=face_map.on_target(u.markers_mm).astype(np.float32)) for u in spoken
    ]
    return tuple(at_frame_rate(utterance, frame_rate_hz) for utterance in on_target)


def _checked_phoneme_faces(corpus: Corpus) -> PhonemeFaces:
    """Return a corpus's closed mouth and its mean face in the middle of each phoneme.

    Raises CorpusError for a sentence with markers that are not finite.
    """
    spoken = corpus.labelled().utterances
    for utterance in spoken:
        if not np.isfinite(utterance.markers_mm).all():
            raise CorpusError(
                f"corpus {corpus.name}: {utterance.name} has markers that are not numbers; leave "
                "the sentence out or track it again"
            )
    return phoneme_faces(spoken, closed_mouth_mm(spoken, corpus.layout))
