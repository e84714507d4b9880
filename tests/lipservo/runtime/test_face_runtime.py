"""A run of a whole face in one process: what happens to its torque when it is broken off."""

import signal
from contextlib import contextmanager, suppress
from types import SimpleNamespace

import pytest

from firmware_bridge.clock import ManualClock
from firmware_bridge.errors import ServoError
from firmware_bridge.loop.bridge import Bridge
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.run_request import SILENCE, RunRequest
from lipsync.audio.source import SilentSource


def two_signals():
    signal.raise_signal(signal.SIGTERM)
    signal.raise_signal(signal.SIGTERM)


def servo_error():
    raise ServoError("the guard of a PCA9685's OE pin has died")


class BrokenOff(SilentSource):
    """Silence, in whose middle something happens."""

    def __init__(self, strike):
        super().__init__()
        self._strike = strike

    def blocks(self, until_s):
        if until_s > 1.0:
            self._strike()
        return super().blocks(until_s)


def nothing():
    pass


@pytest.mark.parametrize(
    ("at_start", "later"), [(nothing, two_signals), (nothing, servo_error), (two_signals, nothing)]
)
def test_a_run_that_is_broken_off_is_limp_before_its_agents_are_seen_off(
    monkeypatch, at_start, later
):
    bridges, on = [], []
    started = Bridge.start

    def start(bridge, *how, **more):
        bridges.append(bridge)
        started(bridge, *how, **more)
        on.append(bridge.torque.any_on)
        at_start()

    @contextmanager
    def agents(*_):
        try:
            yield None
        finally:  # with real ones it may take seconds
            on.append(bridges[0].torque.any_on)

    monkeypatch.setattr(Bridge, "start", start)
    monkeypatch.setattr("lipservo.runtime.voice_agents.voice_agents", agents)
    request = RunRequest("face_sim", SILENCE, quiet=True)
    with suppress(ServoError), BrokenOff(later) as source:
        run_face(request, source, ManualClock(), endless=True, listener=SimpleNamespace())

    assert on == [True, False]
