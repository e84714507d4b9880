"""What each phoneme asks of the mouth, in numbers, so that sounds never seen resemble seen ones.

The features are those of the IPA chart (place, manner, voice; for vowels openness, backness and
rounding, at the beginning and at the end, so that a diphthong moves). Graded values are ours: only
their order matters to a model that learns from them.
"""

import numpy as np

from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES, SILENCE

#: Vowels: openness, backness and rounding, each at the beginning and at the end, 0 to 1.
_VOWELS: dict[str, tuple[float, float, float, float, float, float]] = {
    "IY": (0.1, 0.1, 0.0, 0.0, 0.0, 0.0),
    "IH": (0.3, 0.3, 0.2, 0.2, 0.0, 0.0),
    "EH": (0.55, 0.55, 0.2, 0.2, 0.0, 0.0),
    "AE": (0.8, 0.8, 0.2, 0.2, 0.0, 0.0),
    "AA": (1.0, 1.0, 0.8, 0.8, 0.1, 0.1),
    "AH": (0.6, 0.6, 0.6, 0.6, 0.0, 0.0),
    "AO": (0.8, 0.8, 1.0, 1.0, 0.6, 0.6),
    "UH": (0.3, 0.3, 0.8, 0.8, 0.6, 0.6),
    "UW": (0.1, 0.1, 0.8, 0.8, 1.0, 1.0),
    "ER": (0.4, 0.4, 0.5, 0.5, 0.4, 0.4),
    "EY": (0.5, 0.15, 0.2, 0.0, 0.0, 0.0),
    "AY": (1.0, 0.2, 0.6, 0.1, 0.0, 0.0),
    "OW": (0.55, 0.2, 0.8, 0.8, 0.5, 1.0),
    "AW": (0.95, 0.3, 0.6, 0.8, 0.0, 0.8),
    "OY": (0.7, 0.2, 1.0, 0.1, 0.7, 0.0),
}

_PLACES = ("labial", "labiodental", "dental", "alveolar", "palatal", "velar", "glottal")
_MANNERS = ("stop", "fricative", "affricate", "nasal", "approximant")

#: Consonants: place, manner, voiced, rounding 0 to 1.
_CONSONANTS: dict[str, tuple[str, str, bool, float]] = {
    "P": ("labial", "stop", False, 0.0),
    "B": ("labial", "stop", True, 0.0),
    "M": ("labial", "nasal", True, 0.0),
    "F": ("labiodental", "fricative", False, 0.0),
    "V": ("labiodental", "fricative", True, 0.0),
    "TH": ("dental", "fricative", False, 0.0),
    "DH": ("dental", "fricative", True, 0.0),
    "T": ("alveolar", "stop", False, 0.0),
    "D": ("alveolar", "stop", True, 0.0),
    "N": ("alveolar", "nasal", True, 0.0),
    "S": ("alveolar", "fricative", False, 0.0),
    "Z": ("alveolar", "fricative", True, 0.0),
    "L": ("alveolar", "approximant", True, 0.0),
    "SH": ("palatal", "fricative", False, 0.6),
    "ZH": ("palatal", "fricative", True, 0.6),
    "CH": ("palatal", "affricate", False, 0.6),
    "JH": ("palatal", "affricate", True, 0.6),
    "Y": ("palatal", "approximant", True, 0.0),
    "R": ("palatal", "approximant", True, 0.6),
    "K": ("velar", "stop", False, 0.0),
    "G": ("velar", "stop", True, 0.0),
    "NG": ("velar", "nasal", True, 0.0),
    "W": ("velar", "approximant", True, 1.0),
    "HH": ("glottal", "fricative", False, 0.0),
}


def articulatory_features() -> Array:
    """(40, 22), a row for each of `PHONEMES`.

    Columns: silence, vowel, consonant; openness, backness, rounding, each at the beginning and at
    the end; the places; the manners; voiced.
    """
    return np.array([_features(phoneme) for phoneme in PHONEMES])


def _features(phoneme: str) -> list[float]:
    kind = [0.0, 0.0, 0.0]
    shape = [0.0] * 6
    place, manner, voiced = [0.0] * len(_PLACES), [0.0] * len(_MANNERS), 0.0
    if phoneme == SILENCE:
        kind[0] = 1.0
    elif phoneme in _VOWELS:
        kind[1], voiced = 1.0, 1.0
        shape = list(_VOWELS[phoneme])
    else:
        kind[2] = 1.0
        where, how, is_voiced, rounding = _CONSONANTS[phoneme]
        place[_PLACES.index(where)] = 1.0
        manner[_MANNERS.index(how)] = 1.0
        shape[4] = shape[5] = rounding
        voiced = float(is_voiced)
    return [*kind, *shape, *place, *manner, voiced]
