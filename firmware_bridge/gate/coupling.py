"""Joints that must not go there together: rules that the last gate holds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_bridge.arrays import Array

_SAME_DEG = 1e-9


@dataclass(frozen=True, slots=True)
class PreventRule:
    """sum of factors x joint degrees stays at most `above`. factors: one a joint, 0 = no part."""

    factors: tuple[float, ...]
    above: float
    because: str


class Prevention:
    """Cuts a step short where it would break a rule; a step out of a broken rule is free."""

    def __init__(self, rules: Sequence[PreventRule], n_joints: int) -> None:
        """Raises ValueError unless every rule has a factor for each joint and allows neutral."""
        for rule in rules:
            if len(rule.factors) != n_joints or rule.above < 0.0:
                raise ValueError(f"rule {rule.because!r} does not fit {n_joints} joints at rest")
        self._factors = [np.array(rule.factors) for rule in rules]
        self._parts = [factors != 0.0 for factors in self._factors]
        self._above = [rule.above for rule in rules]

    def cut(self, from_deg: Array, to_deg: Array) -> Array:
        """The goals to go to instead of `to_deg`, (n_joints,) all.

        All joints of a rule stop at the same share of their step. Cutting for one rule may undo
        what another needs, so it is repeated; when that does not help, the step is not made.
        """
        if not self._factors:
            return to_deg
        for _ in range(len(self._factors)):
            before = to_deg
            for factors, parts, above in zip(self._factors, self._parts, self._above, strict=True):
                start, end = float(factors @ from_deg), float(factors @ to_deg)
                if end > above + _SAME_DEG and end > start:
                    share = max(0.0, (above - start) / (end - start))
                    to_deg = np.where(parts, from_deg + share * (to_deg - from_deg), to_deg)
            if to_deg is before:
                return to_deg
        broken = any(
            factors @ to_deg > max(above, float(factors @ from_deg)) + _SAME_DEG
            for factors, above in zip(self._factors, self._above, strict=True)
        )
        return from_deg if broken else to_deg
