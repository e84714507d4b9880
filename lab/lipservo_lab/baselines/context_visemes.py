"""Context visemes: recorded phones, chosen for a line by the phones before and after them.

Edge, Hilton and Jackson compare their method with the centres of the best-matching context visemes,
joined by Catmull-Rom splines (`baselines.joined_faces`). They do not print what matches best; here
viseme classes decide, then phonemes, then duration. The face of a phone is that of one recording,
not a mean, so the motion jitters where that of means is too small.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipservo_lab.corpus.utterance import Utterance
from lipsync.arrays import Array, Indices
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_OF, PhonemeEvent, stand_in

_CLASS_OF = np.array([VISEME_OF[p] for p in PHONEMES])
_BEFORE, _ITSELF, _AFTER = range(3)


@dataclass(frozen=True, slots=True)
class ContextVisemes:
    """Recorded phones in the order in which they were spoken.

    phonemes: (n, 3), indices in PHONEMES of the phone before, of itself, and of the one after;
    silence beyond a sentence. durations_s: (n,). faces: (n, n_components), at each phone's centre.
    """

    phonemes: Indices
    durations_s: Array
    faces: Array

    def best_for(self, phones: Sequence[PhonemeEvent]) -> Indices:
        """Return the index of a recorded phone for each phone of a line, (n_phones,).

        The recorded phone has the same viseme class, and as many of its two neighbours as possible
        have the classes of the line's. Of several such: the same phoneme goes before another of its
        class, then more equal neighbours, then the closest duration, then the earlier recording. A
        class that was never recorded is replaced by that of the phoneme's first stand-in.
        """
        recorded = np.unique(self.phonemes[:, _ITSELF])
        known = frozenset(PHONEMES[i] for i in recorded)
        contexts = _contexts(phones)
        for context in contexts:
            if not np.isin(_CLASS_OF[context[_ITSELF]], _CLASS_OF[recorded]):
                context[_ITSELF] = PHONEMES.index(stand_in(PHONEMES[context[_ITSELF]], known)[0])
        durations_s = _durations_s(phones)
        best = [self._best(*arguments) for arguments in zip(contexts, durations_s, strict=True)]
        return np.array(best, dtype=np.int64)

    def targets(self, phones: Sequence[PhonemeEvent]) -> Array:
        """Return the recorded face for each phone of a line.

        Parameters
        ----------
        phones : Sequence[PhonemeEvent]
            Phones of the line, in order.

        Returns
        -------
        Array
            (n_phones, n_components).
        """
        return np.asarray(self.faces[self.best_for(phones)])

    def _best(self, context: Indices, duration_s: float) -> int:
        """Return the index of the recorded phone that matches a context best, as `best_for` ranks.

        context: (3,) indices in PHONEMES of the phone before, of itself, and of the one after.
        """
        same_class = _CLASS_OF[self.phonemes] == _CLASS_OF[context]
        same = self.phonemes == context
        neighbours = [_BEFORE, _AFTER]
        # np.lexsort: the last key counts most; the smallest values come first.
        keys = (
            np.abs(self.durations_s - duration_s),
            -same[:, neighbours].sum(axis=1),
            -same[:, _ITSELF].astype(np.int64),
            -same_class[:, neighbours].sum(axis=1),
            -same_class[:, _ITSELF].astype(np.int64),
        )
        return int(np.lexsort(keys)[0])


def recorded_visemes(
    utterances: Sequence[Utterance], coefficients: Sequence[Array]
) -> ContextVisemes:
    """Collect every phone of labelled sentences.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Sentences with phone labels.
    coefficients : Sequence[Array]
        Face coefficients (n_frames, n_components) of each.

    Returns
    -------
    ContextVisemes
        Faces (n_phones, n_components), and contexts.
    """
    faces = []
    for utterance, motion in zip(utterances, coefficients, strict=True):
        frames_s = np.arange(len(motion)) / utterance.frame_rate_hz
        starts_s = np.array([p.start_s for p in utterance.phones])
        centres_s = starts_s + _durations_s(utterance.phones) / 2.0
        faces.append(np.stack([np.interp(centres_s, frames_s, x) for x in motion.T], axis=1))
    return ContextVisemes(
        np.concatenate([_contexts(u.phones) for u in utterances]),
        np.concatenate([_durations_s(u.phones) for u in utterances]),
        np.concatenate(faces),
    )


def _contexts(phones: Sequence[PhonemeEvent]) -> Indices:
    """Return the phoneme before each phone, its own, and that after it, (n_phones, 3) numbers."""
    silence = PHONEMES.index(SILENCE)
    names = [silence, *(PHONEMES.index(p.phoneme) for p in phones), silence]
    return np.array([names[i : i + 3] for i in range(len(phones))], dtype=np.int64)


def _durations_s(phones: Sequence[PhonemeEvent]) -> Array:
    """Return durations, (n_phones,) s; 0 for a phone whose end is not known."""
    return np.array([0.0 if p.end_s is None else p.end_s - p.start_s for p in phones])
