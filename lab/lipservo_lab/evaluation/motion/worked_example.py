"""The example of Wei and Deng's Figures 4 and 5: eight AnimPhos of three phonemes.

An AnimPho is a recorded piece of motion.

The figures show which AnimPhos belong to a phoneme and which follow which, but not their positions.
The positions here are chosen so that 6, 5 and 7 are the smoothest where the text says so. AnimPhos
have the paper's numbers, 1 to 8; number 0 is none.
"""

from typing import Final

import numpy as np

from lipsync.animpho.selection import Choice, SelectionStrategy
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits, IndexLists
from lipsync.phonemes import PHONEMES

#: L: the AnimPhos of each phoneme, in the order in which the phonemes are heard.
SAYS: Final = {"B": (1, 2, 3), "IY": (4, 5, 6), "T": (7, 8)}
#: T: pairs of an AnimPho and one that may follow it.
FOLLOWS: Final = ((1, 4), (2, 5), (5, 8))
#: Begin and end of each AnimPho, in one component. 3 begins at rest; 6 and then 7 go on most
#: smoothly; of 4 and 5, 5 is the smoother one after 3.
BEGINS: Final = (1000.0, 5.0, 6.0, 0.0, 20.0, 12.0, 10.0, 30.0, 40.0)
ENDS: Final = (1000.0, 8.0, 9.0, 10.0, 25.0, 39.0, 30.0, 35.0, 45.0)


def example_units() -> AnimPhoUnits:
    """Return the AnimPhos of the example."""
    n = len(BEGINS)
    rows = [PHONEMES.index(phoneme) for phoneme, numbers in SAYS.items() for _ in numbers]
    columns = [number for numbers in SAYS.values() for number in numbers]
    before, after = np.array(FOLLOWS).T
    successors = IndexLists.from_pairs(before, after, n)
    return AnimPhoUnits(
        np.zeros(1),
        np.linspace(BEGINS, ENDS, SAMPLES_PER_ANIMPHO).T[:, :, None],
        successors,
        successors.transposed(n),
        IndexLists.from_pairs(np.array(rows), np.array(columns), len(PHONEMES)),
    )


def choices(strategy: SelectionStrategy, units: AnimPhoUnits, *phonemes: str) -> list[Choice]:
    """Return a strategy's choices for phonemes that follow one another."""
    first, *others = phonemes
    chosen = [strategy.first(units, first)]
    for phoneme in others:
        chosen.append(strategy.following(units, phoneme, chosen[-1]))
    return chosen
