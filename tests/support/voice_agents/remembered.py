"""What an agent remembers against what left the loudspeaker of a `ServedFace`."""

from collections import Counter

import numpy as np
from lipservo_lab.bench.agents.remembered_words import worded_pcm, wrongly_remembered
from voice_agents.served_face import RATE_HZ


def numbered(turn, n_words):
    """Words of one length."""
    return [f"t{turn}w{100 + n}" for n in range(n_words)]


def sound(n_words, first=0):
    return worded_pcm(n_words, RATE_HZ, first)


def heard_values(face):
    return Counter(np.rint(face.sound.played() * 32_768).astype(int).tolist())


def heard_words(face):
    """How many words of sound have left the loudspeaker."""
    return np.count_nonzero(face.sound.played()) / len(sound(1)) * 2


def wrong(words, face, remembered):
    """(remembered and not heard, heard and forgotten) of all that the face has said."""
    return wrongly_remembered(words, heard_values(face), remembered, RATE_HZ)
