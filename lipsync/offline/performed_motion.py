"""Performances on a face that does something else before, between and after them.

The process that plays a face loads this module, so it needs NumPy only.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.face.frame import NO_EXPRESSION, Expression, FaceWindow, Frame, Synthesizer
from lipsync.motion.finishing import LipGap
from lipsync.offline.performance import RATE_HZ, Performance
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate

#: From what the mouth does otherwise to the first face, and from the last one back.
EASING_S = 0.2
#: What a performance shows is known: joints are planned over this window.
_AHEAD_S: Final[Array] = np.linspace(0.0, 0.2, 11)


class StoredMotion:
    """The faces and expressions of a performance at any time, linear between neighbouring frames.

    So lips that are stored closed stay closed.
    """

    def __init__(self, performance: Performance) -> None:
        self._faces = performance.coefficients
        self._names = tuple(performance.expression)
        columns = [performance.expression[name] for name in self._names]
        self._expressions = np.array(columns, dtype=np.float32).T
        self._last_s = performance.duration_s

    def face_at(self, at_s: float, otherwise: Array) -> Array:
        """Return the stored face at a time; outside the performance, one eased to `otherwise`.

        Parameters
        ----------
        at_s : float
            Seconds from the beginning of the performance.
        otherwise : Array
            (n_components,), the inner synthesiser's face.

        Returns
        -------
        Array
            (n_components,).
        """
        outside_s = max(-at_s, at_s - self._last_s)
        if outside_s <= 0.0:
            return self._between(self._faces, at_s)
        end = self._faces[0 if at_s < 0.0 else -1].astype(np.float64)
        return _eased(end, otherwise, outside_s)

    def expression_at(self, at_s: float) -> Expression:
        """Return the stored expression at a time; outside the performance, that of its end."""
        if not self._names:
            return NO_EXPRESSION
        values = self._between(self._expressions, min(max(0.0, at_s), self._last_s))
        return Expression(**dict(zip(self._names, values.tolist(), strict=True)))

    def _between(self, rows: NDArray[np.float32], at_s: float) -> Array:
        frames = at_s * RATE_HZ
        before = min(math.floor(frames), len(rows) - 1)
        after = min(before + 1, len(rows) - 1)
        share = frames - before
        pair = rows[[before, after]].astype(np.float64)
        return np.asarray((1.0 - share) * pair[0] + share * pair[1])


class PerformedMotion:
    """A synthesiser that plays performed lines, and leaves all other speech to an inner one.

    The inner one goes on meanwhile, so its state is up to date when the performance is over.
    """

    def __init__(
        self,
        inner: Synthesizer,
        performed_at: Callable[[float], tuple[StoredMotion, float] | None],
        gap: LipGap,
    ) -> None:
        """Create the synthesiser around `inner`.

        performed_at: from a sound time to the motion performed then and the time within it, from
        -`EASING_S` to `EASING_S` after its last face; None: nothing. gap: between the lips.
        """
        self._inner = inner
        self._gap = gap
        self._performed_at = performed_at
        # What was performed last; it goes on from there.
        self._newest_s = -math.inf
        self._newest: Array = np.zeros(0)

    @property
    def phonemes_planned(self) -> int:
        """The number of phonemes that have moved the inner synthesiser's mouth."""
        return self._inner.phonemes_planned

    @property
    def lookahead_s(self) -> float:
        """Seconds of sound needed after an instant before its frame can be computed."""
        return self._inner.lookahead_s

    def reset(self) -> None:
        """Reset the inner synthesiser for a new stream; performances stay."""
        self._inner.reset()
        self._newest_s = -math.inf

    def push(self, update: PhonemeUpdate) -> None:
        """Pass a revision of the phonemes to the inner synthesiser."""
        self._inner.push(update)

    def frame_at(self, time_s: float) -> Frame:
        """Return the performed frame at a sound time; where none is, the inner synthesiser's."""
        frame = self._inner.frame_at(time_s)
        performed = self._performed_at(time_s)
        if performed is None:
            # It may have been dropped in the middle: the mouth goes on from there.
            since_s = time_s - self._newest_s
            face = frame.coefficients
            return Frame(time_s, _eased(self._newest, face, since_s)) if since_s >= 0.0 else frame
        motion, at_s = performed
        face = motion.face_at(at_s, frame.coefficients)
        if time_s >= self._newest_s:
            self._newest_s, self._newest = time_s, face
        return Frame(time_s, face, motion.expression_at(at_s))

    def window_after(self, frame: Frame) -> FaceWindow:
        """Return the faces after a frame: 200 ms of a performance, else the inner synthesiser's."""
        performed = self._performed_at(frame.time_s)
        if performed is None:
            return self._inner.window_after(frame)
        motion, at_s = performed
        faces = [motion.face_at(at_s + step_s, frame.coefficients) for step_s in _AHEAD_S.tolist()]
        faces[0] = frame.coefficients
        rows = np.array(faces)
        closed = self._gap.begin_to_touch(rows)
        return FaceWindow(_AHEAD_S, rows, closed, self._gap.shut(frame.coefficients))

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """Return the inner synthesiser's phoneme at a sound time, or None where none is known."""
        return self._inner.event_at(time_s)


def _eased(start: Array, end: Array, after_s: float) -> Array:
    """Return the face `after_s` after `start` on a cubic to `end` that takes `EASING_S`."""
    if after_s >= EASING_S:
        return end
    share = after_s / EASING_S
    return np.asarray(start + share * share * (3.0 - 2.0 * share) * (end - start))
