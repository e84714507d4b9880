"""Simulated Dynamixels for other programs: in memory, or behind a pseudo-terminal."""

from pathlib import Path
from typing import Any, Final

from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import baud_rates, servo_models
from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.dynamixel.wire.codec import MAX_ID
from firmware_bridge.errors import ServoError
from firmware_bridge.simulation_request import SimulationRequest
from firmware_bridge.simulator.chain import SimulatedChain, chain_for
from firmware_bridge.simulator.fault_script import read_faults
from firmware_bridge.simulator.ports import MemoryTransport, PtyHost
from firmware_bridge.simulator.wire import WireRules

#: Model of simulated servos that belong to no face.
_MODEL: Final = "XL330-M288"


def simulated_wire(wiring: Wiring) -> tuple[DynamixelBus, ManualClock]:
    """Return the bus of a face's servos, simulated in memory, and the clock that moves them."""
    servos, clock, rate = mounted_servos(wiring), ManualClock(), wiring.settings.baud_rate
    chain = chain_for(servos, rate)
    return DynamixelBus(servos, lambda: MemoryTransport(chain, clock, rate)), clock


def serve(wiring: Wiring | None, link: Path | None, request: SimulationRequest) -> PtyHost:
    """Return a host that serves simulated Dynamixels at a pseudo-terminal.

    They are the servos of the face in `wiring`, or if that is None, new ones of one model. link:
    path of a symbolic link to the terminal. request.chain_stops: servos behind a silent one do not
    answer group reads. Raises ServoError for unknown models, rates and ids, FaultScriptError for a
    bad script, and PortError where no terminal or link can be made.
    """
    if request.log is not None:
        raise ServoError("--log only records hobby servos; leave it out")
    new = request.new_servos(servo_models(), _MODEL, baud_rates().values(), MAX_ID)
    n_servos = request.n_servos if wiring is None else len(wiring.servos)
    seed, faults = read_faults(request.faults, n_servos)
    options: dict[str, Any] = {"faults": faults, "seed": seed}
    options["rules"] = WireRules(chain_stops=request.chain_stops)
    if wiring is None:
        return PtyHost(SimulatedChain(*new, baud_rate=request.baud_rate, **options), link)
    rate = request.baud_rate or wiring.settings.baud_rate
    return PtyHost(chain_for(mounted_servos(wiring), rate, **options), link)
