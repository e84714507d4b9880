"""Registers and models of the Dynamixel X servos, read from `control_tables.yaml` beside this file.

That file has the facts with their sources; nothing here is specific to a model.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Final

import yaml

from firmware_bridge.capabilities import SERIAL_SERVOS

CAPABILITIES: Final = replace(SERIAL_SERVOS, watchdog=True)
#: profile_velocity: 0.229 rev/min.
VELOCITY_UNIT_DEG_S: Final = 0.229 * 6.0
#: bus_watchdog.
WATCHDOG_UNIT_S: Final = 0.020
#: return_delay_time.
RETURN_DELAY_UNIT_S: Final = 2e-6


@dataclass(frozen=True, slots=True)
class Register:
    """One entry of a control table. low, high: bounds of what may be written; None: no fixed bound.

    in_eeprom: kept without power, and locked while torque is on.
    """

    name: str
    address: int
    size: int
    signed: bool
    writable: bool
    in_eeprom: bool
    low: int | None
    high: int | None

    @property
    def end(self) -> int:
        """The address after the register's last byte."""
        return self.address + self.size

    def encode(self, value: int) -> bytes:
        """Return `value` as little-endian bytes. Raises OverflowError when it does not fit."""
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decode(self, data: bytes) -> int:
        """Return the integer that `data` encodes, (size,) little-endian bytes."""
        return int.from_bytes(data, "little", signed=self.signed)


@dataclass(frozen=True, slots=True)
class IndirectBlock:
    """A block of indirect registers: `count` pointers of two bytes each, from `addresses` on.

    The byte to which the n-th points is read and written at address `data` + n.
    """

    addresses: int
    data: int
    count: int


@dataclass(frozen=True, slots=True)
class ServoModel:
    """One servo model: its registers, factory settings, and the limits of its motor.

    n_positions: values of the position registers, over `reach_deg` degrees.
    """

    name: str
    model_number: int
    registers: Mapping[str, Register]
    defaults: Mapping[str, int]
    modes: tuple[int, ...]
    indirect: tuple[IndirectBlock, ...]
    current_unit_ma: float | None
    nominal_voltage_v: float
    no_load_rpm: float
    stall_a: float
    n_positions: int
    reach_deg: float

    @property
    def center_pulse(self) -> int:
        """The position register's value at servo angle 0."""
        return self.n_positions // 2

    @property
    def pulses_per_deg(self) -> float:
        """Steps of the position registers per degree."""
        return self.n_positions / self.reach_deg

    @property
    def measures_current(self) -> bool:
        """Whether present_current counts current; otherwise it counts load in 0.1 %."""
        return self.current_unit_ma is not None

    @property
    def no_load_deg_s(self) -> float:
        """Top speed without load at nominal voltage, degrees a second."""
        return self.no_load_rpm * 6.0

    @property
    def table_size(self) -> int:
        """Size of the control table in bytes, indirect data included."""
        return max(block.data + block.count for block in self.indirect)


@cache
def baud_rates() -> Mapping[int, int]:
    """Return baud rates by their code in register `baud_rate`."""
    return MappingProxyType(dict(_tables()["codes"]["baud_rate"]))


@cache
def servo_models() -> Mapping[str, ServoModel]:
    """Return every known model by its name, such as `XL330-M288`."""
    return MappingProxyType({name: _model(name, raw) for name, raw in _tables()["models"].items()})


@cache
def model_by_number(number: int) -> ServoModel | None:
    """Return the model that answers a ping with `number`; None if it is unknown here."""
    return next((m for m in servo_models().values() if m.model_number == number), None)


def model_name(number: int) -> str:
    """Return a model's name for people: `XL330-M288`, or `unknown model 4711`."""
    known = model_by_number(number)
    return known.name if known else f"unknown model {number}"


def register(name: str) -> Register:
    """Return the register of this name, shared by all models. Raises KeyError for another name."""
    raw = _tables()["registers"][name]
    low, high = raw.get("range", (None, None))
    signed, writable = raw.get("signed", False), raw["access"] == "RW"
    in_eeprom = raw["area"] == "eeprom"
    return Register(name, raw["address"], raw["size"], signed, writable, in_eeprom, low, high)


@cache
def _tables() -> Any:
    text = (files(__package__) / "control_tables.yaml").read_text(encoding="utf-8")
    # The loader in C where PyYAML has it: ten times as fast, and every process starts with this.
    return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def _model(name: str, raw: Mapping[str, Any]) -> ServoModel:
    """Return a model made from `raw`, its entry in the YAML file, and from what all models share.

    raw may leave out registers (`absent`), and replaces the shared ranges and defaults by its own.
    """
    tables = _tables()
    present = [each for each in tables["registers"] if each not in raw.get("absent", ())]
    registers = {each: register(each) for each in present}
    for each, (low, high) in raw["ranges"].items():
        registers[each] = replace(registers[each], low=low, high=high)
    power = raw["at_nominal_voltage"]
    return ServoModel(
        name=name,
        model_number=raw["model_number"],
        registers=MappingProxyType(registers),
        defaults=MappingProxyType({**tables["defaults"], **raw["defaults"], **raw["gains"]}),
        modes=tuple(raw["modes"]),
        indirect=tuple(IndirectBlock(**block) for block in raw["indirect"]),
        current_unit_ma=raw.get("current_unit_ma"),
        nominal_voltage_v=power["voltage_v"],
        no_load_rpm=power["no_load_rpm"],
        stall_a=power["stall_a"],
        **raw.get("position", tables["position"]),
    )
