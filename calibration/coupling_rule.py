"""Joints that must not go there together, as a calibration keeps them.

The face's YAML is where such a rule is written (`PreventSettings`, joints by name), and
`PreventSettings.factors` is the one place where names become numbers. The gate has a type of its
own, `PreventRule`, since calibration and gate may not import one another and do different things
with a rule: the gate cuts a step short, here a pose is scaled towards neutral.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array

_SAME_DEG = 1e-9


@dataclass(frozen=True, slots=True)
class CouplingRule:
    """sum_s weights_s x angle_s <= at_most_deg, e.g. lips that would run into each other.

    weights: (n_servos,), 0 for a joint that has no part in it; at_most_deg >= 0: neutral is free.
    """

    weights: Array
    at_most_deg: float


def keep_rules(rules: Sequence[CouplingRule], positions_deg: Array) -> Array:
    """(n_servos,) within the limits -> the same, scaled towards neutral until no rule is broken.

    The joints of a broken rule go back by the same share of their way, which stays within limits
    that hold 0. Where that breaks another rule in turn, all joints go back together.
    """
    for rule in rules:
        reached_deg = float(rule.weights @ positions_deg)
        if reached_deg > rule.at_most_deg + _SAME_DEG:
            share = rule.at_most_deg / reached_deg
            positions_deg = np.where(rule.weights != 0.0, share * positions_deg, positions_deg)
    for rule in rules:
        reached_deg = float(rule.weights @ positions_deg)
        if reached_deg > rule.at_most_deg + _SAME_DEG:
            positions_deg = positions_deg * (rule.at_most_deg / reached_deg)
    return positions_deg
