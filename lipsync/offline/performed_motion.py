"""A synthesiser that plays performances, and other motion before, between and after them.

The process that plays a face loads this module, so it needs NumPy only.
"""

import math
from collections.abc import Callable
from dataclasses import replace
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
#: Times after a frame, s, for which a performance's faces are given: joints are planned over them.
_AHEAD_S: Final[Array] = np.linspace(0.0, 0.2, 11)


class StoredMotion:
    """The faces and expressions of a performance (a rendered line) at any time, linear in between.

    By linear interpolation lips that are stored closed stay closed.
    """

    def __init__(self, performance: Performance) -> None:
        self._faces = performance.coefficients
        self._names = tuple(performance.expression)
        columns = [performance.expression[name] for name in self._names]
        self._expressions = np.array(columns, dtype=np.float32).T
        self._last_s = performance.duration_s

    def face_at(self, at_s: float, otherwise: Array) -> Array:
        """Return the stored face at `at_s`; outside the performance, a face eased to `otherwise`.

        The easing, from the first or the last stored face, lasts 0.2 s.

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
            return self._interpolated(self._faces, at_s)
        end = self._faces[0 if at_s < 0.0 else -1].astype(np.float64)
        return _ease(end, otherwise, outside_s)

    def is_over(self, at_s: float) -> bool:
        """Return whether the easing after the last face is complete, but for a tick."""
        return at_s >= self._last_s + EASING_S - 1.5 / RATE_HZ

    def expression_at(self, at_s: float) -> Expression:
        """Return the stored expression `at_s` seconds after the beginning of the performance.

        Outside the performance it is the first or the last; NO_EXPRESSION where none is stored.
        """
        if not self._names:
            return NO_EXPRESSION
        values = self._interpolated(self._expressions, min(max(0.0, at_s), self._last_s))
        return Expression(**dict(zip(self._names, values.tolist(), strict=True)))

    def _interpolated(self, rows: NDArray[np.float32], at_s: float) -> Array:
        """Return the row (k,) at `at_s` seconds of `rows` (n, k), 100 a second, interpolated."""
        frames = at_s * RATE_HZ
        before = min(math.floor(frames), len(rows) - 1)
        after = min(before + 1, len(rows) - 1)
        share = frames - before
        pair = rows[[before, after]].astype(np.float64)
        return np.asarray((1.0 - share) * pair[0] + share * pair[1])


class PerformedMotion:
    """A synthesiser that plays performances (rendered lines); an inner one moves all other speech.

    The inner one is also computed during a performance, so that its state is up to date afterwards.
    """

    def __init__(
        self,
        inner: Synthesizer,
        performed_at: Callable[[float], tuple[StoredMotion, float] | None],
        gap: LipGap,
    ) -> None:
        """Create the synthesiser around `inner`; `gap` measures the gap between the lips of a face.

        performed_at: returns for a sound time the motion performed then, and the seconds since its
        first face, from -`EASING_S` to `EASING_S` after its last face; None for no performance.
        """
        self._inner = inner
        self._gap = gap
        self._performed_at = performed_at
        # The sound time and the face of the newest performed frame, from which motion goes on.
        self._newest_s = -math.inf
        self._face: Array = np.zeros(0)

    @property
    def phonemes_planned(self) -> int:
        """The number of phonemes that have moved the inner synthesiser's mouth."""
        return self._inner.phonemes_planned

    @property
    def lookahead_s(self) -> float:
        """Seconds of sound after a frame's time that the inner synthesiser needs for the frame."""
        return self._inner.lookahead_s

    def reset(self) -> None:
        """Reset the inner synthesiser for a new stream; leave the performances as they are."""
        self._inner.reset()
        self._newest_s = -math.inf

    def push(self, update: PhonemeUpdate) -> None:
        """Pass an update of the phonemes to the inner synthesiser."""
        self._inner.push(update)

    def frame_at(self, time_s: float) -> Frame:
        """Return the performed frame at sound time `time_s`; without one, the inner synthesiser's.

        After a performance that was dropped midway, the face is eased to the inner synthesiser's.
        """
        frame = self._inner.frame_at(time_s)
        performed = self._performed_at(time_s)
        if performed is None:
            # It may have been dropped in the middle: the mouth goes on from there.
            since_s = time_s - self._newest_s
            if since_s < 0.0:
                return frame
            return replace(frame, coefficients=_ease(self._face, frame.coefficients, since_s))
        motion, at_s = performed
        face = motion.face_at(at_s, frame.coefficients)
        if time_s >= self._newest_s:
            self._newest_s, self._face = (-math.inf if motion.is_over(at_s) else time_s), face
        return Frame(time_s, face, motion.expression_at(at_s))

    def window_after(self, frame: Frame) -> FaceWindow:
        """Return the faces expected after `frame`: the next 200 ms of a performance.

        Where no performance plays, return the inner synthesiser's window.
        """
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
        """Return the inner synthesiser's phoneme at `time_s`, or None where none is known."""
        return self._inner.event_at(time_s)


def _ease(start: Array, end: Array, after_s: float) -> Array:
    """Return the face `after_s` seconds after `start` on a cubic to `end` that lasts 0.2 s."""
    if after_s >= EASING_S:
        return end
    share = after_s / EASING_S
    return np.asarray(start + share * share * (3.0 - 2.0 * share) * (end - start))
