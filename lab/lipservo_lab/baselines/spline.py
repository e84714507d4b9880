"""Catmull-Rom splines through the centres of phones; they see the whole sentence.

Catmull and Rom, "A class of local interpolating splines", 1974; non-uniform, each slope the
difference of the two neighbours over their distance in time.
"""

from collections.abc import Sequence

import numpy as np

from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_OF, PhonemeEvent


def viseme_centres(centres: Array, counts: Array) -> Array:
    """(40, n_components): each phoneme's centre replaced by the mean of its class.

    counts: (40,), how often each phoneme was heard in training.
    """
    classes = np.array([VISEME_OF[p] for p in PHONEMES])
    found = centres.copy()
    for number in range(classes.max() + 1):
        members = classes == number
        if counts[members].sum() > 0:
            found[members] = np.average(centres[members], axis=0, weights=counts[members])
    return found


def spline_faces(phones: Sequence[PhonemeEvent], targets: Array, times_s: Array) -> Array:
    """(n, n_components) at times (n,); targets: (40, n_components), a face for each phoneme."""
    return joined_faces(phones, targets[[PHONEMES.index(p.phoneme) for p in phones]], times_s)


def joined_faces(phones: Sequence[PhonemeEvent], targets: Array, times_s: Array) -> Array:
    """(n, n_components) at times (n,); targets: (n_phones, n_components), a face for each phone.

    It is reached at the phone's centre, that of a silence at both its edges.
    """
    knots: list[tuple[float, int]] = []
    for number, phone in enumerate(phones):
        end_s = phone.start_s if phone.end_s is None else phone.end_s
        if phone.phoneme == SILENCE:
            knots += [(phone.start_s, number), (end_s, number)]
        else:
            knots.append(((phone.start_s + end_s) / 2.0, number))
    at_s = np.array([t for t, _ in knots])
    distinct = np.concatenate([[True], np.diff(at_s) > 1e-6])
    at_s, values = at_s[distinct], targets[[i for _, i in knots]][distinct]
    if len(at_s) < 2:
        return np.repeat(values[:1], len(times_s), axis=0)
    slopes = np.zeros_like(values)
    slopes[1:-1] = (values[2:] - values[:-2]) / (at_s[2:] - at_s[:-2])[:, None]
    t = np.clip(times_s, at_s[0], at_s[-1])
    i = np.clip(np.searchsorted(at_s, t, side="right") - 1, 0, len(at_s) - 2)
    width = (at_s[i + 1] - at_s[i])[:, None]
    u = (t - at_s[i])[:, None] / width
    faces = (1 + 2 * u) * (1 - u) ** 2 * values[i] + u**2 * (3 - 2 * u) * values[i + 1]
    faces += (u * (1 - u) ** 2 * slopes[i] + u**2 * (u - 1) * slopes[i + 1]) * width
    return np.asarray(faces)
