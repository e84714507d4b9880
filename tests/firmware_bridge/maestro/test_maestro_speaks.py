"""A jaw on simulated servos of other kinds speaks: its lips meet as they do on a Dynamixel."""

import numpy as np
import pytest
from scripted_street import scripted_street
from speech import CLIP_LABELS_PATH

from firmware_bridge.clock import ManualClock, ticks
from firmware_bridge.feetech.bus import FeetechBus
from firmware_bridge.feetech.mounting import mounted_servos
from firmware_bridge.feetech.simulator import chain_for
from firmware_bridge.maestro.controller import MaestroController
from firmware_bridge.maestro.kind import BAUD_RATE, CAPABILITIES
from firmware_bridge.maestro.simulator import maestro_for
from firmware_bridge.pca9685.i2c import I2cChip
from firmware_bridge.pca9685.kind import PCA9685, controller_of
from firmware_bridge.pca9685.simulator import MemoryTransfers, chip_for
from firmware_bridge.pulse_bus import PulseBus
from firmware_bridge.pulse_servos import PulseScale
from firmware_bridge.serial_servos.mounting import Mounting
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.runtime.servos.assembly import assemble_face, simulated_wire
from lipsync.phoneme_files.reader import read_phonemes

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


def on_pca9685(face):
    wiring, clock = face.settings.wiring, ManualClock()
    chip, can = chip_for(wiring), PCA9685.capabilities(wiring.settings)
    controller = controller_of(
        wiring, lambda: I2cChip(MemoryTransfers(chip, clock), chip.address, "simulated"), clock
    )
    bus = PulseBus(wiring.servos, controller, clock, can, may_jump=True)
    return bus, clock, lambda: chip.places_deg(clock.now())[0]


def on_feetech(face):
    wiring, clock = face.settings.wiring, ManualClock()
    servos, rate = mounted_servos(wiring), wiring.settings.baud_rate
    chain, mounting = chain_for(servos, rate), Mounting(servos)
    bus = FeetechBus(servos, lambda: MemoryTransport(chain, clock, rate))
    return bus, clock, lambda: mounting.joint_deg(np.array([chain.servos[0].place]))[0]


def closures(name, make):
    """How near each P, B and M of the clip brings the shaft to closed, degrees."""
    events = read_phonemes(CLIP_LABELS_PATH)
    face = assemble_face(name, None)
    bus, clock, shaft_deg = make(face)
    with bus:
        street = scripted_street(face, events, bus, RATE_HZ)
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


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("face_jaw_maestro", on_maestro),
        ("face_jaw_pca9685", on_pca9685),
        ("face_jaw_feetech", on_feetech),
    ],
)
def test_closures_are_met_at_the_shaft_as_on_a_dynamixel(name, make):
    dynamixel, _ = closures("face_jaw", on_dynamixel)
    pulses, moved_deg = closures(name, make)

    assert len(pulses) >= 5
    assert moved_deg > 7.5  # a PCA9685 moves in steps of .44
    n_met, n_to_meet = (int((each <= TOUCH_DEG).sum()) for each in (pulses, dynamixel))
    assert n_to_meet >= 5
    assert n_met >= 0.95 * n_to_meet, (pulses, dynamixel)
