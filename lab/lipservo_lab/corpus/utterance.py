"""Recorded sentences with mouth motion."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipsync.errors import UserError
from lipsync.markers import PointLayout
from lipsync.phonemes import PhonemeEvent


class CorpusError(UserError):
    """A corpus folder that cannot be read: says which file, what is wrong, what to do."""


@dataclass(frozen=True, slots=True)
class Word:
    """One spoken word in sound time."""

    text: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Utterance:
    """One sentence: mouth motion, labels, and where its sound lies.

    markers_mm: (n_frames, n_points, 3), head motion removed, x to the picture's right, y up,
    z to the viewer. Frame i is at i / frame_rate_hz. `phones` is empty where alignment failed.
    weight: how often each of its frames counts when a model is trained, beside those of others.
    """

    name: str
    markers_mm: NDArray[np.float32]
    frame_rate_hz: float
    sound_path: Path
    phones: tuple[PhonemeEvent, ...]
    words: tuple[Word, ...]
    weight: float = 1.0


@dataclass(frozen=True, slots=True)
class Corpus:
    """Sentences of one speaker in one common head pose; of several, with faces of one shape.

    layout: which points of the face `markers_mm` holds.
    head_reference_mm: (n_rigid, 3), the mean bone-fixed points that every frame was fitted to;
    hand it to the reader of another folder to bring that one into the same pose.
    """

    name: str
    layout: PointLayout
    utterances: tuple[Utterance, ...]
    head_reference_mm: NDArray[np.float64]
    skipped: tuple[str, ...] = ()

    def labelled(self) -> "Corpus":
        """Only the sentences that have phones."""
        return self.keep({u.name for u in self.utterances if u.phones})

    def keep(self, names: set[str]) -> "Corpus":
        """Only the sentences named."""
        chosen = tuple(u for u in self.utterances if u.name in names)
        return Corpus(self.name, self.layout, chosen, self.head_reference_mm, self.skipped)
