"""Feetech servos for tests: a face of them, their bus in memory, and every frame on its wire."""

import math
from types import SimpleNamespace

from hobby_bus import face_yaml

from firmware_bridge.clock import ManualClock
from firmware_bridge.feetech.bus import FeetechBus
from firmware_bridge.feetech.mounting import MountedServo, mounted_servos
from firmware_bridge.feetech.simulator import chain_for
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.settings.settings import load_shipped_face, parse_face

RATE = 1_000_000


def on_feetech(face, model="STS3215", **bus):
    """The YAML of a face with the joints of another, as if their servos were Feetech's."""
    bus = {"kind": "feetech", "port": "/dev/x"} | bus
    return face_yaml(face, bus, lambda n: {"id": n + 1, "model": model}, fastest_deg_s=260.0)


def four_servos(model="STS3215") -> list[MountedServo]:
    text = on_feetech(load_shipped_face("face_four"), model)
    return mounted_servos(parse_face(text, "face.yaml").wiring)


def wired(servos=None, *, strict=True, set_up=None, period_s=math.inf, **options):
    """A bus, its chain and clock, and all that the computer writes. set_up: done to the chain."""
    servos = four_servos() if servos is None else servos
    clock, frames = ManualClock(), []
    chain = chain_for(servos, RATE, **options)
    if set_up is not None:
        set_up(chain)

    def open_transport():
        return MemoryTransport(chain, clock, RATE, lambda _, data: frames.append(data))

    bus = FeetechBus(servos, open_transport, strict=strict, period_s=period_s)
    return SimpleNamespace(
        bus=bus, chain=chain, clock=clock, frames=frames, servos=servos, open=open_transport
    )
