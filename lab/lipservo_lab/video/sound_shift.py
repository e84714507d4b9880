"""How much later than the picture the sound is, by comparing tracked lips with predicted ones.

Loudness is a poor measure: in 60 sentences of grid_s1, filmed in sync, the shift at which lip gap
and loudness agree best is off by more than 100 ms in 28 %. The gap that the shipped model predicts
from the phonemes in the sound is off by more than 100 ms in 2 % with recognised phonemes, half of
them within 13 ms; in none with known phonemes, half within 10 ms.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array
from lipsync.expectation.expectation import read_expectation
from lipsync.face.model import FaceModel, open_model, read_face
from lipsync.motion.finishing import USED_LOOKAHEAD_S, Style
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


class ExpectedLips:
    """The lip gap that the shipped model predicts for the phonemes of a whole sentence."""

    def __init__(self) -> None:
        with open_model(None) as file:
            self._face: FaceModel = read_face(file)
            self._expectation = read_expectation(file, self._face.n_components)

    def gaps_mm(self, phones: Sequence[PhonemeEvent], duration_s: float) -> Array:
        """Return the predicted lip gap, (n,) mm, every `TICK_S` from 0 s to `duration_s`."""
        style = Style(lookahead_s=USED_LOOKAHEAD_S)
        synthesizer = LiveSynthesizer(self._face, self._expectation, style)
        synthesizer.push(PhonemeUpdate(0.0, np.inf, np.inf, tuple(phones)))
        times_s = np.arange(max(1, round(duration_s / TICK_S))) * TICK_S
        faces = np.array([synthesizer.frame_at(float(t)).coefficients for t in times_s])
        return self._face.lip_gaps_mm(self._face.markers_mm(faces))


#: Largest shift that is tried, either way.
LARGEST_SHIFT_S = 0.5
_STEP_S = 0.01
#: With fewer pictures in common no correlation is computed.
_LEAST_PICTURES = 10
#: Smaller shifts are not corrected: half a picture at 25 a second.
LEAST_CORRECTED_S = 0.02
#: A clip has a shift of its own if it differs by more than this from that of all clips, and the
#: correlation is this much higher there.
_OWN_SHIFT_S, _OWN_GAIN = 0.1, 0.15
#: A clip whose highest correlation is lower does not count for the shift.
_LEAST_R = 0.4


@dataclass(frozen=True, slots=True)
class ShiftCurve:
    """Correlation of tracked and predicted lip gap, by shift.

    correlations: (n,), with the sound moved earlier by shifts_s, (n,).
    """

    shifts_s: Array
    correlations: Array

    def at(self, shift_s: float) -> float:
        """Return the correlation at a shift, s, interpolated linearly."""
        return float(np.interp(shift_s, self.shifts_s, self.correlations))

    @property
    def best_s(self) -> float:
        """The shift of the highest correlation, s, by a parabola through the three highest."""
        peak = int(self.correlations.argmax())
        if not 0 < peak < len(self.correlations) - 1:
            return float(self.shifts_s[peak])
        before, top, after = self.correlations[peak - 1 : peak + 2]
        bend = before - 2 * top + after
        off = 0.5 * (before - after) / bend if bend < 0 else 0.0
        return float(self.shifts_s[peak] + off * _STEP_S)


def shift_curve(seen: Array, times_s: Array, expected: Array) -> ShiftCurve:
    """Correlate a tracked lip gap with the predicted one, at every shift of the sound.

    Parameters
    ----------
    seen, times_s : Array
        (n,) tracked gaps, and their times of sound by the time stamps, s.
    expected : Array
        (m,) predicted gaps every 10 ms from 0 on.
    """
    shifts_s = np.arange(-LARGEST_SHIFT_S, LARGEST_SHIFT_S + _STEP_S / 2, _STEP_S)
    expected_s = np.arange(len(expected)) * TICK_S
    correlations = []
    for shift_s in shifts_s:
        sound_s = times_s + shift_s
        common = (sound_s >= 0) & (sound_s <= expected_s[-1])
        correlations.append(
            correlation(seen[common], np.interp(sound_s[common], expected_s, expected))
            if common.sum() >= _LEAST_PICTURES
            else 0.0
        )
    return ShiftCurve(shifts_s, np.array(correlations))


def correlation(one: Array, other: Array) -> float:
    """Return Pearson's correlation; 0 where one of both does not move.

    Parameters
    ----------
    one, other : Array
        (n,) each.
    """
    spread = float(one.std() * other.std())
    if spread < 1e-9:
        return 0.0
    return float(((one - one.mean()) * (other - other.mean())).mean() / spread)


def corrections_s(curves: Sequence[ShiftCurve]) -> list[float]:
    """Return by how much to move each clip's sound earlier, s: the common shift, or its own.

    The common shift is the median over clips whose curve has a clear maximum, as a camera and its
    microphone always have the same delay. 0 if it is less than `LEAST_CORRECTED_S`.
    """
    clear_s = [curve.best_s for curve in curves if curve.correlations.max() >= _LEAST_R]
    common_s = float(np.median(clear_s)) if clear_s else 0.0
    shifts = []
    for curve in curves:
        own_s = curve.best_s
        gain = curve.at(own_s) - curve.at(common_s)
        is_own = (
            curve.correlations.max() >= _LEAST_R
            and abs(own_s - common_s) > _OWN_SHIFT_S
            and gain > _OWN_GAIN
        )
        shift_s = own_s if is_own else common_s
        shifts.append(shift_s if abs(shift_s) >= LEAST_CORRECTED_S else 0.0)
    return shifts
