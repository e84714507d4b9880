"""Closures: the lips touch in P B M and come near in F V, whatever the synthesiser inside does."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from lipsync.face.frame import Frame
from lipsync.motion.amount import Amount
from lipsync.motion.closure_plan import BILABIALS, LABIODENTALS, OPEN, planned
from lipsync.motion.lip_closure import BILABIAL_GAP_MM, LipGap
from lipsync.motion.tick_plan import TICK_S, TickPlan
from lipsync.motion.wrapped_synthesizer import TrackedSynthesizer, WrappedSynthesizer
from lipsync.phonemes import PHONEMES


@dataclass(frozen=True, slots=True)
class _Closures:
    """How far the lips are being closed, of both kinds."""

    bilabial: Amount = OPEN
    labiodental: Amount = OPEN


class ClosingSynthesizer(WrappedSynthesizer):
    """Narrows the lip gap of the frames inside where a phoneme asks for it; the outermost part."""

    def __init__(
        self,
        inner: TrackedSynthesizer,
        gap: LipGap,
        *,
        labiodental_gap_mm: float,
        tightest_s: Mapping[str, float],
        known_s: float,
    ) -> None:
        """labiodental_gap_mm: how near the inner lips come in F and V.

        tightest_s: for each of P B M F V, when after its onset the lips are nearest. known_s: how
        far beyond its tick a decision may look, s.
        """
        super().__init__(inner)
        self._gap = gap
        self._labiodental_gap_mm = labiodental_gap_mm
        self._bilabial_s = _by_number(tightest_s, BILABIALS)
        self._labiodental_s = _by_number(tightest_s, LABIODENTALS)
        self._known_s = known_s
        self._ticks = TickPlan(_Closures())

    def reset(self) -> None:
        """Forget everything; the mouth is closed and the stream begins anew at sound time 0."""
        super().reset()
        self._ticks = TickPlan(_Closures())

    def frame_at(self, time_s: float) -> Frame:
        """The frame inside, its lips brought as near as the closures planned for it ask."""
        frame = self._inner.frame_at(time_s)
        closures = self._ticks.at(time_s, self._decide)
        if closures is None:
            return frame
        labiodental = closures.labiodental.smooth(time_s)
        face = self._gap.narrowed(frame.coefficients, self._labiodental_gap_mm, labiodental)
        face = self._gap.narrowed(face, BILABIAL_GAP_MM, closures.bilabial.smooth(time_s))
        return replace(frame, coefficients=face)

    def _decide(self, time_s: float, last: _Closures) -> _Closures:
        begin_s, known_until_s = time_s - TICK_S, time_s + self._known_s
        track = self.track
        return _Closures(
            planned(last.bilabial, self._bilabial_s, track, begin_s, known_until_s),
            planned(last.labiodental, self._labiodental_s, track, begin_s, known_until_s),
        )


def _by_number(tightest_s: Mapping[str, float], phonemes: Iterable[str]) -> dict[int, float]:
    return {PHONEMES.index(phoneme): tightest_s[phoneme] for phoneme in phonemes}
