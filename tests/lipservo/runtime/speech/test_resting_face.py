"""A robot that nobody speaks to for long lets its servos go, and gets up without a jump."""

import numpy as np
import pytest
from lipservo_lab.bench.sync.speaking_robot import Deaf

from firmware_bridge.clock import ManualClock
from firmware_bridge.loop.face_table import FaceState
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import assemble_face, bus_for
from lipservo.runtime.street import make_street
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.phonemes import PhonemeEvent

RATE_HZ = 50.0
RESTS_AFTER_S = 10.0
SENTENCE = (
    PhonemeEvent("AA", 0.0, 0.4),
    PhonemeEvent("P", 0.4, 0.5),
    PhonemeEvent("AA", 0.5, 0.9),
)


def quick_to_rest():
    face = assemble_face("face_head", None)
    asked = face.settings.expression.model_copy(update={"rest_after_s": RESTS_AFTER_S})
    settings = face.settings.model_copy(update={"expression": asked})
    return type(face)(settings, face.model, face.calibration, face.joints)


@pytest.mark.slow
def test_servos_are_let_go_in_a_long_silence_and_driven_again_for_a_word():
    clock, playout, face = ManualClock(), Playout(), quick_to_rest()
    stream = PlayoutStream("word", 16_000, playout.output_rate_hz, SENTENCE)
    stream.push(np.full(round(0.9 * 16_000), 0.1, np.float32))
    stream.end()
    states, sent_deg, torque = [], [], []
    with bus_for(face.settings, clock) as bus:
        synthesizer = make_synthesizer(face.model, MotionOptions())
        street = make_street(face, playout, bus, RATE_HZ, Deaf(), synthesizer)
        street.bridge.start()
        street.begin(clock.now())
        for n in range(round(30.0 * RATE_HZ)):
            if n == round(25.0 * RATE_HZ):
                playout.requests.append(PlayoutRequest("say", stream))
            report = street.tick(clock.now(), 0).report
            states.append(street.bridge.state)
            sent_deg.append(report.sent_deg)
            torque.append(report.torque_on)
            clock.sleep_until(clock.now() + 1.0 / RATE_HZ)

    at = {seconds: round(seconds * RATE_HZ) for seconds in (9, 24, 26, 29)}
    assert states[at[9]] is FaceState.DRIVEN
    assert (states[at[24]], torque[at[24]]) == (FaceState.SILENT, False)
    assert (states[at[29]], torque[at[29]]) == (FaceState.DRIVEN, True)
    lips_deg = np.array(sent_deg)[at[26] - 40 :]
    assert np.ptp(lips_deg, axis=0)[0] > 2.0  # the jaw spoke
    # Let go at neutral, and taken up from there: nothing jumps on either way.
    limits = np.array([joint.max_speed_deg_s for joint in face.joints]) / RATE_HZ
    assert (np.abs(np.diff(sent_deg, axis=0)) <= limits + 1e-9).all()
    let_go = next(n for n in range(len(torque)) if not torque[n])
    assert np.abs(sent_deg[let_go - 1]).max() < 1.0
