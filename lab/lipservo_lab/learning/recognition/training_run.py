"""One training from corpora to weights: align, split by speaker, augment, train, write a log."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from firmware_bridge.stop_signals import SignalCounter
from lipservo.terminal.output import Advance
from lipservo_lab.corpus.alignment_cache import AlignedUtterance, align_corpus
from lipservo_lab.corpus.transcribed import (
    TranscribedUtterance,
    of_speakers,
    read_transcribed,
    without_names,
)
from lipservo_lab.counted_progress import counting
from lipservo_lab.learning.recognition import noise
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipservo_lab.learning.recognition.network_training import SCORE, STATE, train_network
from lipservo_lab.learning.recognition.noise import read_found_sounds
from lipservo_lab.learning.recognition.retimed_labels import taught_by
from lipservo_lab.learning.recognition.synthetic_corpus import SyntheticVoice, write_voice
from lipservo_lab.learning.recognition.training_data import (
    TrainingArray,
    TrainingError,
    TrainingPlan,
    as_array,
    feature_scale,
    read_labelled,
    training_arrays,
)
from lipservo_lab.learning.recognition.weight_average import averaged
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF
from lipsync.recognition.alignment import LEAST_SCORE
from lipsync.recognition.features import FeatureScale
from lipsync.recognition.network import NetworkWeights, StreamingNetwork

#: The scale needs no more than every sixth utterance.
_SCALE_STEP = 6
#: Validation utterances of each corpus; more do not change the curve.
_MOST_VALIDATION = 40
#: Prefix of the names of conditions that are one corpus each.
_CORPUS = "corpus_"
#: Texts that a synthetic voice reads: short enough for every synthesiser, long enough for prosody.
_TEXT_CHARACTERS = range(20, 200)
_CLASS_OF = np.array([VISEME_OF[phoneme] for phoneme in PHONEMES])
_MEMBERSHIP = np.eye(len(VISEME_CLASSES), dtype=np.float32)[_CLASS_OF]


@dataclass(frozen=True, slots=True)
class TrainingRun:
    """What to learn from, and where the run is stored.

    held_out, validation: names of speakers; left_out: names of utterances. limit: most utterances
    of each speaker; None: all. voices: synthetic ones, which read n_texts_each texts of the
    training corpora each. sounds: folders of files without speech. start: weights to go on from;
    start_share: their share in the mean that is returned. teacher: network that times the labels of
    training utterances anew, leaves out those whose text it does not find, and whose posteriors are
    learned too; None: the aligner's labels are learned. resumes: whether a run in the folder goes
    on.
    """

    corpora: tuple[Path, ...]
    folder: Path
    held_out: frozenset[str] = frozenset()
    validation: frozenset[str] = frozenset()
    left_out: frozenset[str] = frozenset()
    limit: int | None = None
    voices: tuple[SyntheticVoice, ...] = ()
    n_texts_each: int = 200
    sounds: tuple[Path, ...] = ()
    start: NetworkWeights | None = None
    start_share: float = 0.0
    teacher: NetworkWeights | None = None
    resumes: bool = False
    n_copies: int = 10
    n_processes: int = 1
    plan: TrainingPlan = field(default_factory=TrainingPlan)


def run_training(run: TrainingRun, advance: Advance) -> NetworkWeights:
    """Train the network; an interrupted run goes on from what its folder holds.

    advance: called with the work, the amount done and all. Held-out and left-out utterances are not
    even aligned. Validation uses the aligner's labels. Raises TrainingError if no utterance is
    left, if two utterances have one name, and for a folder with a run that is not to go on;
    TrainingStoppedError after SIGTERM or Ctrl-C, with the state saved; TranscriptError if an
    utterance to be left out is in none of the corpora.
    """
    run.folder.mkdir(parents=True, exist_ok=True)
    plan = run.plan
    if not run.resumes and (run.folder / STATE).exists():
        raise TrainingError(
            f"{run.folder}: holds a run already; go on with --resume, or give another --folder"
        )
    sounds = [sound for folder in run.sounds for sound in read_found_sounds(folder)]
    utterances, alignments = _aligned(run, advance)
    usable = [u for u in utterances if _is_spoken(alignments[u.name])]
    training = [u for u in usable if u.speaker not in run.validation]
    if not training:
        raise TrainingError("no utterance is left to learn from; hold out fewer speakers")
    clean = [read_labelled(u, alignments[u.name]) for u in training]
    taught = None
    if run.teacher is not None:
        retimed = taught_by(
            run.teacher,
            [(recording, alignments[u.name]) for recording, u in zip(clean, training, strict=True)],
            lambda n: advance("teaching", n, len(training)),
        )
        if not retimed.recordings:
            raise TrainingError("--teacher finds no text in its sound; give other weights")
        clean, taught = list(retimed.recordings), retimed.taught
    scale = feature_scale(clean[::_SCALE_STEP]) if run.start is None else run.start.scale
    arrays = []
    for array in training_arrays(
        clean,
        scale,
        plan.delays,
        n_heavy=run.n_copies,
        seed=plan.seed,
        found_sounds=sounds,
        is_taught=taught is not None,
        n_processes=min(run.n_processes, 1 + run.n_copies),
    ):
        arrays.append(array)
        advance("disturbing", len(arrays), 1 + run.n_copies)
    validation = [u for u in usable if u.speaker in run.validation]
    conditions = _conditions(validation, alignments, scale, plan.delays)
    with SignalCounter() as stops:

        def after_step(n: int) -> bool:
            advance("learning", n, plan.n_steps)
            return stops.count > 0

        trained = train_network(
            arrays,
            scale,
            plan,
            folder=run.folder,
            start=run.start,
            taught=taught,
            check=lambda _step, weights: checked(weights, conditions, plan),
            after_step=after_step,
        )
    return trained if run.start is None else averaged(trained, run.start, run.start_share)


def checked(
    weights: NetworkWeights, conditions: Mapping[str, TrainingArray], plan: TrainingPlan
) -> dict[str, float]:
    """Return the validation figures, and the score by which the best weights are chosen.

    The score is the mean over corpora, each counting alike, of the accuracy of viseme classes in
    speech, at the head with the largest weight in the loss.

    Parameters
    ----------
    weights : NetworkWeights
        Of the network to score.
    conditions : Mapping[str, TrainingArray]
        Features of shape (n, 40) and targets, by name.
    plan : TrainingPlan
        With the delays and weights of the heads.

    Returns
    -------
    dict[str, float]
        0 to 1, by name; without `score` if no condition is a corpus.
    """
    found = figures(weights, conditions)
    delay = plan.delays[int(np.argmax(plan.head_weights))]
    each = [found[f"{c}_delay{delay}_viseme_speech"] for c in conditions if c.startswith(_CORPUS)]
    return found | ({SCORE: float(np.mean(each))} if each else {})


def figures(weights: NetworkWeights, conditions: Mapping[str, TrainingArray]) -> dict[str, float]:
    """Return frame accuracies without a decoder: phones and viseme classes, for each condition.

    Parameters
    ----------
    weights : NetworkWeights
        Of the network to score.
    conditions : Mapping[str, TrainingArray]
        Features of shape (n, 40) and targets, by name.

    Returns
    -------
    dict[str, float]
        0 to 1, by `CONDITION_delayD_phone_all`, `_viseme_all` and `_viseme_speech`.
    """
    found: dict[str, float] = {}
    silence = PHONEMES.index(SILENCE)
    for name, array in conditions.items():
        posteriors = StreamingNetwork(weights).push(array.features.astype(np.float32))
        for head, delay in enumerate(weights.delays):
            has_target = array.targets[:, head] >= 0
            targets = array.targets[has_target, head]
            head_posteriors = posteriors[has_target, head]
            visemes_right = (head_posteriors @ _MEMBERSHIP).argmax(axis=1) == _CLASS_OF[targets]
            key = f"{name}_delay{delay}"
            found[f"{key}_phone_all"] = float(np.mean(head_posteriors.argmax(axis=1) == targets))
            found[f"{key}_viseme_all"] = float(np.mean(visemes_right))
            found[f"{key}_viseme_speech"] = float(np.mean(visemes_right[targets != silence]))
    return found


def _aligned(
    run: TrainingRun, advance: Advance
) -> tuple[list[TranscribedUtterance], dict[str, AlignedUtterance]]:
    """Return all utterances to train and validate with, also synthetic ones, and their alignments.

    Alignments are by utterance name, and kept in `alignments.jsonl` of the run's folder. Raises
    TrainingError for two utterances of one name.
    """
    all_utterances = tuple(u for corpus in run.corpora for u in read_transcribed(corpus))
    names = Counter(u.name for u in all_utterances)
    if twice := [name for name, count in names.items() if count > 1]:
        raise TrainingError(f"utterance {twice[0]!r} is in two corpora; rename it in one of them")
    utterances = [
        utterance
        for utterance in without_names(all_utterances, run.left_out)
        if utterance.speaker not in run.held_out
    ]
    utterances = list(of_speakers(tuple(utterances), frozenset(), run.limit))
    utterances += _synthetic_utterances(run, utterances, advance)
    alignments = align_corpus(
        tuple(utterances),
        run.folder / "alignments.jsonl",
        n_processes=run.n_processes,
        progress=counting(advance, "aligning", len(utterances)),
    )
    return utterances, alignments


def _is_spoken(aligned: AlignedUtterance) -> bool:
    """Return whether the text of an utterance was spoken, by the score of its alignment.

    Learners and children often say other words than their text, and its labels would be wrong.
    """
    return not aligned.error and (aligned.score is None or aligned.score >= LEAST_SCORE)


def _synthetic_utterances(
    run: TrainingRun, utterances: Sequence[TranscribedUtterance], advance: Advance
) -> list[TranscribedUtterance]:
    """Let each synthetic voice speak its share of the training texts; return the utterances.

    Sounds and labels are written below `synthetic` in the run's folder.
    """
    texts = [
        utterance.text
        for utterance in utterances
        if utterance.speaker not in run.validation and len(utterance.text) in _TEXT_CHARACTERS
    ]
    spoken: list[TranscribedUtterance] = []
    count = counting(advance, "speaking", len(run.voices) * run.n_texts_each)
    for number, voice in enumerate(run.voices):
        share = texts[number :: len(run.voices)][: run.n_texts_each]
        folder = run.folder / "synthetic"
        corpus = write_voice(voice, share, folder, seed=run.plan.seed, progress=count)
        spoken += read_transcribed(corpus)
    return spoken


def _conditions(
    validation: Sequence[TranscribedUtterance],
    alignments: Mapping[str, AlignedUtterance],
    scale: FeatureScale,
    delays: Sequence[int],
) -> dict[str, TrainingArray]:
    """Return validation arrays by name: clean, in white noise at 10 dB, and 30 dB quieter.

    Also one clean array for each corpus, named by `_CORPUS` and the corpus. Empty without
    utterances.
    """
    if not validation:
        return {}
    by_corpus: dict[str, list[LabelledSamples]] = {}
    for corpus in sorted({_corpus_of(u) for u in validation}):
        of_corpus = [u for u in validation if _corpus_of(u) == corpus]
        step = max(1, len(of_corpus) // _MOST_VALIDATION)
        by_corpus[corpus] = [read_labelled(u, alignments[u.name]) for u in of_corpus[::step]]
    recordings = [recording for listed in by_corpus.values() for recording in listed]
    rng = np.random.default_rng(0)
    noisy = [
        replace(h, samples=noise.add_noise(h.samples, noise.white(rng, len(h.samples)), 10.0))
        for h in recordings
    ]
    quiet = [replace(h, samples=h.samples * np.float32(10.0**-1.5)) for h in recordings]
    recordings_of = {"clean": recordings, "white_10db": noisy, "level_-30db": quiet}
    recordings_of |= {f"{_CORPUS}{corpus}": listed for corpus, listed in by_corpus.items()}
    return {name: as_array(labelled, scale, delays) for name, labelled in recordings_of.items()}


def _corpus_of(utterance: TranscribedUtterance) -> str:
    """Return the name of an utterance's corpus: the folder above the sound's folder."""
    return utterance.sound.parent.parent.name
