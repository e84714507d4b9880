"""How accurate a recogniser is, against forced alignment, in the viseme classes of `phonemes`.

Frames are 10 ms. 'all' counts every frame, 'speech' those whose reference is not silence. Closures:
recall, precision, and how far the onsets recognised and spoken are apart.

`settled_score` scores weights on recordings by the phonemes that a live recogniser settles on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.baselines.visible_error import visible_error_mm
from lipservo_lab.corpus.alignment_cache import PHONEME_INDEX
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF, PhonemeEvent
from lipsync.recognition.batch import settled_phonemes
from lipsync.recognition.features import FRAMES_PER_S
from lipsync.recognition.network import LATENCY_S, NetworkWeights

#: A hit may be off by so many frames: boundaries of forced alignment are not more exact.
SLACK_FRAMES = 2
_FRAME_MS = 10.0


@dataclass(slots=True)
class HeardClosures:
    """Counts of one kind of closure, added up over utterances.

    n_spoken: closures in the reference; n_found: of these recognised. n_reported: closures that the
    recogniser reported; n_true: of these spoken. onset_errors_ms: of each one found, how much later
    than spoken it begins.
    """

    n_spoken: int = 0
    n_found: int = 0
    n_reported: int = 0
    n_true: int = 0
    onset_errors_ms: list[float] = field(default_factory=list)

    def add(self, found: NDArray[np.bool_], spoken: NDArray[np.bool_]) -> None:
        """Count one utterance.

        Parameters
        ----------
        found,spoken : NDArray[np.bool_]
            (n,): whether each frame was recognised, and was spoken, as a closure.
        """
        found_runs, spoken_runs = _runs(found), _runs(spoken)
        self.n_spoken += len(spoken_runs)
        self.n_reported += len(found_runs)
        self.n_true += sum(_touches(run, spoken) for run in found_runs)
        for run in spoken_runs:
            if _touches(run, found):
                self.n_found += 1
                nearest = min(found_runs, key=lambda other: _apart(other, run))
                self.onset_errors_ms.append(_FRAME_MS * (nearest[0] - run[0]))

    def figures(self, name: str) -> dict[str, float]:
        """Return recall and precision, 0 without any closure, and onset errors in ms.

        Onset errors: their median, and the 95th percentile of their amounts.
        """
        errors_ms = np.array(self.onset_errors_ms or [0.0])
        return {
            f"{name}_recall": self.n_found / self.n_spoken if self.n_spoken else 0.0,
            f"{name}_precision": self.n_true / self.n_reported if self.n_reported else 0.0,
            f"{name}_onset_error_ms_p50": float(np.median(errors_ms)),
            f"{name}_onset_error_ms_abs_p95": float(np.percentile(np.abs(errors_ms), 95)),
        }


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return each run of True: its first index, and that after its last."""
    borders = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return list(zip(borders[::2].tolist(), borders[1::2].tolist(), strict=True))


def _touches(run: tuple[int, int], flags: NDArray[np.bool_]) -> bool:
    """Return whether `flags` has a True in the run or within the slack around it."""
    first, end = run
    return bool(flags[max(0, first - SLACK_FRAMES) : end + SLACK_FRAMES].any())


def _apart(one: tuple[int, int], other: tuple[int, int]) -> tuple[int, int]:
    """Return the frames between two runs, 0 where they overlap, and those between their onsets."""
    return max(0, one[0] - other[1], other[0] - one[1]), abs(one[0] - other[0])


Labels = NDArray[np.int64]

_CLASS_OF = np.array([VISEME_OF[phoneme] for phoneme in PHONEMES])
_SILENCE_INDEX = PHONEMES.index(SILENCE)
_SILENT_CLASS = VISEME_OF[SILENCE]
#: Viseme classes of touching lips, and of the lower lip at the teeth.
_CLOSED_CLASS, _BITTEN_CLASS = VISEME_OF["P"], VISEME_OF["F"]


@dataclass(slots=True)
class Score:
    """Counts, added up over utterances; every figure is a quotient of two of them.

    confusion: (n_visemes, n_visemes) frames by class of reference and of hypothesis. bilabials: P B
    M; labiodentals: F V. n_edits: edit distance of phone sequences.
    """

    n_frames: int = 0
    n_speech: int = 0
    n_phones_right: int = 0
    n_speech_phones_right: int = 0
    n_phones: int = 0
    n_edits: int = 0
    bilabials: HeardClosures = field(default_factory=HeardClosures)
    labiodentals: HeardClosures = field(default_factory=HeardClosures)
    n_utterances: int = 0
    confusion: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros((len(VISEME_CLASSES),) * 2, np.int64)
    )

    def add(self, hypothesis: Labels, reference: Labels) -> None:
        """Add one utterance to the counts.

        hypothesis, reference: (n_frames,), the phoneme recognised and the one spoken in each frame
        of 10 ms, as indices into `PHONEMES`.
        """
        is_speech = reference != _SILENCE_INDEX
        is_right = hypothesis == reference
        hypothesis_class, true_class = _CLASS_OF[hypothesis], _CLASS_OF[reference]
        self.n_frames += len(hypothesis)
        self.n_speech += int(is_speech.sum())
        self.n_phones_right += int(is_right.sum())
        self.n_speech_phones_right += int(is_right[is_speech].sum())
        np.add.at(self.confusion, (true_class, hypothesis_class), 1)
        self.bilabials.add(hypothesis_class == _CLOSED_CLASS, true_class == _CLOSED_CLASS)
        self.labiodentals.add(hypothesis_class == _BITTEN_CLASS, true_class == _BITTEN_CLASS)
        found_phones, spoken_phones = phone_sequence(hypothesis), phone_sequence(reference)
        self.n_phones += len(spoken_phones)
        self.n_edits += edit_distance(found_phones, spoken_phones)
        self.n_utterances += 1

    def figures(self) -> dict[str, float]:
        """Return how accurate the recognition is, by figure's name; 0 where nothing was counted.

        phone_, viseme_: share of frames recognised right, of all frames or those of speech.
        closure_ (P B M), labiodental_ (F V): see `HeardClosures.figures`. per: phone error rate.
        visible_error_mm: mean distance between the lip shapes recognised and spoken.
        """
        visemes_right = np.diag(self.confusion)
        return {
            "phone_all": _share(self.n_phones_right, self.n_frames),
            "phone_speech": _share(self.n_speech_phones_right, self.n_speech),
            "viseme_all": _share(int(visemes_right.sum()), self.n_frames),
            "viseme_speech": _share(
                int(visemes_right.sum() - visemes_right[_SILENT_CLASS]), self.n_speech
            ),
            **self.bilabials.figures("closure"),
            **self.labiodentals.figures("labiodental"),
            "per": _share(self.n_edits, self.n_phones),
            "visible_error_mm": visible_error_mm(self.confusion),
        }


def phone_sequence(labels: Labels) -> list[int]:
    """Return the phones in order, each run of equal frames as one, without silence."""
    return [label for label, _ in groupby(labels.tolist()) if label != _SILENCE_INDEX]


def edit_distance(found: Sequence[int], spoken: Sequence[int]) -> int:
    """Return the Levenshtein distance: fewest insertions, deletions and substitutions."""
    spoken_array = np.asarray(spoken)
    steps = np.arange(len(spoken) + 1)
    costs = steps.copy()
    for index, phone in enumerate(found, start=1):
        from_above = np.minimum(costs[:-1] + (spoken_array != phone), costs[1:] + 1)
        without_deletions = np.concatenate(([index], from_above))
        # Deletions go along the row: the least of any cost to the left plus the steps from there.
        costs = np.minimum.accumulate(without_deletions - steps) + steps
    return int(costs[-1])


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 0.0


def settled_score(
    weights: NetworkWeights, recordings: Sequence[LabelledSamples], latency_s: float = LATENCY_S
) -> Score:
    """Return the score of what the live recogniser settles on, each recording as a new stream.

    As `benchmark.measure`, without its streams and costs: many times quicker.
    """
    score = Score()
    settled = settled_phonemes(weights, [each.samples for each in recordings], latency_s)
    for recording, events in zip(recordings, settled, strict=True):
        score.add(_labels(events, len(recording.labels)), recording.labels)
    return score


def _labels(events: Sequence[PhonemeEvent], n_frames: int) -> Labels:
    """Return the phoneme index of each frame, (n_frames,).

    events: without gaps, up to the end.
    """
    labels = np.empty(n_frames, np.int64)
    for event in events:
        first = round(event.start_s * FRAMES_PER_S)
        labels[first:] = PHONEME_INDEX[event.phoneme]
    return labels
