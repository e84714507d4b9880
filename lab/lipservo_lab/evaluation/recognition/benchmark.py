"""A recogniser measured on a corpus of transcribed speech.

Also how often a text that was not spoken passes as spoken, and the reverse.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lipservo_lab.baselines.visible_error import visible_error_table
from lipservo_lab.corpus.alignment_cache import LABELLED, PHONEME_INDEX, AlignedUtterance
from lipservo_lab.corpus.transcribed import TranscribedUtterance
from lipservo_lab.evaluation.recognition.conditions import (
    Condition,
)
from lipservo_lab.evaluation.recognition.recognition_scores import Score, phone_sequence
from lipservo_lab.evaluation.recognition.stream_observers import label_frames, time_to_leave
from lipsync.audio.file import read_speech
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.phonemes import SILENCE, LiveRecognizer
from lipsync.recognition.alignment import (
    DOUBTFUL_SCORE,
    LEAST_SCORE,
    AlignmentError,
    align,
    goodness_of_pronunciation,
)
from lipsync.recognition.features import FRAMES_PER_S
from lipsync.recognition.network import NetworkWeights
from lipsync.text_to_speech.pronunciation import PronunciationError

#: Number of recordings from which babble noise is made.
_N_VOICES = 20
#: Passes over a sound whose processor time is measured.
_N_PASSES = 5


@dataclass(frozen=True, slots=True)
class Figures:
    """What was measured on a corpus; `score.figures()` are the accuracies.

    n_phones: phones that the recogniser reported. cost_s: processor time of recognising, in all;
    block_cost_p50_s, block_cost_p99_s: of a block of 10 ms. n_default, n_labelled: utterances
    aligned at the default beams, and with labels of their own; these are scored. n_tight: aligned
    only with other beams; n_failed: not aligned. groups: scores of some of the speakers, by group.
    """

    score: Score
    n_utterances: int
    duration_s: float
    n_revisions: int
    n_phones: int
    cost_s: float
    block_cost_p50_s: float
    block_cost_p99_s: float
    n_default: int
    n_labelled: int
    n_tight: int
    n_failed: int
    groups: Mapping[str, Score] = field(default_factory=dict)

    def as_dict(self) -> dict[str, object]:
        """Return the figures by the keys of `lipservo bench recognition`, for JSON."""
        grouped: dict[str, object] = {
            name: {
                **score.figures(),
                "closures": score.bilabials.n_spoken,
                "utterances": score.n_utterances,
            }
            for name, score in sorted(self.groups.items())
        }
        return {
            **self.score.figures(),
            "visible_error_table": visible_error_table(self.score.confusion),
            "revisions_per_s": self.n_revisions / self.duration_s if self.duration_s else 0.0,
            "rtf": self.cost_s / self.duration_s if self.duration_s else 0.0,
            "ms_per_phoneme": 1e3 * self.cost_s / max(1, self.n_phones),
            "utterances": self.n_utterances,
            "seconds": self.duration_s,
            "alignment": {
                "default": self.n_default,
                "labelled": self.n_labelled,
                "tight_not_scored": self.n_tight,
            },
            "failed_alignments": self.n_failed,
            "block_ms_p50": 1e3 * self.block_cost_p50_s,
            "block_ms_p99": 1e3 * self.block_cost_p99_s,
            **({"groups": grouped} if grouped else {}),
        }


def measure(
    utterances: Sequence[TranscribedUtterance],
    alignments: Mapping[str, AlignedUtterance],
    make_recognizer: Callable[[], LiveRecognizer],
    condition: Condition | None = None,
    progress: Callable[[str], None] = lambda _name: None,
    groups_of: Callable[[str], Sequence[str]] = lambda _speaker: (),
    known_text_of: Callable[[TranscribedUtterance], str] = lambda _utterance: "",
) -> Figures:
    """Recognise every utterance as a new stream; return the figures against its alignment.

    Only utterances aligned at the default beams, or labelled, are scored. condition: changes the
    sound; None: as recorded. progress: called with each utterance's name. groups_of: returns the
    groups of a speaker. known_text_of: returns the text that the recogniser gets beforehand; empty:
    none.
    """
    counts = Counter(alignments[u.name].beams for u in utterances if not alignments[u.name].error)
    scored = [u for u in utterances if alignments[u.name].beams in ("default", LABELLED)]
    is_babble = condition is not None and condition.kind == "babble"
    step = max(1, len(utterances) // _N_VOICES)
    voices = [read_speech(u.sound) for u in utterances[::step]] if is_babble else []
    score, duration_s, n_revisions, n_reported = Score(), 0.0, 0, 0
    costs: list[np.ndarray] = []
    groups: dict[str, Score] = defaultdict(Score)
    recognizer = make_recognizer()
    for utterance in scored:
        samples = read_speech(utterance.sound)
        servos_deg = None
        if condition is not None:
            samples = condition.apply(samples, utterance.name, voices)
            servos_deg = condition.servo_positions_deg(utterance.name, len(samples))
        text = known_text_of(utterance)
        recognized, block_costs = label_frames(recognizer, samples, servos_deg, text)
        reference = alignments[utterance.name].labels(len(recognized.labels))
        for group_score in (score, *(groups[name] for name in groups_of(utterance.speaker))):
            group_score.add(recognized.labels, reference)
        duration_s += len(samples) / SAMPLE_RATE_HZ
        n_revisions += recognized.n_revisions
        n_reported += len(phone_sequence(recognized.labels))
        costs.append(np.array(block_costs.costs_s))
        progress(utterance.name)
    all_costs = np.concatenate(costs) if costs else np.zeros(1)
    return Figures(
        score=score,
        n_utterances=len(scored),
        duration_s=duration_s,
        n_revisions=n_revisions,
        n_phones=n_reported,
        cost_s=float(all_costs.sum()),
        block_cost_p50_s=float(np.median(all_costs)),
        block_cost_p99_s=float(np.percentile(all_costs, 99)),
        n_default=counts["default"],
        n_labelled=counts[LABELLED],
        n_tight=counts["tight"],
        n_failed=sum(bool(alignments[u.name].error) for u in utterances),
        groups=groups,
    )


def leaving_figures(
    utterances: Sequence[TranscribedUtterance],
    alignments: Mapping[str, AlignedUtterance],
    make_recognizer: Callable[[], LiveRecognizer],
    progress: Callable[[str], None] = lambda _name: None,
) -> dict[str, object]:
    """Return how soon a recogniser leaves a known text when the sound departs from it.

    Each utterance is followed by the one half the list away, while the text goes on with the one
    after that. Times count from the first phone of the second sound.
    """
    recognizer, half_away = make_recognizer(), len(utterances) // 2
    times_s: list[float | None] = []
    for number, utterance in enumerate(utterances):
        other = utterances[(number + half_away) % len(utterances)]
        text_source = utterances[(number + half_away + 1) % len(utterances)]
        sounds = read_speech(utterance.sound), read_speech(other.sound)
        n_frames = round(len(sounds[1]) / SAMPLE_RATE_HZ * FRAMES_PER_S)
        spoken = np.flatnonzero(alignments[other.name].labels(n_frames) != PHONEME_INDEX[SILENCE])
        if alignments[utterance.name].error or not len(spoken):
            continue
        onset_s = float(spoken[0]) / FRAMES_PER_S
        text = f"{utterance.text} {text_source.text}".lower()
        times_s.append(time_to_leave(recognizer, *sounds, onset_s, text).left_s)
        progress(utterance.name)
    left_s = [time_s for time_s in times_s if time_s is not None]
    return {
        "leaving_ms_p50": 1e3 * float(np.median(left_s)) if left_s else None,
        "leaving_ms_p95": 1e3 * float(np.percentile(left_s, 95)) if left_s else None,
        "leaving_within_300_ms": sum(time_s <= 0.3 for time_s in left_s) / max(1, len(times_s)),
        "leavings": len(times_s),
        "never_left": len(times_s) - len(left_s),
    }


def false_speech(
    recognizer: LiveRecognizer, samples: np.ndarray, servos_deg: np.ndarray | None = None
) -> float:
    """Return the share of 10 ms frames recognised as speech in sound (n,) without speech.

    servos_deg: positions of the robot's servos, as for `label_frames`.
    """
    labels = label_frames(recognizer, samples.astype(np.float32), servos_deg)[0].labels
    return float(np.mean(labels != PHONEME_INDEX[SILENCE])) if len(labels) else 0.0


def block_costs_s(recognizer: LiveRecognizer, samples: np.ndarray, text: str = "") -> np.ndarray:
    """Return the processor time of each 10 ms block, (m,) s: the least of five passes.

    The least is free of what other programs cost on a shared computer (caches emptied, memory
    slowed). text: known to the recogniser beforehand; empty: none.
    """
    passes = [label_frames(recognizer, samples, text=text)[1].costs_s for _ in range(_N_PASSES)]
    least: np.ndarray = np.min(passes, axis=0)
    return least


#: A false text is drawn from so many that are nearest in length to the true one, as aligners refuse
#: texts of other lengths.
_NEAREST = 5
KINDS = ("true", "other", "half_other", "half_missing")


def texts_of(
    utterance: TranscribedUtterance, pool: Sequence[TranscribedUtterance], rng: np.random.Generator
) -> dict[str, str]:
    """Return a text of each of `KINDS`: the spoken one, another, half of each, half of the spoken.

    pool: utterances whose texts may be the other one.
    """
    others = [u.text for u in pool if u.text != utterance.text]
    nearest = sorted(others, key=lambda text: abs(len(text) - len(utterance.text)))[:_NEAREST]
    spoken, other = utterance.text.split(), str(rng.choice(nearest)).split()
    half = max(1, len(spoken) // 2)
    word_lists = (spoken, other, [*spoken[:half], *other[half:]], spoken[:half])
    return {kind: " ".join(words) for kind, words in zip(KINDS, word_lists, strict=True)}


def score_texts(
    utterances: Sequence[TranscribedUtterance], weights: NetworkWeights, seed: int = 0
) -> Iterator[dict[str, float | None]]:
    """Yield for each utterance the score of a text of each kind; None where it cannot be aligned.

    weights: of the network that scores. seed: draws the other texts.
    """
    rng = np.random.default_rng(seed)
    for utterance in utterances:
        samples = read_speech(utterance.sound)
        scores: dict[str, float | None] = {}
        for kind, text in texts_of(utterance, utterances, rng).items():
            try:
                scores[kind] = goodness_of_pronunciation(
                    samples, align(samples, text).phones, weights
                )
            except (AlignmentError, PronunciationError):
                scores[kind] = None
        yield scores


def text_figures(scores: Sequence[dict[str, float | None]]) -> dict[str, object]:
    """Return for each kind of text how many were not aligned, refused, doubted and passed.

    scores: as `score_texts` yields them.
    """
    figures: dict[str, object] = {"utterances": len(scores)}
    classes: dict[str, Callable[[float], bool]] = {
        "refused": lambda score: score < LEAST_SCORE,
        "doubted": lambda score: LEAST_SCORE <= score < DOUBTFUL_SCORE,
        "passed": lambda score: score >= DOUBTFUL_SCORE,
    }
    for kind in KINDS:
        found = [score for text_scores in scores if (score := text_scores[kind]) is not None]
        figures[f"{kind}_not_aligned"] = len(scores) - len(found)
        for name, belongs in classes.items():
            figures[f"{kind}_{name}"] = sum(map(belongs, found))
        figures[f"{kind}_score_min_median_max"] = (
            [round(float(x), 2) for x in np.percentile(found, [0, 50, 100])] if found else None
        )
    return figures
