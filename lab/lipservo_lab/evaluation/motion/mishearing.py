"""Phoneme sequences with errors put in, to see how synthesis copes with a recogniser's errors."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent

KINDS = ("substitution", "insertion", "deletion")
_SPOKEN = tuple(p for p in PHONEMES if p != SILENCE)


def misheard(
    events: Sequence[PhonemeEvent], kind: str, rate: float, rng: np.random.Generator
) -> tuple[PhonemeEvent, ...]:
    """A share `rate` of the spoken phonemes is hit; the sentence keeps its length.

    substitution: any other phoneme; insertion: any phoneme takes the second half; deletion: the
    phoneme before goes on over it. Raises ValueError for another kind.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown kind of error {kind!r}; known here: {', '.join(KINDS)}")
    made: list[PhonemeEvent] = []
    for event in events:
        if event.phoneme == SILENCE or event.end_s is None or rng.random() >= rate:
            made.append(event)
            continue
        other = str(rng.choice([p for p in _SPOKEN if p != event.phoneme]))
        if kind == "substitution":
            made.append(replace(event, phoneme=other))
        elif kind == "insertion":
            middle_s = (event.start_s + event.end_s) / 2.0
            made.append(replace(event, end_s=middle_s))
            made.append(replace(event, phoneme=other, start_s=middle_s))
        elif made:
            made[-1] = replace(made[-1], end_s=event.end_s)
        else:
            made.append(replace(event, phoneme=SILENCE))
    return tuple(made)
