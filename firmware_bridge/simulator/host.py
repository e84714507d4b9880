"""Simulated Dynamixels for other programs: in memory, or behind a pseudo-terminal."""

from pathlib import Path
from typing import Any, Final

from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import baud_rates, servo_models
from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.errors import ServoError
from firmware_bridge.simulator.chain import SimulatedChain, chain_for
from firmware_bridge.simulator.fault_script import read_faults
from firmware_bridge.simulator.ports import MemoryTransport, PtyHost
from firmware_bridge.simulator.wire import WireRules

#: Of servos of no face.
_MODEL: Final = "XL330-M288"


def simulated_wire(wiring: Wiring) -> tuple[DynamixelBus, ManualClock]:
    """Return the bus of a face's servos, simulated in memory, and the clock that moves them."""
    servos, clock, rate = mounted_servos(wiring), ManualClock(), wiring.settings.baud_rate
    chain = chain_for(servos, rate)
    return DynamixelBus(servos, lambda: MemoryTransport(chain, clock, rate)), clock


def serve(
    wiring: Wiring | None,
    link: Path | None,
    *,
    n_servos: int,
    model: str | None,
    first_id: int,
    baud_rate: int | None,
    faults: str | None,
    **options: Any,
) -> PtyHost:
    """Return a host that serves simulated Dynamixels at a pseudo-terminal.

    They are the servos of the face in `wiring`, or if that is None, `n_servos` of one model with
    ids from `first_id` on. link: path of a symbolic link to the terminal. options: chain_stops, as
    of `WireRules`. baud_rate: None: that of the face, or the factory's. faults: the YAML text of a
    script. Raises ServoError for unknown models, rates and ids, FaultScriptError for a bad script,
    and PortError where no terminal or link can be made.
    """
    if options.get("log") is not None:
        raise ServoError("--log: is of hobby servos only")
    models, last_id, model = servo_models(), first_id + n_servos - 1, model or _MODEL
    if model not in models:
        raise ServoError(f"model {model!r} is not known; use one of {', '.join(models)}")
    if baud_rate is not None and baud_rate not in baud_rates().values():
        raise ServoError(f"{baud_rate} baud is no rate of these servos")
    if last_id > 252:
        raise ServoError(f"ids {first_id}..{last_id}: a servo's id is at most 252")
    rules = WireRules(chain_stops=options["chain_stops"])
    if wiring is not None:
        seed, script = read_faults(faults, len(wiring.servos))
        servos, rate = mounted_servos(wiring), baud_rate or wiring.settings.baud_rate
        chain = chain_for(servos, rate, faults=script, seed=seed, rules=rules)
    else:
        seed, script = read_faults(faults, n_servos)
        kinds, ids = [models[model]] * n_servos, range(first_id, last_id + 1)
        chain = SimulatedChain(
            kinds, ids, baud_rate=baud_rate, faults=script, seed=seed, rules=rules
        )
    return PtyHost(chain, link)
