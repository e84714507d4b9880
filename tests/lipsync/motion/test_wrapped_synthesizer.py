"""Closures, rest and strength around a synthesiser that has none of them: the published one."""

import math

import numpy as np
import pytest
from lipservo_lab.learning.motion.trained_model import load_trained_model
from spoken_phonemes import spoken

from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.face.frame import Expression, Frame
from lipsync.motion.closing_synthesizer import ClosingSynthesizer
from lipsync.motion.lip_closure import lip_gap_of
from lipsync.motion.resting_synthesizer import RestingSynthesizer
from lipsync.motion.scaled_synthesizer import ScaledSynthesizer
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PHONEMES, PhonemeUpdate

MODEL = load_trained_model()
PHONES = (("SIL", 0.4), ("AA", 0.2), ("M", 0.1), ("AA", 0.2), ("SIL", 1.0))


def faces(synthesizer, phones=PHONES) -> np.ndarray:
    """(n_ticks, n_components), from silence on, every 10 ms."""
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, spoken(*phones)))
    n = round(sum(duration_s for _, duration_s in phones) / TICK_S)
    return np.array([synthesizer.frame_at(tick * TICK_S).coefficients for tick in range(n)])


def closing(inner):
    tightest_s = {p: float(MODEL.tightest_s[PHONEMES.index(p)]) for p in "PBMFV"}
    return ClosingSynthesizer(
        inner,
        lip_gap_of(MODEL),
        labiodental_gap_mm=MODEL.labiodental_gap_mm,
        tightest_s=tightest_s,
        known_s=0.1,
    )


def test_with_closures_around_it_the_published_strategy_shuts_the_lips_and_moves_alike_elsewhere():
    bare, wrapped = (
        faces(PublishedSynthesizer(MODEL.animphos)),
        faces(closing(PublishedSynthesizer(MODEL.animphos))),
    )
    gaps_mm = np.array([MODEL.lip_gap_mm(face) for face in wrapped])
    # M: 0.60 to 0.70 s.
    assert gaps_mm[60:70].min() <= 0.75
    np.testing.assert_array_equal(wrapped[:50], bare[:50])
    np.testing.assert_array_equal(wrapped[80:], bare[80:])


def test_with_rest_around_it_the_mouth_is_closed_in_a_pause_that_it_spends_open():
    """The mouth of an inner synthesiser that never rests."""

    class AlwaysOpen(PublishedSynthesizer):
        def frame_at(self, time_s):
            return Frame(time_s, MODEL.rest + 1.0, Expression(brow=0.5))

    synthesizer = RestingSynthesizer(AlwaysOpen(MODEL.animphos), MODEL.rest, 0.1)
    moved = faces(synthesizer) - MODEL.rest
    np.testing.assert_allclose(moved[50:85], 1.0)
    np.testing.assert_allclose(moved[:30], 0.0)
    # The pause begins at 0.90 s, is one 0.17 s later, and the mouth is at rest after 0.15 s more.
    assert np.abs(moved[[105, 125]]).max(axis=1) == pytest.approx([1.0, 0.0], abs=1e-3)
    assert synthesizer.is_resting
    assert synthesizer.frame_at(1.5).expression.brow == 0.5


@pytest.mark.parametrize("strength", [0.0, 0.4, 1.0, 1.5])
def test_strength_multiplies_the_distance_from_rest(strength):
    bare = faces(PublishedSynthesizer(MODEL.animphos))
    inner = PublishedSynthesizer(MODEL.animphos)
    scaled = faces(ScaledSynthesizer(inner, MODEL.rest, strength, strongest=1.5))
    np.testing.assert_allclose(scaled - MODEL.rest, strength * (bare - MODEL.rest), atol=1e-12)


def test_a_wrapped_synthesiser_forgets_everything_when_it_is_reset():
    wrapped = closing(RestingSynthesizer(PublishedSynthesizer(MODEL.animphos), MODEL.rest, 0.1))
    first = faces(wrapped)
    assert wrapped.event_at(0.65).phoneme == "M"
    assert wrapped.phonemes_planned > 0
    wrapped.reset()
    assert wrapped.event_at(0.65) is None
    np.testing.assert_array_equal(faces(wrapped), first)
