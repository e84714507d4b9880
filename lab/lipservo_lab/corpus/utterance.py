"""Recorded sentences with mouth motion, and corpora of them.

Also a sentence's motion at another frame rate, and which frames count: speech, and in the new-words
test the new words alone.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from lipsync.errors import UserError
from lipsync.markers import PointLayout
from lipsync.phonemes import SILENCE, PhonemeEvent


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
    """One sentence: mouth motion, labels, and the path of its sound.

    markers_mm: (n_frames, n_points, 3), head motion removed, x to the picture's right, y up, z to
    the viewer. Frame i is at i / frame_rate_hz. phones: empty if alignment failed. weight: how
    often each of its frames counts in training; 1 is usual.
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
    """Sentences of one speaker in one head pose; or of several speakers, mapped to one face.

    layout: the points in `markers_mm`. head_reference_mm: (n_rigid, 3), mean skull-fixed points
    that every frame was fitted to; give it to the reader of another folder for the same pose.
    skipped: reasons for sentences left out.
    """

    name: str
    layout: PointLayout
    utterances: tuple[Utterance, ...]
    head_reference_mm: NDArray[np.float64]
    skipped: tuple[str, ...] = ()

    def labelled(self) -> "Corpus":
        """Return the corpus with only the sentences that have phones."""
        return self.keep({u.name for u in self.utterances if u.phones})

    def keep(self, names: set[str]) -> "Corpus":
        """Return the corpus with only the sentences of these names."""
        chosen = tuple(u for u in self.utterances if u.name in names)
        return Corpus(self.name, self.layout, chosen, self.head_reference_mm, self.skipped)

    def without(self, words: frozenset[str], names: frozenset[str]) -> "Corpus":
        """Return the corpus without sentences that contain one of `words` or are named in `names`.

        Raises CorpusError for a word that no sentence contains, and if no sentence is left.
        """
        words_of = {u.name: {word.text for word in u.words} for u in self.utterances}
        missing = words - {text for texts in words_of.values() for text in texts}
        if missing:
            raise CorpusError(f"{self.name}: no sentence holds {', '.join(sorted(missing))}")
        left = {name for name, texts in words_of.items() if not texts & words and name not in names}
        if not left:
            raise CorpusError(f"{self.name}: no sentence is left; leave out fewer")
        return self.keep(left)


#: Ratios of frame rates are of whole numbers up to this; 29.97 to 25 is off by 3 ms in an hour.
_LARGEST_TERM = 1200


def at_frame_rate(utterance: Utterance, frame_rate_hz: float) -> Utterance:
    """Return a sentence resampled to a frame at every i / frame_rate_hz, for its whole duration.

    By a polyphase filter, which removes what fewer frames cannot show; the motion is padded by the
    line through its first and last frame.
    """
    ratio = Fraction(frame_rate_hz / utterance.frame_rate_hz).limit_denominator(_LARGEST_TERM)
    if ratio == 1:
        return replace(utterance, frame_rate_hz=frame_rate_hz)
    markers_mm = resample_poly(
        utterance.markers_mm.astype(np.float64),
        ratio.numerator,
        ratio.denominator,
        axis=0,
        padtype="line",
    )
    return replace(utterance, markers_mm=markers_mm.astype(np.float32), frame_rate_hz=frame_rate_hz)


def speech_frames(utterance: Utterance, words: frozenset[str] | None = None) -> NDArray[np.bool_]:
    """Return which frames are in a phone other than silence, and in one of `words` if given.

    Parameters
    ----------
    utterance : Utterance
        With phone labels.
    words : frozenset[str] | None
        None: all words.

    Returns
    -------
    NDArray[np.bool_]
        (n_frames,).
    """
    times_s = np.arange(len(utterance.markers_mm)) / utterance.frame_rate_hz
    spoken = np.zeros(len(times_s), dtype=bool)
    for phone in utterance.phones:
        if phone.phoneme != SILENCE and phone.end_s is not None:
            spoken |= (times_s >= phone.start_s) & (times_s < phone.end_s)
    if words is not None:
        inside = np.zeros(len(times_s), dtype=bool)
        for word in utterance.words:
            if word.text in words:
                inside |= (times_s >= word.start_s) & (times_s < word.end_s)
        spoken &= inside
    return spoken
