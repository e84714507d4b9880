"""A face on a simulated Maestro in memory, driven tick by tick, for the tests of its bus."""

from types import SimpleNamespace

import numpy as np
from hobby_bus import on_maestro

from firmware_bridge.clock import ManualClock
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.maestro.controller import MaestroController
from firmware_bridge.maestro.kind import BAUD_RATE, MAESTRO
from firmware_bridge.maestro.simulator import maestro_for
from firmware_bridge.pulse_bus import KeptPulses, PulseBus
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.settings.settings import load_shipped_face

FACE = load_shipped_face("face_four")
RATE_HZ = 50.0
N = len(FACE.joints())


def put_together(
    *,
    faults=(),
    deaf=False,
    kept=None,
    may_jump=True,
    really=None,
    prevent=(),
    tolerant=True,
    **bus,
):
    """really: how the Maestro is set, where that is not as the face's YAML says."""
    wiring = on_maestro(FACE, **bus)
    clock = ManualClock()
    maestro = maestro_for(on_maestro(FACE, **bus | (really or {})), faults=faults, deaf=deaf)

    def opener():
        return MemoryTransport(maestro, clock, BAUD_RATE)

    can = MAESTRO.capabilities(wiring.settings)
    bus = PulseBus(
        wiring.servos,
        MaestroController(wiring, opener),
        clock,
        can,
        KeptPulses(kept),
        may_jump=may_jump,
    )
    channel = MemoryTargetChannel()
    bridge = Bridge(
        bus, wiring.joints, channel, BridgeSettings(RATE_HZ, tolerant=tolerant, prevent=prevent)
    )
    return SimpleNamespace(
        wiring=wiring, clock=clock, maestro=maestro, bus=bus, bridge=bridge, channel=channel,
        opener=opener,
    )  # fmt: skip


def drive(face, seconds, goal_deg=5.0):
    for _ in range(round(seconds * RATE_HZ)):
        time_s = face.clock.now() + 1.0 / RATE_HZ
        face.clock.sleep_until(time_s)
        goals_deg = np.broadcast_to(goal_deg, len(face.bridge.names))
        face.channel.publish(ServoTargets(time_s, goals_deg))
        face.bridge.tick(time_s)


def last_us(face):
    return [channel.position / 4 for channel in face.maestro.channels][:N]


def say_nothing(face):
    """It gets its pulses, and answers no question for one."""
    heard, get_position = face.maestro.receive, 0x90
    face.maestro.receive = lambda data, *at: data[0] == get_position or heard(data, *at)
