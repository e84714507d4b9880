"""Live sound against the clock: a card that is late, delivers in pieces, and drifts."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.loop.channel import MemoryTargetChannel
from lipservo.face.assembly import assemble_face
from lipservo.street.arrival import ArrivalLag
from lipservo.street.motion_options import MotionOptions, make_synthesizer
from lipservo.street.speech import Speech
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock

TICK_S = 1.0 / 30.0


def heard_until_s(now_s: float, *, buffer_s: float, piece_s: float, drift: float) -> float:
    """What a card has handed over by `now_s`."""
    captured_s = max(0.0, now_s - buffer_s) * (1.0 + drift)
    return math.floor(captured_s / piece_s) * piece_s


@given(
    buffer_s=st.floats(0.0, 0.2),
    piece_s=st.sampled_from([0.01, 0.032, 0.064]),
    drift=st.floats(-2e-4, 2e-4),
)
def test_once_settled_no_more_is_expected_than_was_heard_and_not_much_less(
    buffer_s, piece_s, drift
):
    """For ten minutes: the lag lies between what the card just delivered and a piece above it."""
    arrival = ArrivalLag()
    for n in range(round(600.0 / TICK_S)):
        now_s = n * TICK_S
        heard_s = heard_until_s(now_s, buffer_s=buffer_s, piece_s=piece_s, drift=drift)
        before_s = arrival.lag_s
        arrival.observe(now_s, now_s - heard_s)
        assert abs(arrival.lag_s - before_s) <= 0.5 * TICK_S + 1e-12, "the mouth never jumps"
        if now_s > 2.0:
            expected_s = now_s - arrival.lag_s
            assert heard_s - piece_s - TICK_S <= expected_s <= heard_s + 1e-3


class Card:
    """A sound device on a clock of its own: silence, delivered as it comes."""

    name, duration_s, is_live, lost_blocks = "card", None, True, 0

    def __init__(self, drift: float) -> None:
        self.now_s, self._drift, self._n_given = 0.0, drift, 0

    def blocks(self, until_s: float) -> list[AudioBlock]:
        assert until_s == math.inf
        end_s = heard_until_s(self.now_s, buffer_s=0.05, piece_s=0.01, drift=self._drift)
        first, self._n_given = self._n_given, round(end_s / 0.01)
        silence = np.zeros(SAMPLE_RATE_HZ // 100, np.float32)
        return [AudioBlock(silence, n * 0.01) for n in range(first, self._n_given)]

    def __enter__(self) -> "Card":
        return self

    def __exit__(self, *exc: object) -> None: ...


class Deaf:
    """A recogniser that remembers only until when it heard."""

    latency_s = 0.095

    def __init__(self) -> None:
        self.heard_s = 0.0

    def feed(self, block: AudioBlock) -> None:
        self.heard_s = block.end_s

    def updates(self) -> list[object]:
        return []

    def reset(self) -> None: ...


@pytest.mark.parametrize("drift", [-2e-4, 0.0, 2e-4])
def test_the_sound_of_a_drifting_card_is_shown_with_the_declared_delay(drift):
    face = assemble_face("face_sim", None)
    card, ears = Card(drift), Deaf()
    synthesizer = make_synthesizer(face.model, MotionOptions())
    speech = Speech(card, ears, synthesizer, face.calibration, MemoryTargetChannel())
    for n in range(60 * 30):  # a minute
        card.now_s = n * TICK_S
        speech.advance(card.now_s, 0.0)
    shown_s = card.now_s - speech.lag_s - speech.delay.total_s
    assert ears.heard_s - shown_s == pytest.approx(speech.delay.total_s, abs=0.05)
