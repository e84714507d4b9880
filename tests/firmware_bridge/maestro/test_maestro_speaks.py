"""A jaw on a simulated Maestro speaks: lips meet at its shaft as they do on a Dynamixel."""

import numpy as np
from speech import CLIP_LABELS_PATH

from firmware_bridge.clock import ManualClock, ticks
from firmware_bridge.maestro.controller import MaestroController
from firmware_bridge.maestro.kind import BAUD_RATE, CAPABILITIES
from firmware_bridge.maestro.simulator import maestro_for
from firmware_bridge.pulse_bus import PulseBus
from firmware_bridge.pulse_servos import PulseScale
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import assemble_face, simulated_wire
from lipservo.runtime.street import make_street_of
from lipsync.audio.playback_clock import SteadyClock
from lipsync.recognition.scripted import ScriptedPhonemes, read_phonemes

RATE_HZ = 50.0
#: The jaw's own degrees at which the lips of this face touch.
TOUCH_DEG = 1.0


def on_dynamixel(face):
    bus, clock = simulated_wire(face.settings)
    return bus, clock, lambda: bus.feedback().positions_deg[0]


def on_maestro(face):
    wiring, clock = face.settings.wiring, ManualClock()
    maestro, scale = maestro_for(wiring), PulseScale(wiring.servos)
    controller = MaestroController(wiring, lambda: MemoryTransport(maestro, clock, BAUD_RATE))
    bus = PulseBus(wiring.servos, controller, clock, CAPABILITIES, may_jump=True)
    shaft = maestro.channels[0].shaft
    return bus, clock, lambda: scale.joints_deg(np.array([shaft.place_us]))[0]


def closures(name, make):
    """How near each P, B and M of the clip brings the shaft to closed, degrees."""
    events = read_phonemes(CLIP_LABELS_PATH)
    face = assemble_face(name, None)
    bus, clock, shaft_deg = make(face)
    synthesizer = make_synthesizer(face.model, MotionOptions())
    with bus:
        street = make_street_of(
            face, ScriptedPhonemes(events), SteadyClock(), bus, RATE_HZ, synthesizer
        )
        street.bridge.start()
        clock.sleep_until(clock.now() + 1.0)
        street.begin(clock.now())
        sound_s, stands_deg = [], []
        for time_s, late in ticks(clock, RATE_HZ):
            tick = street.tick(time_s, late)
            if tick.sound_s > 9.0:
                break
            sound_s.append(tick.sound_s)
            stands_deg.append(shaft_deg())
        assert street.bridge.troubles == ()
    sound_s, stands_deg = np.array(sound_s), np.array(stands_deg)
    near = []
    for event in events:
        if event.phoneme in "PBM" and 0.0 < event.start_s < 8.5:
            around = (event.start_s - 0.06 <= sound_s) & (sound_s <= event.end_s + 0.06)
            near.append(stands_deg[around].min())
    return np.array(near), np.ptp(stands_deg)


def test_closures_are_met_at_the_shaft_as_on_a_dynamixel():
    dynamixel, _ = closures("face_jaw", on_dynamixel)
    maestro, moved_deg = closures("face_jaw_maestro", on_maestro)

    assert len(maestro) >= 5
    assert moved_deg > 8.0
    n_met, n_to_meet = (int((each <= TOUCH_DEG).sum()) for each in (maestro, dynamixel))
    assert n_to_meet >= 5
    assert n_met >= 0.95 * n_to_meet, (maestro, dynamixel)
