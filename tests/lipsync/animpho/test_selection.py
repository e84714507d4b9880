"""Wei and Deng's two selection strategies, against the worked example of their Figures 4 and 5."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_model import small_model

from lipsync.animpho.selection import (
    Choice,
    NaiveSelection,
    PrioritySelection,
    chain_lengths,
    smoothness_energy,
)
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits, IndexLists
from lipsync.phonemes import PHONEMES

#: L: the AnimPhos of each phoneme, in the order in which the phonemes are heard.
SAYS = {"B": (1, 2, 3), "IY": (4, 5, 6), "T": (7, 8)}
#: T: who may follow whom.
BEFORE, AFTER = (1, 2, 5), (4, 5, 8)
#: The figures print no positions; in these 6, 5 and 7 are the smoothest where the text says so.
#: Number 0 is none; 3 begins at rest.
BEGINS = (1000.0, 5.0, 6.0, 0.0, 20.0, 12.0, 10.0, 30.0, 40.0)
ENDS = (1000.0, 8.0, 9.0, 10.0, 25.0, 39.0, 30.0, 35.0, 45.0)


@pytest.fixture
def figure_units() -> AnimPhoUnits:
    """The AnimPhos 1..8 of the figures under their own numbers, in one component."""
    n, says = len(BEGINS), [(PHONEMES.index(p), a) for p, many in SAYS.items() for a in many]
    follows = IndexLists.from_pairs(np.array(BEFORE), np.array(AFTER), n)
    return AnimPhoUnits(
        np.zeros(1),
        np.linspace(BEGINS, ENDS, SAMPLES_PER_ANIMPHO).T[:, :, None],
        follows,
        follows.transposed(n),
        IndexLists.from_pairs(*np.array(says).T, len(PHONEMES)),
    )


def choices(strategy, units, first, *others) -> list[Choice]:
    """What a strategy chooses for phonemes that follow one another."""
    chosen = [strategy.first(units, first)]
    for phoneme in others:
        chosen.append(strategy.following(units, phoneme, chosen[-1]))
    return chosen


def test_the_naive_strategy_takes_3_6_7_and_misses_twice(figure_units):
    chosen = choices(NaiveSelection(), figure_units, *SAYS)
    assert [c.animpho for c in chosen] == [3, 6, 7]
    assert [c.missed for c in chosen] == [False, True, True]


def test_the_priority_strategy_recovers_the_chain_2_5_8(figure_units):
    chosen = choices(PrioritySelection(), figure_units, *SAYS)
    assert [c.animpho for c in chosen] == [3, 5, 8]
    assert [c.missed for c in chosen] == [False, True, False]


def test_priorities_are_those_printed_in_the_figure(figure_units):
    first, second, third = choices(PrioritySelection(), figure_units, *SAYS)
    assert first.chain_lengths.tolist() == [0, 1, 1, 1, 0, 0, 0, 0, 0]
    assert second.chain_lengths.tolist() == [0, 0, 0, 0, 2, 2, 1, 0, 0]
    assert third.chain_lengths.tolist() == [0, 0, 0, 0, 0, 0, 0, 1, 3]


def test_smoothness_is_the_distance_from_last_frame_to_first(figure_units):
    assert smoothness_energy(figure_units, 3, np.array([4, 5, 6])).tolist() == [10.0, 2.0, 0.0]


def test_a_fallback_of_another_phoneme_is_a_miss_even_when_it_is_connected(figure_units):
    """After 1 comes 4 in the corpus, and 4 is smoothest, but it does not say the phoneme."""
    begins = np.array(figure_units.samples)
    begins[4, 0, 0] = ENDS[1]
    units = replace(figure_units, samples=begins)
    choice = NaiveSelection().following(units, "T", Choice(1, False, np.empty(0)))
    assert (choice.animpho, choice.missed) == (4, True)


def test_the_priority_strategy_ends_the_longest_chain_that_spells_what_was_heard():
    """In the small model every order of phonemes exists, so the chain grows with each of them."""
    heard = ("SIL", "M", "AA", "IY", "UW", "M", "IY", "SIL")
    chosen = choices(PrioritySelection(), small_model().animphos, *heard)
    assert [c.chain_lengths[c.animpho] for c in chosen] == [1, 2, 3, 4, 5, 6, 7, 8]


@given(st.lists(st.sampled_from(["SIL", "M", "AA", "IY", "UW"]), min_size=2, max_size=8))
def test_chain_lengths_equal_the_definition_of_equation_2(phonemes):
    units = small_model().animphos
    lengths = np.zeros(len(units))
    lengths[units.of_phoneme(phonemes[0])] = 1
    for phoneme in phonemes[1:]:
        candidates = units.of_phoneme(phoneme)
        expected = np.zeros_like(lengths)
        for i in candidates:
            through = [
                lengths[j] + 1
                for j in range(len(lengths))
                if lengths[j] and i in units.successors[j]
            ]
            expected[i] = max(through, default=1)
        lengths = chain_lengths(units, candidates, lengths)
        assert lengths.tolist() == expected.tolist()


def test_index_lists_read_back_the_table_and_its_transpose():
    lists = IndexLists.from_pairs(np.array([2, 0, 2, 2]), np.array([1, 3, 0, 1]), 4)
    assert [lists[i].tolist() for i in range(4)] == [[3], [], [0, 1], []]
    assert [lists.transposed(4)[j].tolist() for j in range(4)] == [[2], [2], [], [0]]
