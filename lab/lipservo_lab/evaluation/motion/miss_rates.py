"""How often selection finds no AnimPho that is both right and connected."""

from collections.abc import Iterable, Sequence

from lipsync.animpho.selection import Choice, SelectionStrategy
from lipsync.animpho.units import AnimPhoUnits
from lipsync.phonemes import SILENCE, PhonemeEvent, stand_in


def miss_rate(
    units: AnimPhoUnits, strategy: SelectionStrategy, sentences: Iterable[Sequence[PhonemeEvent]]
) -> float:
    """Misses over all phonemes that follow another; 0 when there is none. See `count_misses`."""
    misses, total = count_misses(units, strategy, sentences)
    return misses / total if total else 0.0


def count_misses(
    units: AnimPhoUnits, strategy: SelectionStrategy, sentences: Iterable[Sequence[PhonemeEvent]]
) -> tuple[int, int]:
    """(misses, phonemes that follow another).

    A miss: the chosen AnimPho is not in L(p_t) and T(a_{t-1}) both (Wei and Deng, Figure 6). A
    silence begins a new chain, whose first phoneme cannot miss and is not counted.
    """
    misses = total = 0
    for sentence in sentences:
        choice: Choice | None = None
        for event in sentence:
            if event.phoneme == SILENCE:
                choice = None
                continue
            for phoneme in stand_in(event.phoneme, units.known_phonemes):
                if choice is None:
                    choice = strategy.first(units, phoneme)
                    continue
                choice = strategy.following(units, phoneme, choice)
                misses += choice.missed
                total += 1
    return misses, total
