"""Selection near a target, against costs worked out by hand: one component that differs."""

from dataclasses import replace

import numpy as np
import pytest
from small_model import small_model

from lipsync.animpho.selection import GuidedSelection, Joint, SelectionCosts
from lipsync.animpho.units import AnimPhoUnits, IndexLists
from lipsync.phonemes import PHONEMES

#: Numbers 0 to 3 are of AA, 4 is of another phoneme and fits best of all.
SAMPLES = ((0, 0, 0, 0, 0), (0, 1, 2, 3, 4), (10, 11, 12, 13, 14), (4, 3, 2, 1, 0), (0, 1, 2, 3, 5))
NEAREST = SelectionCosts(position=0.0, speed_s2=0.0, unconnected=0.0)
STILL = np.zeros(1)


@pytest.fixture
def units() -> AnimPhoUnits:
    """Only AnimPho 3 follows AnimPho 4."""
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


def joint(share=0.0, position=0.0, speed=0.0, previous=None) -> Joint:
    return Joint(share, np.array([position]), np.array([speed]), (1.0 - share) * 0.025, previous)


def column(*values: float) -> np.ndarray:
    return np.array(values, dtype=float)[:, None]


def test_the_animpho_that_moves_most_like_the_target_is_taken_wherever_it_lies(units):
    chosen = GuidedSelection(units, NEAREST)
    assert chosen.choose("AA", column(0, 1, 2, 3, 5), joint()) == 1, "4 is no AA; 1 before 2, equal"
    assert chosen.choose("AA", column(7, 7, 7, 7, 7), joint()) == 0
    assert chosen.choose("AA", column(5, 3, 2, 1, 0), joint()) == 3


def test_of_a_phone_that_is_half_over_only_what_is_left_counts(units):
    """The second half of AnimPho 3 falls by 2, of AnimPho 1 it rises."""
    chosen = GuidedSelection(units, NEAREST)
    assert chosen.choose("AA", column(9, 8.5, 8, 7.5, 7), joint(share=0.5)) == 3
    assert chosen.choose("AA", column(7, 7.5, 8, 8.5, 9), joint(share=0.5)) == 1


def test_what_does_not_follow_the_last_one_costs_more(units):
    """About their means: AnimPho 0 is off by 4 * .04 + .04 + .04 + .16 = .4 in 5 samples, so .08;

    AnimPho 3, which follows, by (2.4^2 + 1.2^2 + 0 + 1.2^2 + 2.4^2) / 5 = 2.88.
    """
    target = column(-0.4, -0.2, 0.0, 0.2, 0.4)
    for unconnected, expected in ((2.7, 0), (2.9, 3)):
        chosen = GuidedSelection(units, SelectionCosts(0.0, 0.0, unconnected))
        assert chosen.choose("AA", target, joint(previous=4)) == expected
    assert chosen.choose("AA", target, joint()) == 0, "out of rest nothing is connected"
    assert chosen.choose("AA", target, joint(previous=0)) == 0, "nothing follows 0: all cost alike"


def test_smoothness_counts_in_position_and_in_speed(units):
    """Moved to the target's mean of 2, AnimPho 3 begins at 4 and falls by 4 in 0.1 s."""
    target = column(2, 2, 2, 2, 2)
    begins_there = GuidedSelection(units, SelectionCosts(1.0, 0.0, 0.0))
    assert begins_there.choose("AA", target, joint(position=4.0)) == 3
    assert begins_there.choose("AA", target, joint(position=0.0)) == 1
    goes_that_way = GuidedSelection(units, SelectionCosts(0.0, 1.0, 0.0))
    assert goes_that_way.choose("AA", target, joint(speed=-40.0)) == 3
    assert goes_that_way.choose("AA", target, joint(speed=40.0)) == 1
