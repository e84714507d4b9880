"""The words of recorded sentences, slot by slot, and the motion of one word as a reader sees it."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from lipservo_lab.corpus.utterance import CorpusError, Utterance, Word
from lipsync.arrays import Array

#: A word is seen from so long before its beginning until so long after its end.
MARGIN_S = 0.08
#: And resampled to so many points, so that its duration is not seen.
N_POINTS = 12
#: Short pause and silence: how GRID's own labels write what is no word.
_PAUSES = ("sp", "sil")


def spoken_words(utterance: Utterance) -> tuple[Word, ...]:
    """The words of a sentence without its pauses; the n-th stands in slot n."""
    return tuple(word for word in utterance.words if word.text not in _PAUSES)


def slotted(utterances: Sequence[Utterance]) -> list[Utterance]:
    """The labelled sentences with as many words as most have: those whose slots are the same.

    Raises CorpusError where no sentence has words.
    """
    labelled = [u for u in utterances if u.phones and spoken_words(u)]
    if not labelled:
        raise CorpusError("no sentence has both phones and words; nothing can be read")
    n_slots = Counter(len(spoken_words(u)) for u in labelled).most_common(1)[0][0]
    return [u for u in labelled if len(spoken_words(u)) == n_slots]


def word_motion(values: Array, frame_rate_hz: float, word: Word) -> Array:
    """(n_frames, k) of a sentence -> (N_POINTS * k,): the word and a margin, resampled linearly."""
    frames_s = np.arange(len(values)) / frame_rate_hz
    points_s = np.linspace(word.start_s - MARGIN_S, word.end_s + MARGIN_S, N_POINTS)
    columns = [np.interp(points_s, frames_s, column) for column in values.T]
    return np.stack(columns, axis=1).ravel()
