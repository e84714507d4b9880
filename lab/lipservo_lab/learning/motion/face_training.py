"""Train a face model from a corpus: principal components, recorded pieces of motion, expectation.

Segments of motion, one a phoneme, are clustered by k-means into AnimPhos (recorded pieces of
motion); two tables say which may follow which and which phoneme each belongs to (Wei and Deng,
sections "data preprocessing" and "AnimPho"). The only module of this package that loads
scikit-learn.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from lipservo_lab.baselines.baselines import Baselines, fit_regression
from lipservo_lab.baselines.tuning import tune_dominance
from lipservo_lab.corpus.utterance import Corpus, Utterance, speech_frames
from lipservo_lab.learning.expectation.deviation import with_deviation
from lipservo_lab.learning.expectation.expectation_training import fit_expectation, joined
from lipservo_lab.learning.motion.frame_statistics import (
    PrincipalComponents,
    counted_sentences,
    counted_training_set,
    mean_at_rest,
    observe_closures,
    principal_components,
)
from lipservo_lab.learning.motion.several_speakers import sentence_name, speaker_name
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits, IndexLists, face_fields
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.expectation.back_off import BackOff
from lipsync.expectation.expectation import UNKNOWN, track_of
from lipsync.face.model import FaceModel
from lipsync.markers import CLOSED_GAP_MM, PointLayout
from lipsync.phonemes import PHONEMES, VISEME_CLASSES, VISEME_OF, PhonemeEvent, stand_in

Progress = Callable[[str], None]

#: Number of components unless asked otherwise. The paper keeps 5, which hold 96.6 % of its
#: variance; here 5 hold 94.8 %, 7 hold 97.0 %. Of the part of a face that phonemes determine, the
#: sixth to eighth component hold more than the fifth (docs/decisions/motion.md).
DEFAULT_COMPONENTS = 8
#: AnimPhos (clusters) of a phoneme, for each of its segments. Chosen on inner splits: 0.2 gives an
#: AnimPho the paper's 3.45 successors, and faces whose error ratio is .007 higher.
_ANIMPHOS_PER_SEGMENT = 0.26
_KMEANS_ITERATIONS = 20


class TrainingError(UserError):
    """The corpus cannot teach a face: says what is missing."""


@dataclass(frozen=True, slots=True)
class Segments:
    """The corpus cut at its phoneme boundaries, one segment a phone.

    samples: face coefficients (n, 5, n_components) of five evenly spaced frames; phonemes: (n,)
    indices into PHONEMES; sentence: (n,) sentence numbers; weights: (n,), how often each counts.
    Segments of a sentence are in order of time.
    """

    samples: Array
    phonemes: NDArray[np.int64]
    sentence: NDArray[np.int64]
    weights: Array


def train(
    corpus: Corpus,
    *,
    seed: int = 0,
    n_components: int = DEFAULT_COMPONENTS,
    heard: Mapping[str, Sequence[PhonemeEvent]] | None = None,
    progress: Progress = lambda _: None,
) -> TrainedModel:
    """Learn a model from every labelled sentence; the same corpus and seed give the same model.

    corpus: of one speaker, or of several on one face (`several_speakers.on_one_face`).
    n_components: principal components of the face, 1 or more. heard: recognised phonemes by
    sentence name (`hear_sentences`); besides the labels, the expectation then learns from them, and
    so learns a recogniser's errors. progress: called with a line about each step. Raises
    TrainingError for a corpus without labelled motion, with markers that are not numbers, with a
    face that never moves, or with too few frames or phones.
    """
    check_components(n_components, corpus.layout)
    labelled = corpus.labelled()
    if not labelled.utterances:
        raise TrainingError(f"corpus {corpus.name}: no sentence has a tier `phones` in labels/")
    for utterance in labelled.utterances:
        if not np.isfinite(utterance.markers_mm).all():
            frame = int(np.argmin(np.isfinite(utterance.markers_mm).all(axis=(1, 2))))
            raise TrainingError(
                f"corpus {corpus.name}: {utterance.name}, frame {frame}: markers that are not "
                "numbers; leave the sentence out or track it again"
            )
    progress("principal components")
    frames = np.concatenate([_flat(u) for u in labelled.utterances])
    _check_length(corpus, labelled.utterances, n_components)
    if not frames.std(axis=0).any():
        raise TrainingError(f"corpus {corpus.name}: the face never moves; track it again")
    with threadpool_limits(limits=1):  # several threads add up in changing order
        weights = np.concatenate(
            [np.full(len(u.markers_mm), u.weight) for u in labelled.utterances]
        )
        pca = principal_components(frames, weights, n_components)
        coefficients = [pca.coefficients(_flat(u)) for u in labelled.utterances]

    progress("segments")
    segments = cut_segments(labelled.utterances, coefficients)
    if len(segments.samples) < 2:
        raise TrainingError(f"corpus {corpus.name}: {len(segments.samples)} phones; label more")
    with threadpool_limits(limits=1):
        centres, counts = phone_centres(segments)
        from_labels = counted_training_set(labelled.utterances, coefficients)
        from_hearing = counted_training_set(labelled.utterances, coefficients, heard or {})
        both = joined([from_labels, from_hearing])
        expectation = fit_expectation(both, centres, seed=seed, progress=progress)
        # Sentences again, each as often as its weight says.
        counted = counted_sentences(labelled.utterances)
        utterances_of, motion = (
            [labelled.utterances[i] for i in counted],
            [coefficients[i] for i in counted],
        )
        expectation = with_deviation(expectation, utterances_of, motion)
        # Where phonemes meet that never did in training, the expectation is mixed with their
        # centres.
        expectation = replace(expectation, back_off=BackOff(centres, diphones(labelled.utterances)))
        progress("baselines")
        dominance = tune_dominance(utterances_of, motion, centres)
        regression = fit_regression(
            from_labels.phonemes, from_labels.times_s, from_labels.lookahead_s, from_labels.faces
        )
    face = _make_face(corpus, pca, labelled.utterances, coefficients)
    return TrainedModel(
        **face_fields(face),
        animphos=animphos_of(segments, face.rest, seed),
        expectation=expectation,
        baselines=Baselines(centres, counts, dominance, regression),
        training_sentences=tuple(sentence_name(u.name) for u in labelled.utterances),
        provenance={
            "corpus": corpus.name,
            "seed": seed,
            "frames": len(frames),
            "segments": len(segments.samples),
            "variance_held": round(pca.variance_held, 6),
            "sentences_heard": len((heard or {}).keys() & {u.name for u in labelled.utterances}),
        },
    )


def check_components(n_components: int, layout: PointLayout) -> None:
    """Raise TrainingError for a number of components that no face of this layout can have."""
    most = 3 * layout.n_points
    if not 1 <= n_components <= most:
        raise TrainingError(
            f"--components {n_components}: a face of {layout.n_points} points has 1 to {most}"
        )


def _check_length(corpus: Corpus, utterances: Sequence[Utterance], n_components: int) -> None:
    """Raise TrainingError where a speaker has too few frames for so many components."""
    n_frames: dict[str, int] = {}
    for utterance in utterances:
        speaker = speaker_name(utterance.name) or corpus.name
        n_frames[speaker] = n_frames.get(speaker, 0) + len(utterance.markers_mm)
    for speaker, n in n_frames.items():
        if n <= n_components:
            raise TrainingError(
                f"corpus {speaker}: {n} frames are too few for --components {n_components}"
            )


def _make_face(
    corpus: Corpus,
    pca: PrincipalComponents,
    utterances: Sequence[Utterance],
    coefficients: list[Array],
) -> FaceModel:
    """Make the face model: basis, rest pose, covariance in speech, and how the lips close.

    coefficients: (n_frames, n_components) of each sentence. Without two frames of speech the
    covariance is that of all frames.
    """
    is_speech = [speech_frames(u) for u in utterances]
    if sum(map(np.count_nonzero, is_speech)) < 2:
        is_speech = [np.ones(len(m), dtype=bool) for m in coefficients]
    spoken = np.concatenate([m[s] for m, s in zip(coefficients, is_speech, strict=True)])
    weights = np.repeat([u.weight for u in utterances], [np.count_nonzero(s) for s in is_speech])
    covariance = np.cov(spoken, rowvar=False, aweights=weights)
    face = FaceModel(
        layout=corpus.layout,
        mean_mm=pca.mean.reshape(-1, 3),
        basis=pca.basis,
        head_reference_mm=corpus.head_reference_mm,
        rest=mean_at_rest(utterances, coefficients, corpus.layout),
        covariance=np.atleast_2d(covariance),
        labiodental_gap_mm=CLOSED_GAP_MM,
        tightest_s=np.zeros(len(PHONEMES)),
    )
    closures = observe_closures(utterances, face.lip_gaps_mm)
    return replace(
        face, labiodental_gap_mm=closures.labiodental_gap_mm, tightest_s=closures.tightest_s
    )


def phone_centres(segments: Segments) -> tuple[Array, Array]:
    """Return the mean face in the middle of each phoneme, and the summed weights of its segments.

    A phoneme without segments has the mean of its viseme class; if that has none either, the mean
    of the phonemes that stand in for it (`stand_in`).

    Parameters
    ----------
    segments : Segments
        Of the whole corpus.

    Returns
    -------
    tuple[Array, Array]
        Face coefficients (40, n_components), and weights (40,), 0 without segments.
    """
    middles = segments.samples[:, SAMPLES_PER_ANIMPHO // 2]
    counts = np.bincount(segments.phonemes, segments.weights, len(PHONEMES)).astype(np.float64)
    sums = np.zeros((len(PHONEMES), middles.shape[1]))
    np.add.at(sums, segments.phonemes, middles * segments.weights[:, None])
    known = frozenset(p for p, count in zip(PHONEMES, counts, strict=True) if count)
    centres = np.zeros_like(sums)
    for index, phoneme in enumerate(PHONEMES):
        members = [PHONEMES.index(p) for p in VISEME_CLASSES[VISEME_OF[phoneme]] if p in known]
        if phoneme in known:
            members = [index]
        elif not members:
            members = [PHONEMES.index(p) for p in stand_in(phoneme, known)]
        centres[index] = sums[members].sum(axis=0) / counts[members].sum()
    return centres, counts


def diphones(utterances: Iterable[Utterance]) -> NDArray[np.bool_]:
    """Return which phoneme followed which in the corpus, as `BackOff` needs it.

    Gaps between phones count as silence.

    Parameters
    ----------
    utterances : Iterable[Utterance]
        Sentences with phone labels.

    Returns
    -------
    NDArray[np.bool_]
        (41, 41), True where the second phoneme followed the first; the row and column of UNKNOWN
        are True.
    """
    followed = np.zeros((UNKNOWN + 1, UNKNOWN + 1), dtype=np.bool_)
    followed[UNKNOWN], followed[:, UNKNOWN] = True, True
    for utterance in utterances:
        phonemes = np.array(track_of(utterance.phones).phonemes)
        followed[phonemes[:-1], phonemes[1:]] = True
    return followed


def cut_segments(utterances: Iterable[Utterance], coefficients: list[Array]) -> Segments:
    """Return one segment for each phone, resampled to five evenly spaced frames.

    Segments that follow each other share the frame at their boundary. Frames are interpolated,
    because a phone may be shorter than a frame at 25 Hz.

    Parameters
    ----------
    utterances : Iterable[Utterance]
        Sentences with phone labels.
    coefficients : list[Array]
        Face coefficients (n_frames, n_components) of each.

    Returns
    -------
    Segments
        Samples of shape (m, 5, n_components).
    """
    samples, phonemes, sentence, weights = [], [], [], []
    for number, (utterance, motion) in enumerate(zip(utterances, coefficients, strict=True)):
        for phone in utterance.phones:
            samples.append(_five_samples(phone, motion, utterance.frame_rate_hz))
            phonemes.append(PHONEMES.index(phone.phoneme))
            sentence.append(number)
            weights.append(utterance.weight)
    return Segments(np.array(samples), np.array(phonemes), np.array(sentence), np.array(weights))


def _five_samples(phone: PhonemeEvent, motion: Array, frame_rate_hz: float) -> Array:
    """Return five faces of a phone, evenly spaced from start to end, (5, n_components).

    motion: face coefficients (n_frames, n_components) of its sentence. Raises TrainingError for a
    phone without end.
    """
    if phone.end_s is None:
        raise TrainingError(f"phone {phone.phoneme} at {phone.start_s:.2f} s has no end")
    at_frames = np.linspace(phone.start_s, phone.end_s, SAMPLES_PER_ANIMPHO) * frame_rate_hz
    numbers = np.arange(len(motion))
    return np.stack([np.interp(at_frames, numbers, component) for component in motion.T], axis=1)


def animphos_of(segments: Segments, rest: Array, seed: int) -> AnimPhoUnits:
    """Return AnimPhos (recorded pieces of motion): centres of k-means over a phoneme's segments.

    Each phoneme is clustered alone. Wei and Deng cluster all segments together, so that half of
    their AnimPhos have several labels.

    Parameters
    ----------
    segments : Segments
        Of the whole corpus.
    rest : Array
        (n_components,), the closed mouth.
    seed : int
        Seed of k-means.

    Returns
    -------
    AnimPhoUnits
        With the paper's tables: T, which AnimPhos followed which in a sentence, and L, the AnimPhos
        of each phoneme.
    """
    cluster = np.empty(len(segments.samples), dtype=np.int64)
    centres: list[Array] = []
    phonemes: list[int] = []
    for phoneme in np.unique(segments.phonemes).tolist():
        rows = np.flatnonzero(segments.phonemes == phoneme)
        vectors = segments.samples[rows].reshape(len(rows), -1)
        phoneme_centres, nearest = _clustered(vectors, segments.weights[rows], seed)
        cluster[rows] = len(phonemes) + nearest
        centres.append(phoneme_centres)
        phonemes += [phoneme] * len(phoneme_centres)
    return _units(np.concatenate(centres), np.array(phonemes), cluster, segments, rest)


def clustered_alike(segments: Segments, rest: Array, component: int, seed: int) -> AnimPhoUnits:
    """Return the AnimPhos of one component as Wei and Deng print them: clusters of all segments.

    A cluster may hold segments of several phonemes. The paper does not say which of them the table
    L names; here it is the commonest.

    Parameters
    ----------
    segments : Segments
        Of the whole corpus.
    rest : Array
        (n_components,), the closed mouth.
    component : int
        Index of the component.
    seed : int
        Seed of k-means.

    Returns
    -------
    AnimPhoUnits
        m AnimPhos with samples of this component alone, (m, 5, 1).
    """
    vectors = segments.samples[:, :, component]
    with threadpool_limits(limits=1):
        centres, cluster = _clustered(vectors, segments.weights, seed)
    counts = np.zeros((len(centres), len(PHONEMES)))
    np.add.at(counts, (cluster, segments.phonemes), segments.weights)
    return _units(centres, counts.argmax(axis=1), cluster, segments, rest[[component]])


def _clustered(vectors: Array, weights: Array, seed: int) -> tuple[Array, NDArray[np.int64]]:
    """Cluster vectors by k-means; return centres (m, d), and the cluster of each vector, (n,).

    vectors: (n, d); weights: (n,). m is 0.26 n, rounded up, or the number of different vectors if
    that is smaller.
    """
    m = min(len(np.unique(vectors, axis=0)), math.ceil(_ANIMPHOS_PER_SEGMENT * len(vectors)))
    kmeans = KMeans(m, n_init=1, max_iter=_KMEANS_ITERATIONS, random_state=seed)
    cluster = kmeans.fit_predict(vectors, None, weights)
    return kmeans.cluster_centers_, np.asarray(cluster, dtype=np.int64)


def _units(
    centres: Array,
    phonemes: NDArray[np.int64],
    cluster: NDArray[np.int64],
    segments: Segments,
    rest: Array,
) -> AnimPhoUnits:
    """Make AnimPhos of clusters of segments, with the tables T and L.

    centres: (m, 5 n_components); phonemes: (m,), the label of each centre; cluster: (n,), the
    number of each segment's centre. Two AnimPhos may follow each other if two of their segments
    did.
    """
    m = len(centres)
    same_sentence = segments.sentence[:-1] == segments.sentence[1:]
    successors = IndexLists.from_pairs(cluster[:-1][same_sentence], cluster[1:][same_sentence], m)
    return AnimPhoUnits(
        rest=rest,
        samples=centres.reshape(m, SAMPLES_PER_ANIMPHO, len(rest)),
        successors=successors,
        predecessors=successors.transposed(m),
        phoneme_table=IndexLists.from_pairs(phonemes, np.arange(m), len(PHONEMES)),
    )


def _flat(utterance: Utterance) -> Array:
    """Return the markers as float64, (n_frames, 3 n_points)."""
    return utterance.markers_mm.reshape(len(utterance.markers_mm), -1).astype(np.float64)
