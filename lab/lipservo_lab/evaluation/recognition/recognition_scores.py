"""How accurate a recogniser is, against forced alignment, in the scoring classes of `phonemes`.

Frames are 10 ms. 'all' counts every frame, 'speech' those whose reference is not silence.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.evaluation.recognition.heard_closures import SLACK_FRAMES, HeardClosures
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF

Labels = NDArray[np.int64]

_CLASS_OF = np.array([VISEME_OF[phoneme] for phoneme in PHONEMES])
_SILENCE_INDEX = PHONEMES.index(SILENCE)
_SILENT_CLASS = VISEME_OF[SILENCE]
#: Where the lips touch each other, and where the lower one touches the teeth.
_CLOSED_CLASS, _BITTEN_CLASS = VISEME_OF["P"], VISEME_OF["F"]
#: Vowels for which the jaw comes down.
_OPEN_CLASSES = tuple(VISEME_OF[vowel] for vowel in ("EH", "AA", "AO"))


@dataclass(slots=True)
class Score:
    """Counts, added up over utterances; every figure is a quotient of two of them.

    `confusion` (n_visemes, n_visemes): frames by class of reference and hypothesis. bilabials:
    P B M; labiodentals: F V; openings: vowels for which the jaw comes down, those of the classes
    of EH, AA and AO, counted in the same way.
    """

    n_frames: int = 0
    n_speech: int = 0
    n_phones_right: int = 0
    n_speech_phones_right: int = 0
    n_slack_right: int = 0
    n_phones: int = 0
    n_edits: int = 0
    bilabials: HeardClosures = field(default_factory=HeardClosures)
    labiodentals: HeardClosures = field(default_factory=HeardClosures)
    openings: HeardClosures = field(default_factory=HeardClosures)
    phone_all_by_utterance: list[float] = field(default_factory=list)
    confusion: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros((len(VISEME_CLASSES),) * 2, np.int64)
    )

    def add(self, hypothesis: Labels, reference: Labels) -> None:
        """Count one utterance: phoneme numbers (n,) as in `PHONEMES`."""
        is_speech = reference != _SILENCE_INDEX
        right = hypothesis == reference
        hypothesis_class, true_class = _CLASS_OF[hypothesis], _CLASS_OF[reference]
        self.n_frames += len(hypothesis)
        self.n_speech += int(is_speech.sum())
        self.n_phones_right += int(right.sum())
        self.n_speech_phones_right += int(right[is_speech].sum())
        self.n_slack_right += int(_right_nearby(hypothesis_class, true_class)[is_speech].sum())
        np.add.at(self.confusion, (true_class, hypothesis_class), 1)
        self.bilabials.add(hypothesis_class == _CLOSED_CLASS, true_class == _CLOSED_CLASS)
        self.labiodentals.add(hypothesis_class == _BITTEN_CLASS, true_class == _BITTEN_CLASS)
        self.openings.add(
            np.isin(hypothesis_class, _OPEN_CLASSES), np.isin(true_class, _OPEN_CLASSES)
        )
        said, spoken = phone_sequence(hypothesis), phone_sequence(reference)
        self.n_phones += len(spoken)
        self.n_edits += edit_distance(said, spoken)
        self.phone_all_by_utterance.append(float(right.mean()))

    def figures(self) -> dict[str, float]:
        """All figures by name; 0 where nothing was counted."""
        visemes_right = np.diag(self.confusion)
        return {
            "phone_all": _share(self.n_phones_right, self.n_frames),
            "phone_speech": _share(self.n_speech_phones_right, self.n_speech),
            "viseme_all": _share(int(visemes_right.sum()), self.n_frames),
            "viseme_speech": _share(
                int(visemes_right.sum() - visemes_right[_SILENT_CLASS]), self.n_speech
            ),
            "viseme_speech_slack20": _share(self.n_slack_right, self.n_speech),
            **self.bilabials.figures("closure"),
            **self.labiodentals.figures("labiodental"),
            **self.openings.figures("opening"),
            "per": _share(self.n_edits, self.n_phones),
        }

    def agreement(self) -> tuple[float, float, float]:
        """Least, median and most phone accuracy of an utterance: figure 1 of the paper."""
        if not self.phone_all_by_utterance:
            return 0.0, 0.0, 0.0
        ordered = self.phone_all_by_utterance
        return min(ordered), float(np.median(ordered)), max(ordered)


def phone_sequence(labels: Labels) -> list[int]:
    """The phones in order, each run of frames once, without silence."""
    return [label for label, _ in groupby(labels.tolist()) if label != _SILENCE_INDEX]


def edit_distance(said: Sequence[int], spoken: Sequence[int]) -> int:
    """Fewest insertions, deletions and substitutions that make one of the other (Levenshtein)."""
    spoken_row = np.asarray(spoken)
    steps = np.arange(len(spoken) + 1)
    costs = steps.copy()
    for index, phone in enumerate(said, start=1):
        steps_down = np.minimum(costs[:-1] + (spoken_row != phone), costs[1:] + 1)
        best = np.concatenate(([index], steps_down))
        # Deletions run along the row: the least of what stands to the left plus the way from there.
        costs = np.minimum.accumulate(best - steps) + steps
    return int(costs[-1])


def _right_nearby(hypothesis: Labels, reference: Labels) -> NDArray[np.bool_]:
    """Whether each class of the hypothesis is the reference's anywhere within the slack."""
    padded = np.pad(reference, SLACK_FRAMES, constant_values=-1)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * SLACK_FRAMES + 1)
    nearby: NDArray[np.bool_] = (windows == hypothesis[:, None]).any(axis=1)
    return nearby


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 0.0
