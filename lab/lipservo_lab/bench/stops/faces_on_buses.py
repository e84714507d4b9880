"""The same face of four servos on each kind of bus, and its simulated servos."""

from collections.abc import Callable
from typing import Any, Final

import yaml

from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.feetech.mounting import mounted_servos as mounted_feetech
from firmware_bridge.feetech.simulator import chain_for as feetech_chain
from firmware_bridge.maestro.simulator import maestro_for
from firmware_bridge.pca9685.simulator import TerminalChip, chip_for
from firmware_bridge.pulse_servos import PulseScale
from firmware_bridge.simulator.chain import chain_for
from lipservo.settings.settings import FaceSettings
from lipservo_lab.bench.stops.logged_device import (
    LoggedDevice,
    MaestroTruth,
    Pca9685Truth,
    SerialTruth,
)

BUSES: Final = ("dynamixel", "feetech", "maestro", "pca9685")
#: Those whose servos confirm torque; the others have a controller that says what it sends.
SERIAL: Final = ("dynamixel", "feetech")
BAUD_RATE: Final = 1_000_000
_US_PER_DEG: Final = 10.0
_RATE_HZ: Final = {"dynamixel": 30.0, "feetech": 50.0, "maestro": 50.0, "pca9685": 50.0}
_BUS: Final[dict[str, dict[str, Any]]] = {
    "dynamixel": {"kind": "simulated"},
    "feetech": {"kind": "feetech", "baud_rate": BAUD_RATE},
    "maestro": {"kind": "maestro", "model": "mini12"},
    "pca9685": {"kind": "pca9685", "address": 0x40, "frequency_hz": 50.0, "clock_hz": 25_000_000.0},
}


def face_yaml(shipped: FaceSettings, bus: str, *, critical: bool = False) -> str:
    """Return the YAML of a face with the joints of a shipped one on another kind of bus.

    bus: one of `BUSES`. critical: mark the first servo as critical.
    """
    servos = {}
    for number, joint in enumerate(shipped.joints()):
        servo: dict[str, Any] = {
            "positive": "opens" if number == 0 else "widens",
            "min_deg": joint.min_deg,
            "max_deg": joint.max_deg,
            "max_speed_deg_s": joint.max_speed_deg_s,
        }
        match bus:
            case "dynamixel":
                servo |= {"id": 11 + number, "model": "XL330-M288"}
            case "feetech":
                servo |= {"id": 1 + number, "model": "STS3215"}
                servo["max_speed_deg_s"] = min(260.0, joint.max_speed_deg_s)
            case _:
                servo |= {"channel": number, "us_per_deg": _US_PER_DEG}
                servo |= {"min_us": 900.0, "max_us": 2100.0}
        servos[joint.name] = servo | ({"critical": True} if critical and number == 0 else {})
    face = {"name": f"face on {bus}", "rate_hz": _RATE_HZ[bus], "bus": _BUS[bus], "servos": servos}
    return yaml.safe_dump(face | {"calibration": shipped.calibration}, sort_keys=False)


def logged_servos(wiring: Wiring) -> LoggedDevice:
    """Return the simulated servos of a face, limp in neutral, with their log."""
    return _MAKERS.get(wiring.settings.kind, _logged_dynamixels)(wiring)


def _logged_dynamixels(wiring: Wiring) -> LoggedDevice:
    chain = chain_for(mounted_servos(wiring), BAUD_RATE)
    return LoggedDevice(chain, SerialTruth(chain, "deaf_until_s"))


def _logged_feetechs(wiring: Wiring) -> LoggedDevice:
    chain = feetech_chain(mounted_feetech(wiring), BAUD_RATE)
    return LoggedDevice(chain, SerialTruth(chain, "silent_until_s"))


def _logged_maestro(wiring: Wiring) -> LoggedDevice:
    maestro, numbers = maestro_for(wiring), [each.channel for each in wiring.servos]
    return LoggedDevice(maestro, MaestroTruth(maestro, numbers, PulseScale(wiring.servos)))


def _logged_pca9685(wiring: Wiring) -> LoggedDevice:
    chip = chip_for(wiring)
    truth = Pca9685Truth(chip, [each.channel for each in wiring.servos])
    return LoggedDevice(TerminalChip(chip), truth)


_MAKERS: Final[dict[str, Callable[[Wiring], LoggedDevice]]] = {
    "feetech": _logged_feetechs,
    "maestro": _logged_maestro,
    "pca9685": _logged_pca9685,
}
