"""Closures, rest and strength around a synthesiser that has none of them: the published one."""

import math

import numpy as np
import pytest
from lipservo_lab.learning.motion.trained_model import load_trained_model
from spoken_phonemes import spoken

from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.face.frame import Expression, Frame
from lipsync.face.model import load_face
from lipsync.motion.finishing import FinishedSynthesizer, lip_gap_of
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate

MODEL = load_trained_model()
PHONES = (("SIL", 0.4), ("AA", 0.2), ("M", 0.1), ("AA", 0.2), ("SIL", 1.0))
#: Ticks of the vowels in which neither the M nor a pause moves the mouth.
VOWELS = np.r_[40:50, 80:105]


def faces(synthesizer, phones=PHONES) -> np.ndarray:
    """(n_ticks, n_components), from silence on, every 10 ms."""
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, spoken(*phones)))
    n = round(sum(duration_s for _, duration_s in phones) / TICK_S)
    return np.array([synthesizer.frame_at(tick * TICK_S).coefficients for tick in range(n)])


def test_finished_the_published_strategy_shuts_the_lips_and_moves_alike_elsewhere():
    bare = faces(PublishedSynthesizer(MODEL.animphos))
    finished = faces(FinishedSynthesizer(MODEL, PublishedSynthesizer(MODEL.animphos)))
    gaps_mm = np.array([MODEL.lip_gap_mm(face) for face in finished])
    # M: 0.60 to 0.70 s.
    assert gaps_mm[60:70].min() <= 0.75
    np.testing.assert_allclose(finished[VOWELS], bare[VOWELS], atol=1e-12)


def test_the_mouth_is_closed_in_a_pause_that_the_synthesiser_inside_spends_open():
    class AlwaysOpen(PublishedSynthesizer):
        def frame_at(self, time_s):
            return Frame(time_s, MODEL.rest + 1.0, Expression(brow=0.5))

    synthesizer = FinishedSynthesizer(MODEL, AlwaysOpen(MODEL.animphos), known_s=0.1)
    moved = faces(synthesizer) - MODEL.rest
    np.testing.assert_allclose(moved[VOWELS], 1.0)
    np.testing.assert_allclose(moved[:30], 0.0)
    # The pause begins at 0.90 s, is one 0.17 s later, and the mouth is at rest after 0.15 s more.
    assert np.abs(moved[[105, 125]]).max(axis=1) == pytest.approx([1.0, 0.0], abs=1e-3)
    assert synthesizer.is_resting
    assert synthesizer.frame_at(1.5).expression.brow == 0.5


@pytest.mark.parametrize("strength", [0.0, 0.4, 1.0, 1.5])
def test_strength_multiplies_the_distance_from_rest(strength):
    bare = faces(PublishedSynthesizer(MODEL.animphos))
    scaled = faces(FinishedSynthesizer(MODEL, PublishedSynthesizer(MODEL.animphos), strength))
    expected = strength * (bare[VOWELS] - MODEL.rest)
    np.testing.assert_allclose(scaled[VOWELS] - MODEL.rest, expected, atol=1e-12)


def test_a_finished_synthesiser_forgets_everything_when_it_is_reset():
    finished = FinishedSynthesizer(MODEL, PublishedSynthesizer(MODEL.animphos))
    first = faces(finished)
    assert finished.event_at(0.65).phoneme == "M"
    assert finished.phonemes_planned > 0
    finished.reset()
    assert finished.event_at(0.65) is None
    np.testing.assert_array_equal(faces(finished), first)


def test_a_smile_stays_when_the_synthesiser_is_reset():
    """Sound time begins again at 0; a change that began later must not be waited for."""
    model = load_face()
    smiled, glad_from_the_start = (make_synthesizer(model, MotionOptions()) for _ in range(2))
    faces(smiled)
    for synthesizer in (smiled, glad_from_the_start):
        synthesizer.smile(1.0)
        synthesizer.reset()
    np.testing.assert_array_equal(faces(smiled), faces(glad_from_the_start))


def test_the_window_after_a_frame_says_when_lips_must_touch_and_decides_nothing():
    model = load_face()
    spans = (("AA", 0.0, 0.5), ("P", 0.5, 0.6), ("AA", 0.6, 1.0))
    said = PhonemeUpdate(0.0, 1.0, 1.0, tuple(PhonemeEvent(*span) for span in spans))
    watched, other = (make_synthesizer(model, MotionOptions()) for _ in range(2))
    for synthesizer in (watched, other):
        synthesizer.push(said)
    windows = []
    for n in range(60):
        frame = watched.frame_at(n / 100)
        windows.append(watched.window_after(frame))
        assert (frame.coefficients == other.frame_at(n / 100).coefficients).all()
        assert (windows[-1].faces[0] == frame.coefficients).all()

    announced = [n for n, window in enumerate(windows) if window.closed[1:].any()]
    closes = next(n for n, window in enumerate(windows) if window.closed[0])
    assert 0.05 <= (closes - announced[0]) / 100 <= 0.1
    gap, window = lip_gap_of(model), windows[announced[0]]
    gaps_mm = np.linalg.norm(gap.at_mean_mm + window.faces @ gap.per_face, axis=1)
    assert gaps_mm[window.closed].max() < 1.0 < gaps_mm[0]


def test_the_lower_lip_is_tucked_for_f_and_not_for_m_nor_in_a_mouth_kept_closed():
    def most_tucked(phoneme, strength=1.0):
        made = FinishedSynthesizer(MODEL, PublishedSynthesizer(MODEL.animphos), strength)
        phones = tuple((phoneme if name == "M" else name, s) for name, s in PHONES)
        made.push(PhonemeUpdate(0.0, math.inf, math.inf, spoken(*phones)))
        frames = [made.frame_at(tick * TICK_S) for tick in range(150)]
        assert all(frame.expression.lip_tuck is None for frame in frames[120:])
        return max(frame.expression.lip_tuck or 0.0 for frame in frames)

    assert most_tucked("F") == most_tucked("V") == 1.0
    assert most_tucked("M") == 0.0
    assert most_tucked("F", strength=0.0) == 0.0


def said(*phonemes, strength=1.0):
    """Frames of so many phones of 0.12 s between vowels, by the published strategy."""
    phones = (("SIL", 0.4), ("AA", 0.2), *((each, 0.12) for each in phonemes), *PHONES[3:])
    made = FinishedSynthesizer(MODEL, PublishedSynthesizer(MODEL.animphos), strength=strength)
    made.push(PhonemeUpdate(0.0, math.inf, math.inf, spoken(*phones)))
    return [made.frame_at(tick * TICK_S) for tick in range(150)]


def most(frames, name):
    return max(getattr(frame.expression, name) or 0.0 for frame in frames)


@pytest.mark.parametrize(("strength", "share"), [(0.0, 0.0), (0.5, 0.5), (1.5, 1.0)])
def test_the_tip_of_the_tongue_is_between_the_teeth_for_th_and_raised_for_l(strength, share):
    for phonemes, between, raised in (
        (("TH", "DH"), share, 0.0), (("L", "N", "T", "D"), 0.0, share), (("K", "S"), 0.0, 0.0),
    ):  # fmt: skip
        for phoneme in phonemes:
            frames = said(phoneme, strength=strength)
            assert most(frames, "tongue_dental") == pytest.approx(between), phoneme
            assert most(frames, "tongue_alveolar") == pytest.approx(raised), phoneme
            assert most(frames[120:], "tongue_dental") == 0.0, "at rest it is down"


def test_no_tongue_is_seen_behind_lips_that_touch():
    frames = said("P", "TH")
    touching = [f for f in frames[60:] if MODEL.lip_gap_mm(f.coefficients) <= 0.75]
    assert touching
    assert most(touching[:6], "tongue_dental") < 0.05 < most(frames, "tongue_dental")
