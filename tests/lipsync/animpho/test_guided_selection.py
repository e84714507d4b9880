"""Selection near a target, against costs worked out by hand: one component that differs."""

from dataclasses import replace

import numpy as np
import pytest
from small_model import small_model

from lipsync.animpho.selection import Choice, GuidedSelection, Joint, SelectionCosts
from lipsync.animpho.units import AnimPhoUnits, IndexLists
from lipsync.phonemes import PHONEMES

#: Numbers 0 to 3 are of AA, 4 is of another phoneme and fits best of all.
SAMPLES = ((0, 0, 0, 0, 0), (0, 1, 2, 3, 4), (10, 11, 12, 13, 14), (4, 3, 2, 1, 0), (0, 1, 2, 3, 5))
NEAREST = SelectionCosts(position=0.0, speed_s2=0.0, unconnected=0.0, chain=0.0)
STILL = np.zeros(1)


@pytest.fixture
def units() -> AnimPhoUnits:
    """Return four AnimPhos (recorded pieces) of AA and one of IY; only 3 follows 4."""
    aa, iy = PHONEMES.index("AA"), PHONEMES.index("IY")
    successors = IndexLists.from_pairs(np.array([4]), np.array([3]), 5)
    table = IndexLists.from_pairs(np.array([aa] * 4 + [iy]), np.arange(5), len(PHONEMES))
    return replace(
        small_model().animphos,
        rest=STILL,
        samples=np.array(SAMPLES, dtype=float)[:, :, None],
        successors=successors,
        predecessors=successors.transposed(5),
        phoneme_table=table,
    )


def after(number: int, *lengths: float) -> Choice:
    return Choice(number, False, np.array(lengths))


def joint(share=0.0, position=0.0, speed=0.0, previous=None) -> Joint:
    return Joint(share, np.array([position]), np.array([speed]), (1.0 - share) * 0.025, previous)


def column(*values: float) -> np.ndarray:
    return np.array(values, dtype=float)[:, None]


def test_the_animpho_nearest_to_the_target_where_it_lies_is_taken(units):
    chosen = GuidedSelection(units, NEAREST)
    best = chosen.choose("AA", column(0, 1, 2, 3, 5), joint())
    assert best.animpho == 1, "4 is no AA; 1 before 2, which moves alike 10 higher"
    assert chosen.choose("AA", column(9, 9, 9, 9, 9), joint()).animpho == 2
    assert chosen.choose("AA", column(5, 3, 2, 1, 0), joint()).animpho == 3


def test_of_a_phone_that_is_half_over_only_what_is_left_counts(units):
    """The second half of AnimPho 3 falls from 2, of AnimPho 1 it rises."""
    chosen = GuidedSelection(units, NEAREST)
    assert chosen.choose("AA", column(2, 1.6, 1, 0.5, 0), joint(share=0.5)).animpho == 3
    assert chosen.choose("AA", column(2, 2.4, 3, 3.5, 4), joint(share=0.5)).animpho == 1


#: AnimPho 0 is off by (.16 + .04 + 0 + .04 + .16) / 5 = .08; AnimPho 3, which follows 4, by
#: (4.4^2 + 3.2^2 + 2^2 + .8^2 + .4^2) / 5 = 6.88.
TARGET = column(-0.4, -0.2, 0.0, 0.2, 0.4)


@pytest.mark.parametrize(("unconnected", "expected"), [(6.7, 0), (6.9, 3)])
def test_what_does_not_follow_the_last_one_costs_more(units, unconnected, expected):
    chosen = GuidedSelection(units, replace(NEAREST, unconnected=unconnected))
    after_4, after_0 = after(4, 0, 0, 0, 0, 1), after(0, 1, 1, 1, 1, 0)
    assert chosen.choose("AA", TARGET, joint(previous=after_4)).animpho == expected
    assert chosen.choose("AA", TARGET, joint()).animpho == 0, "out of rest nothing is connected"
    assert chosen.choose("AA", TARGET, joint(previous=after_0)).animpho == 0, "nothing follows 0"


@pytest.mark.parametrize(("chain", "expected"), [(3.3, 0), (3.5, 3)])
def test_each_doubling_of_the_recorded_chain_is_worth_as_much(units, chain, expected):
    """Eq. (2): where the chain that ends in 4 spells three phonemes, that of 3 spells four."""
    chosen = GuidedSelection(units, replace(NEAREST, chain=chain))
    best = chosen.choose("AA", TARGET, joint(previous=after(4, 0, 0, 0, 0, 3)))
    assert best.animpho == expected
    assert best.chain_lengths.tolist() == [1, 1, 1, 4, 0]
    assert chosen.choose("AA", TARGET, joint()).chain_lengths.tolist() == [1, 1, 1, 1, 0]


def test_smoothness_counts_in_position_and_in_speed(units):
    """Their means are the target's; AnimPho 3 begins at 4 and falls by 4 in 0.1 s."""
    target = column(2, 2, 2, 2, 2)
    begins_there = GuidedSelection(units, replace(NEAREST, position=1.0))
    assert begins_there.choose("AA", target, joint(position=4.0)).animpho == 3
    assert begins_there.choose("AA", target, joint(position=0.0)).animpho == 1
    goes_that_way = GuidedSelection(units, replace(NEAREST, speed_s2=1.0))
    assert goes_that_way.choose("AA", target, joint(speed=-40.0)).animpho == 3
    assert goes_that_way.choose("AA", target, joint(speed=40.0)).animpho == 1
