"""A bus as that of hobby servos is: pulses go out, and nothing comes back. Simulated in memory."""

from typing import ClassVar

from firmware_bridge.bus_kinds import BusKind
from firmware_bridge.bus_settings import BusServo, BusSettings
from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.simulator.bus import SimulatedBus

WORDS = "pulses off; a digital servo may hold"
PULSES = BusCapabilities(hold=True, pulse_rate_hz=50.0, released_words=WORDS)


class HobbySettings(BusSettings):
    kind: str = "pulses"
    address: int = 12


class HobbyServo(BusServo):
    address_key: ClassVar[str] = "channel"
    channel: int


class HobbyKind(BusKind):
    name = "pulses"

    def settings(self):
        return HobbySettings

    def servo(self):
        return HobbyServo

    def capabilities(self, _settings):
        return PULSES

    def open(self, wiring, clock, **_strict):
        return SimulatedBus(wiring.joints, clock, capabilities=PULSES)


PULSES_KIND = HobbyKind()
