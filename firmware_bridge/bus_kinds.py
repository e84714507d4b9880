"""Kinds of servo bus: a kind is one entry, found by the name that a face's YAML gives it.

The entry brings the settings, opens the bus, simulates it, and knows what can be done at its port
while no face drives it. Kinds of other packages are entry points of the group `lipservo.buses`. A
kind is loaded when its name is first used, and what opens a port when it is opened.
"""

import importlib
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
#: Of a servo that was told to let go.
NOT_SEEN: Final = "did not answer"
#: What is at a port of which nothing else is known.
AT_A_PORT: Final = "dynamixel"


class UnknownBusError(BusError):
    """A kind of bus that is not installed, or cannot be loaded."""


@dataclass(frozen=True, slots=True)
class Wiring:
    """The servos of one face on one bus.

    settings: of the kind's own model; servos: likewise, in the order of `joints`. kept: the file in
    which a bus whose servos cannot say where they stand keeps where it sent them; None: nowhere.
    capabilities: what servos in memory can do that stand for others; None: what their kind can.
    """

    settings: Any
    joints: tuple[Joint, ...]
    servos: tuple[Any, ...]
    rate_hz: float
    kept: Path | None = None
    capabilities: BusCapabilities | None = None


class Severity(IntEnum):
    """How much a finding matters."""

    GOOD = 0
    WARNING = 1
    BAD = 2


@dataclass(frozen=True, slots=True)
class Finding:
    """What was seen, and what to do about it."""

    severity: Severity
    what: str
    remedy: str = ""


class PortRelease(Protocol):
    """An open port whose servos are let go, regardless of what drove them.

    Methods raise PortError.
    """

    @property
    def confirms(self) -> bool:
        """Whether servos can say that they were let go."""

    def tell_all(self, addresses: Sequence[int]) -> None:
        """Send torque off to these addresses, and to all others at the port."""

    def ask(self, address: int) -> str:
        """Return "" when a servo confirms torque off.

        Else the reason, and the order is sent once more.
        """

    def find(self, addresses: Sequence[int]) -> Sequence[int]:
        """Let go of everybody, at whatever rate they are spoken to; who there is, and these."""

    def close(self) -> None:
        """Close the port."""


class BusKind:
    """One kind of bus. A kind of another package derives from this and leaves out what it has not.

    Methods import what they need, so that an entry costs nothing but its name. Those that open a
    port raise PortError, and ServoError where servos are not as the face's YAML says.
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

    def capabilities(self, settings: "BusSettings") -> BusCapabilities:
        """Return the capabilities of its servos; known while no port is open."""
        raise NotImplementedError

    def open(self, wiring: Wiring, clock: "Clock", *, strict: bool = True) -> "ServoBus":
        """The bus, to be used as a context manager; not strict: servos may be missing."""
        raise NotImplementedError

    def slowness(self, _wiring: Wiring, _rate_hz: float) -> str | None:
        """Why the bus cannot do this rate with feedback, and what to do; None: it can."""
        return None

    def allow_first_start(self, _wiring: Wiring) -> None:
        """Allow servos of unknown position to jump to neutral; a person confirmed it."""

    def is_at(self, _port: str) -> bool:
        """Whether what is plugged in at a port says by itself that it is of this kind."""
        return False

    def answers_at(self, _transport: "Transport") -> bool:
        """Whether servos of this kind answer at an open port; asks, and sets nothing."""
        return False

    def port_release(self, _port: str, _wiring: Wiring | None) -> Callable[[], PortRelease]:
        """What opens a port to let go of the servos there, again and again, on the same adapter.

        wiring: None: nothing is known of what is there.
        """
        raise self._lacks("port")

    def examine(self, _wiring: Wiring) -> Iterator[Finding]:
        """Whatever is wrong between computer and servos; writes to none."""
        raise self._lacks("doctor")

    def memories(self, _wiring: Wiring) -> Sequence[Mapping[str, int] | None]:
        """What each servo keeps in itself; None: it does not answer. Empty: they keep nothing."""
        return ()

    def workshop(self) -> Any:
        """The module of what is done to single servos: find those of no face, set them up.

        `firmware_bridge.dynamixel.provisioning` for one.
        """
        return self._module(self.workshop_module, "servos that could be found or set up")

    def simulator(self) -> Any:
        """The module that simulates the same servos to the byte: `simulated_wire` and `serve`.

        `firmware_bridge.simulator.host` for one.
        """
        return self._module(self.simulator_module, "simulator")

    def _module(self, name: str, what: str) -> Any:
        if not name:
            raise self._lacks(what)
        return importlib.import_module(name)

    def _lacks(self, what: str) -> BusError:
        return BusError(f"bus {self.name}: has no {what}")


def bus_names() -> list[str]:
    """Return the names of all installed kinds, those that come with lipservo first."""
    others = sorted(point.name for point in entry_points(group=GROUP))
    return list(dict.fromkeys([*_BUILT_IN, *others]))


@cache
def bus_kind(name: str) -> BusKind:
    """The kind of this name, loaded. Raises UnknownBusError: what there is, and what to install."""
    if name in _BUILT_IN:
        module, _, entry = _BUILT_IN[name].partition(":")
        kind = getattr(importlib.import_module(module), entry)
    else:
        kind = _other(name)
    if not isinstance(kind, BusKind):
        raise UnknownBusError(f"{name}: what is installed under this name is no bus")
    return kind


def other_kind_at(transport: "Transport", own: str) -> str:
    """Name the other kind of bus that answers where no servo of the kind `own` does; empty: none.

    Raises PortError when the port fails.
    """
    for name in _BUILT_IN:
        kind = bus_kind(name)
        if not kind.at_port and name != own and kind.answers_at(transport):
            return f"no servo answers as `kind: {own}`, but as `kind: {name}`; correct the YAML"
    return ""


def kind_at(port: str) -> BusKind:
    """What is plugged in at a port as it says itself; of those that say nothing, `AT_A_PORT`."""
    kinds = (bus_kind(name) for name in _BUILT_IN)
    return next((kind for kind in kinds if kind.is_at(port)), bus_kind(AT_A_PORT))


def _other(name: str) -> object:
    for point in entry_points(group=GROUP, name=name):
        try:
            return point.load()
        except Exception as error:  # whatever another package may raise
            raise UnknownBusError(f"{name}: {point.value} cannot be loaded: {error}") from error
    raise UnknownBusError(
        f"{name!r:.60} is not known here; use one of {', '.join(bus_names())}, or install the "
        f"package that brings it (entry point {GROUP})"
    )
