"""Ten hobby servos come on one after another, and the face begins when all of them follow."""

from dataclasses import replace

import numpy as np
import pytest
from scripted_street import scripted_street
from speech import CLIP_LABELS_PATH

from firmware_bridge.capabilities import BusCapabilities, mixed_capabilities
from firmware_bridge.clock import ManualClock, ticks
from firmware_bridge.maestro.controller import MaestroController
from firmware_bridge.maestro.kind import BAUD_RATE, CAPABILITIES
from firmware_bridge.maestro.simulator import maestro_for
from firmware_bridge.pulse_bus import PulseBus
from firmware_bridge.simulator.bus import SimulatedBus
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.runtime.servos.assembly import assemble_face
from lipservo.runtime.speech.speech_side import SpeechSide
from lipsync.phoneme_files.reader import read_phonemes

RATE_HZ = 50.0
EVENTS = read_phonemes(CLIP_LABELS_PATH)
IN_TURN = CAPABILITIES.start_s(10)


def lips():
    """The mouth of a head on two buses: its Maestro alone, simulated to the byte."""
    head = assemble_face("face_head_mixed", None)
    settings = head.settings.of_bus("lips")
    face, clock = replace(head, settings=settings, joints=settings.joints()), ManualClock()
    maestro = maestro_for(settings.wiring)
    controller = MaestroController(
        settings.wiring, lambda: MemoryTransport(maestro, clock, BAUD_RATE)
    )
    servos = settings.wiring.servos
    return face, PulseBus(servos, controller, clock, CAPABILITIES, may_jump=True), clock


def rate_limits(begin):
    face, bus, clock = lips()
    with bus:
        street = scripted_street(face, EVENTS, bus, RATE_HZ)
        side = SpeechSide(street.speech, rest=face.model.rest, quiet_s=IN_TURN)
        street.side = side
        street.bridge.start()
        zero_s = begin(side, clock.now())
        n_hits = 0
        for time_s, late in ticks(clock, RATE_HZ):
            n_hits += int(street.tick(time_s, late).report.rate_hits.sum())
            assert street.bridge.counts.n_stale == 0
            if time_s > zero_s + 9.0:
                return n_hits
    raise AssertionError


def test_a_clip_waits_for_the_last_servo_and_no_limit_of_speed_is_hit():
    def at_once(side, now_s):
        side.begin(now_s)
        return now_s

    assert rate_limits(at_once) > 100
    assert rate_limits(lambda side, now_s: side.start(now_s)) == 0


@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_mouth_that_hears_rests_until_all_its_servos_follow(is_stopped):
    face = assemble_face("face_sim", None)
    clock = ManualClock()
    with SimulatedBus(face.joints, clock) as bus:
        speech = scripted_street(face, EVENTS, bus, RATE_HZ).speech
        side = SpeechSide(speech, rest=face.model.rest, quiet_s=IN_TURN, is_live=True)
        assert side.start(0.0) == 0.0
        started_s = 0.0
        if is_stopped:
            started_s = 5.0
            side.advance(4.9)
            side.follow_stop(4.95, is_stopped=True)
            side.follow_stop(started_s, is_stopped=False)
        seen = []
        for now_s in np.arange(started_s, 9.0, 0.01):
            side.follow_stop(now_s, is_stopped=False)
            side.advance(now_s)
            seen.append((now_s, side.speech.is_cut_off))

    opens_s = min(now_s for now_s, is_resting in seen if not is_resting)
    assert opens_s == pytest.approx(started_s + IN_TURN, abs=speech.delay.total_s + 0.02)
    assert opens_s >= started_s + IN_TURN - speech.delay.actuation_s - 0.02


def test_a_face_on_two_buses_has_come_on_when_the_slower_one_has():
    chain = BusCapabilities(soft_start_s=1.0)
    one_by_one = BusCapabilities(soft_start_s=1.0, stagger_s=0.25)
    can = mixed_capabilities({"lips": one_by_one, "neck": chain}, ["lips"] * 5 + ["neck"] * 9)

    assert can.start_s(14) == 2.0
    assert chain.start_s(9) == 1.0
    assert replace(one_by_one, in_memory=True).start_s(5) == 0.0
