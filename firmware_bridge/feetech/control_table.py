"""Registers, dialects and models of Feetech servos, read from `control_tables.yaml` beside this."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Final, Literal

import yaml

#: return_delay_time.
RETURN_DELAY_UNIT_S: Final = 2e-6
#: Bits of `phase`: the unit of speeds is one step a second; positions count over many turns.
SPEED_IN_STEPS, MULTI_TURN = 0x04, 0x10
#: Registers below this address are EEPROM: written values last if `lock` is 0.
EEPROM_SIZE: Final = 40
TORQUE_ENABLE: Final = 40
CONTROL, STATE = 40, 56


@dataclass(frozen=True, slots=True)
class Register:
    """One entry of a control table. sign: the bit that marks a negative value; None: unsigned."""

    address: int
    size: int
    sign: int | None = None


@dataclass(frozen=True, slots=True)
class Dialect:
    """Register layout and read instructions of one family of servos.

    n_positions: values of the position registers, over `reach_deg` degrees with `center` in the
    middle. control_size, state_size: bytes read at once from `CONTROL` and from `STATE` on.
    current_unit_ma: of present_current; None: the dialect has no such register.
    """

    name: str
    byte_order: Literal["little", "big"]
    sync_read: bool
    n_positions: int
    center: int
    reach_deg: float
    control_size: int
    state_size: int
    registers: Mapping[str, Register]
    current_unit_ma: float | None = None

    @property
    def positions_per_deg(self) -> float:
        """Steps of the position registers per degree."""
        return self.n_positions / self.reach_deg

    def encode(self, name: str, value: int) -> bytes:
        """Return `value` as the bytes of register `name`. OverflowError: it does not fit."""
        entry = self.registers[name]
        if value < 0 and entry.sign is not None:
            value = -value | 1 << entry.sign
        return value.to_bytes(entry.size, self.byte_order)

    def decode(self, name: str, data: bytes, start: int = 0) -> int:
        """Return the value of register `name` in `data`, which begin at address `start`."""
        entry = self.registers[name]
        at = entry.address - start
        value = int.from_bytes(data[at : at + entry.size], self.byte_order)
        if entry.sign is not None and value >> entry.sign & 1:
            return -(value & (1 << entry.sign) - 1)
        return value

    def decode_all(self, data: bytes) -> dict[str, int]:
        """Return by name the values of the registers that lie whole in `data`, from address 0."""
        of = self.registers
        whole = (name for name, each in of.items() if each.address + each.size <= len(data))
        return {name: self.decode(name, data) for name in whole}


@dataclass(frozen=True, slots=True)
class ServoModel:
    """One servo model, which may come with several gears.

    fastest_deg_s: top speed without load of the quickest gear.
    """

    name: str
    model_number: int
    dialect: Dialect
    hottest_degc: float
    least_v: float
    most_v: float
    nominal_voltage_v: float
    no_load_deg_s: float
    fastest_deg_s: float
    stall_a: float

    @property
    def n_positions(self) -> int:
        """How many values the position registers have."""
        return self.dialect.n_positions

    @property
    def center_pulse(self) -> int:
        """The position register's value at servo angle 0."""
        return self.dialect.center

    @property
    def pulses_per_deg(self) -> float:
        """Steps of the position registers per degree."""
        return self.dialect.positions_per_deg

    @property
    def current_unit_ma(self) -> float | None:
        """Milliamperes per step of present_current; None: only load is measured."""
        return self.dialect.current_unit_ma


@cache
def baud_rates() -> Mapping[int, int]:
    """Return baud rates by their code in register `baud_rate`, the factory's rate first."""
    return MappingProxyType(dict(_tables()["baud_rates"]))


@cache
def servo_models() -> Mapping[str, ServoModel]:
    """Return every known model by its name, such as `STS3215`."""
    tables = _tables()
    dialects = {name: _dialect(name, raw) for name, raw in tables["dialects"].items()}
    return MappingProxyType(
        {
            name: ServoModel(name=name, **raw | {"dialect": dialects[raw["dialect"]]})
            for name, raw in tables["models"].items()
        }
    )


def model_name(number: bytes) -> str:
    """Return the model's name for the two bytes at address 3, as `STS3215` or `unknown model 9.99`.

    The byte order does not matter: models of two dialects never have the same two bytes.
    """
    known = (
        model.name
        for model in servo_models().values()
        if model.dialect.encode("model_number", model.model_number) == number
    )
    return next(known, f"unknown model {number[0]}.{number[1]}")


def _dialect(name: str, raw: Mapping[str, Any]) -> Dialect:
    registers = {
        each: Register(**entry)
        for each, entry in (_tables()["registers"] | raw["registers"]).items()
    }
    return Dialect(name=name, **{**raw, "registers": MappingProxyType(registers)})


@cache
def _tables() -> Any:
    text = (files(__package__) / "control_tables.yaml").read_text(encoding="utf-8")
    # The loader in C where PyYAML has it: every process starts with this.
    return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
