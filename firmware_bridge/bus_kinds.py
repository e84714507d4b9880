"""Kinds of servo bus: a kind is one entry, found by the name that a face's YAML gives it.

An entry has the pydantic models of the YAML settings, opens the bus, simulates it, and examines its
port while no face drives it. Kinds of other packages are entry points of the group
`lipservo.buses`. The module of a kind is loaded when its name is first used, and what opens its
port when the port is opened.
"""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.errors import BusError
from firmware_bridge.joints import Joint

if TYPE_CHECKING:
    from firmware_bridge.bus import ServoBus
    from firmware_bridge.bus_settings import BusServo, BusSettings
    from firmware_bridge.clock import Clock
    from firmware_bridge.transport import Transport

GROUP: Final = "lipservo.buses"
_BUILT_IN: Final = {
    "simulated": "firmware_bridge.simulator.kind:SIMULATED",
    "dynamixel": "firmware_bridge.dynamixel.kind:DYNAMIXEL",
    "maestro": "firmware_bridge.maestro.kind:MAESTRO",
    "pca9685": "firmware_bridge.pca9685.kind:PCA9685",
    "feetech": "firmware_bridge.feetech.kind:FEETECH",
}
#: Why a servo that was sent torque off is not known to be limp.
NOT_SEEN: Final = "did not answer"
#: The kind of bus assumed at a port of which nothing else is known.
AT_A_PORT: Final = "dynamixel"


class UnknownBusError(BusError):
    """Raised for a kind of bus that is not installed, or cannot be loaded."""


@dataclass(frozen=True, slots=True)
class Wiring:
    """The servos of one face on one bus.

    settings: the bus section of the YAML, a `BusKind.settings`; servos: the servos' entries, each a
    `BusKind.servo`, in the order of `joints`. rate_hz: ticks a second. kept: the file with the
    positions sent last, for a bus whose servos cannot report theirs; None: no file. capabilities:
    of servos in memory that simulate others; None: their kind's. may_jump: a person agreed that
    servos of unknown position jump to neutral (0 degrees) when they start.
    """

    settings: Any
    joints: tuple[Joint, ...]
    servos: tuple[Any, ...]
    rate_hz: float
    kept: Path | None = None
    capabilities: BusCapabilities | None = None
    may_jump: bool = False


class Severity(IntEnum):
    """How serious a finding of `lipservo doctor` is."""

    GOOD = 0
    WARNING = 1
    BAD = 2


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding of `lipservo doctor`: what was found, and the remedy; empty: none is needed."""

    severity: Severity
    what: str
    remedy: str = ""


class PortRelease(Protocol):
    """An open port at which torque is switched off, regardless of what drove the servos.

    Methods raise PortError.
    """

    @property
    def confirms(self) -> bool:
        """Whether the servos can confirm that their torque is off."""

    def tell_all(self, addresses: Sequence[int]) -> None:
        """Send torque off to these addresses and to all others at the port; read no answer."""

    def ask(self, address: int) -> str:
        """Read whether the servo at `address` has its torque off; return "" if it confirms that.

        Otherwise return the reason, after torque off was sent to it once more.
        """

    def find(self, addresses: Sequence[int]) -> Sequence[int]:
        """Send torque off at every baud rate that servos may have; return `addresses` and others.

        The others are all servos that answer.
        """

    def close(self) -> None:
        """Close the port."""


class BusKind(ABC):
    """One kind of servo bus, such as Dynamixel: its settings, and functions that open or check it.

    A kind of another package derives from this class and overrides what it supports. Methods import
    what they need, so that an entry costs nothing but its name. Those that open a port raise
    PortError, and ServoError where servos differ from the face's YAML.
    """

    #: As a face's YAML has it under `bus.kind`.
    name: str
    #: What stands under `bus:`, and under `servos:` for each servo, with the checks of both.
    settings: "type[BusSettings]"
    servo: "type[BusServo]"
    #: Of a bus whose servos cannot be found by asking: the key under `bus:` that says which board
    #: they hang on, and the board that most have; empty: they are found.
    board_key: str = ""
    usual_board: str = ""
    #: The kind that the same servos have at a port; empty: this one.
    at_port: str = ""
    #: See the methods `workshop` and `simulator`; empty: it has none.
    workshop_module: str = ""
    simulator_module: str = ""

    @abstractmethod
    def capabilities(self, settings: "BusSettings") -> BusCapabilities:
        """Return the capabilities of the servos of a bus with these settings; opens no port."""

    @abstractmethod
    def open(self, wiring: Wiring, clock: "Clock", *, strict: bool = True) -> "ServoBus":
        """Return the unopened bus of the servos in `wiring`; its `with` block opens it.

        clock: moves servos that are simulated in memory. strict=False: servos may be missing.
        """

    def slowness(self, _wiring: Wiring, _rate_hz: float) -> str | None:
        """Return why the bus cannot do this many ticks a second, and the remedy; None if it can."""
        return None

    def is_at(self, _port: str) -> bool:
        """Return whether the USB device at a port identifies itself as of this kind."""
        return False

    def answers_at(self, _transport: "Transport") -> bool:
        """Return whether servos of this kind answer at an open port; reads only, writes nothing."""
        return False

    def port_release(self, _port: str, _wiring: Wiring | None) -> Callable[[], PortRelease]:
        """Return a function that opens the port to switch torque off.

        Its first call notes which adapter is at the port; later calls raise PortError for another
        one. `_wiring`: the servos at the port; None: unknown. Raises BusError where the kind has no
        port.
        """
        raise self._lacks("port")

    def examine(self, _wiring: Wiring) -> Iterator[Finding]:
        """Yield what `lipservo doctor` finds between computer and servos; writes to no servo."""
        raise self._lacks("doctor")

    def memories(self, _wiring: Wiring) -> Sequence[Mapping[str, int] | None]:
        """Return each servo's stored settings by register name; None for a servo that is silent.

        Empty: servos of this kind store none.
        """
        return ()

    def workshop(self) -> Any:
        """Return the module that finds servos which belong to no face, and sets single ones up.

        For Dynamixels it is `firmware_bridge.dynamixel.provisioning`. Raises BusError if there is
        none.
        """
        return self._module(self.workshop_module, "servos that could be found or set up")

    def simulator(self) -> Any:
        """Return the module with `simulated_wire` and `serve`, which simulates the servos' packets.

        For Dynamixels it is `firmware_bridge.simulator.host`. Raises BusError if there is none.
        """
        return self._module(self.simulator_module, "simulator")

    def _module(self, name: str, what: str) -> Any:
        if not name:
            raise self._lacks(what)
        return importlib.import_module(name)

    def _lacks(self, what: str) -> BusError:
        return BusError(f"a bus of kind {self.name} has no {what}")


def bus_names() -> list[str]:
    """Return the names of all installed kinds of bus, those that come with lipservo first."""
    others = sorted(point.name for point in entry_points(group=GROUP))
    return list(dict.fromkeys([*_BUILT_IN, *others]))


@cache
def bus_kind(name: str) -> BusKind:
    """Load and return the kind of bus of this name; raise UnknownBusError if there is none."""
    if name in _BUILT_IN:
        module, _, entry = _BUILT_IN[name].partition(":")
        kind = getattr(importlib.import_module(module), entry)
    else:
        kind = _other(name)
    if not isinstance(kind, BusKind):
        raise UnknownBusError(f"{name}: the package of this name is no bus; remove it")
    return kind


def other_line_kinds(own: str) -> Iterator[BusKind]:
    """Yield the built-in kinds of servos with ids on a serial line, but the kind named `own`."""
    for name in _BUILT_IN:
        kind = bus_kind(name)
        if name != own and not kind.at_port and kind.servo.address_key == "id":
            yield kind


def other_kind_at(transport: "Transport", own: str) -> str:
    """Return a message naming the kind whose servos answer at an open port; "" if none answers.

    `own`: the name of the kind that is not tried. Raises PortError when the port fails.
    """
    for other in other_line_kinds(own):
        if other.answers_at(transport):
            why = f"no servo answers as `kind: {own}`, but as `kind: {other.name}`"
            return f"{why}; correct the YAML"
    return ""


def kind_at(port: str) -> BusKind:
    """Return the kind that the device at `port` identifies itself as, otherwise `dynamixel`."""
    kinds = (bus_kind(name) for name in _BUILT_IN)
    return next((kind for kind in kinds if kind.is_at(port)), bus_kind(AT_A_PORT))


def _other(name: str) -> object:
    """Load a kind of bus from another package's entry point of the group `lipservo.buses`.

    Raises UnknownBusError if no package has one of this name, or loading it fails.
    """
    for point in entry_points(group=GROUP, name=name):
        try:
            return point.load()
        except Exception as error:  # whatever another package may raise
            raise UnknownBusError(f"bus plug-in {name}: {error}; reinstall or remove it") from error
    raise UnknownBusError(
        f"bus kind {name!r:.60} is not known here; use one of {', '.join(bus_names())}, or install "
        f"the package that provides it (entry point {GROUP})"
    )
