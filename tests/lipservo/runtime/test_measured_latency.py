"""The latency that a run reports is measured: it may be more than what was declared."""

import math

import numpy as np
import pytest

from firmware_bridge.clock import ManualClock, ticks
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import assemble_face, bus_for
from lipservo.runtime.status.face_status import whole_status
from lipservo.runtime.street import make_street
from lipservo.runtime.summary import Tally
from lipsync.audio.source import SilentSource
from lipsync.audio_block import AudioBlock
from lipsync.recognition.energy_recognizer import EnergyRecognizer

RATE_HZ = 50.0


class LiveSilence:
    """A sound device that hands over what it captured in pieces, at the end of each."""

    name, duration_s, is_live, lost_blocks = "device", None, True, 0

    def __init__(self, clock, piece_s):
        self._clock, self._piece_s, self._n_given = clock, piece_s, 0

    def blocks(self, until_s):
        assert until_s == math.inf
        pieces = math.floor(self._clock.now() / self._piece_s + 1e-9)
        first, self._n_given = self._n_given, round(pieces * self._piece_s * 100)
        return [AudioBlock(np.zeros(160, np.float32), n / 100) for n in range(first, self._n_given)]

    def __enter__(self):
        return self

    def __exit__(self, *exc): ...


class Stalling(EnergyRecognizer):
    """A recogniser that takes half a second over one block of each second."""

    def __init__(self, clock):
        super().__init__()
        self._clock = clock

    def feed(self, block):
        if round(block.start_s * 100) % 100 == 50:
            self._clock.advance(0.5)
        super().feed(block)


def measured(source_of, recognizer_of):
    """The summary of six seconds."""
    face, clock = assemble_face("face_sim", None), ManualClock()
    with bus_for(face.settings, clock) as bus, source_of(clock) as source:
        synthesizer = make_synthesizer(face.model, MotionOptions())
        street = make_street(face, source, bus, RATE_HZ, recognizer_of(clock), synthesizer)
        tally = Tally(clock, street)
        street.bridge.start()
        for time_s, late in ticks(clock, RATE_HZ):
            if time_s > 6.0:
                break
            tally.begin_tick(time_s)
            tally.observe(street.tick(time_s, late))
        return tally.summary(whole_status(street.bridge.as_dict(), None), 6.0, 6.0)


def undisturbed(_clock):
    return EnergyRecognizer()


def test_where_all_is_in_time_the_measured_latency_is_the_declared_one():
    figures = measured(lambda _: SilentSource(), undisturbed)
    assert figures.latency_p50_ms == pytest.approx(figures.latency_declared_ms, abs=0.2)
    assert figures.latency_p99_ms == pytest.approx(figures.latency_declared_ms, abs=0.2)


def test_a_stalled_pipeline_shows_a_latency_above_the_declared_one():
    figures = measured(lambda _: SilentSource(), Stalling)
    assert figures.late_ticks > 0
    assert figures.latency_p50_ms == pytest.approx(figures.latency_declared_ms, abs=0.2)
    assert figures.latency_p99_ms > figures.latency_declared_ms + 400.0


def test_sound_that_comes_in_large_pieces_is_late_by_them_and_the_figures_say_so():
    """The mouth waits for the end of each piece of 200 ms, whatever was declared."""
    figures = measured(lambda clock: LiveSilence(clock, 0.2), undisturbed)
    assert figures.lateness_p99_ms <= 0.1
    assert figures.latency_p50_ms > figures.latency_declared_ms + 100.0


def test_a_device_that_hands_over_at_once_is_no_later_than_declared():
    figures = measured(lambda clock: LiveSilence(clock, 0.01), undisturbed)
    assert figures.latency_p99_ms <= figures.latency_declared_ms + 1e3 / RATE_HZ
