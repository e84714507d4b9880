"""Strength: how far the mouth moves from rest, for any synthesiser."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lipsync.face.frame import Frame
from lipsync.motion.wrapped_synthesizer import TrackedSynthesizer, WrappedSynthesizer

Array = NDArray[np.float64]


class ScaledSynthesizer(WrappedSynthesizer):
    """Multiplies the mouth's distance from rest; closures belong outside of it."""

    def __init__(self, inner: TrackedSynthesizer, rest: Array, strength: float) -> None:
        """rest: (n_components,). strength: 0 keeps the mouth at rest, 1 changes nothing."""
        super().__init__(inner)
        self._rest = rest
        self._strength = strength

    def frame_at(self, time_s: float) -> Frame:
        """The frame inside, its mouth brought nearer to rest or farther from it."""
        frame = self._inner.frame_at(time_s)
        if self._strength == 1.0:
            return frame
        scaled = self._rest + self._strength * (frame.coefficients - self._rest)
        return replace(frame, coefficients=scaled)
