"""Hobby servos: a bus in memory from which nothing comes back, and a face of them on a Maestro."""

import math
from typing import ClassVar

import yaml

from firmware_bridge.bus_kinds import BusKind
from firmware_bridge.bus_settings import BusServo, BusSettings
from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.settings.settings import parse_face

WORDS = "pulses off; a digital servo may hold"
PULSES = BusCapabilities(hold=True, pulse_rate_hz=50.0, released_words=WORDS)


class PulsePort:
    """A port that is told to let go, and has no way to answer."""

    confirms = False

    def __init__(self, there=()):
        self.there, self.told, self.is_open = list(there), [], True

    def tell_all(self, addresses):
        self.told.append(list(addresses))

    def ask(self, address):
        raise AssertionError(f"{address} cannot be asked")

    def find(self, addresses):
        found = sorted({*self.there, *addresses})
        self.tell_all(found)
        return found

    def close(self):
        self.is_open = False


class HobbySettings(BusSettings):
    kind: str = "pulses"
    address: int = 12


class HobbyServo(BusServo):
    address_key: ClassVar[str] = "channel"
    channel: int


class HobbyKind(BusKind):
    name = "pulses"
    settings = HobbySettings
    servo = HobbyServo

    def capabilities(self, _settings):
        return PULSES

    def open(self, wiring, clock, **_strict):
        return SimulatedBus(wiring.joints, clock, capabilities=PULSES)


PULSES_KIND = HobbyKind()


def on_maestro(face, port=None, **bus):
    """The wiring of the joints of any face, as if their servos hung on a Maestro."""
    return parse_face(on_maestro_yaml(face, port=port, **bus), "face.yaml").wiring


def on_maestro_yaml(face, **bus):
    """The YAML of a face with the joints of another, as if their servos hung on a Maestro."""
    return _yaml(face, {"kind": "maestro", "model": "micro6"} | bus)


def on_pca9685(face, **bus):
    """The YAML of a face with the joints of another, as if their servos hung on a PCA9685."""
    return _yaml(face, {"kind": "pca9685", "frequency_hz": 200.0} | bus)


def _yaml(face, bus):
    return face_yaml(face, bus, lambda n: {"channel": n, "us_per_deg": 10.0})


def face_yaml(face, bus, servo, fastest_deg_s=math.inf):
    """The YAML of a face with the joints of another; servo: the keys of its bus, of the nth."""
    servos = {
        joint.name: {
            **servo(n),
            "positive": "opens",
            "min_deg": joint.min_deg,
            "max_deg": joint.max_deg,
            "max_speed_deg_s": min(joint.max_speed_deg_s, fastest_deg_s),
        }
        for n, joint in enumerate(face.joints())
    }
    face = {"name": bus["kind"], "rate_hz": 50, "bus": bus, "servos": servos}
    return yaml.safe_dump(face, sort_keys=False)
