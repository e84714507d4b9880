"""What a person orders of a face besides stops and settings: single servos, jogging, a start."""

from dataclasses import dataclass
from enum import StrEnum


class ServoSwitch(StrEnum):
    """What may be asked of one servo."""

    OFF = "off"  # torque off, and it stays off until ON
    ON = "on"  # tried again, also after it was given up
    REBOOT = "reboot"


@dataclass(frozen=True, slots=True)
class ServoOrder:
    """Switch one servo, by name. requested_by: who, for a log."""

    name: str
    switch: ServoSwitch
    requested_by: str = ""

    def __str__(self) -> str:
        return f"servo {self.name} {self.switch.value}"


@dataclass(frozen=True, slots=True)
class ArmJog:
    """Jogging is meant: for a few seconds, or as long as it is renewed."""


@dataclass(frozen=True, slots=True)
class JogTo:
    """One joint goes to an angle, in joint degrees, and stays there."""

    name: str
    position_deg: float


@dataclass(frozen=True, slots=True)
class EndJog:
    """All jogged joints go back to what is wanted of them."""


@dataclass(frozen=True, slots=True)
class StartFace:
    """A stopped face is to be driven again. requested_by: a process and its user, for a log."""

    requested_by: str = ""


Order = ServoOrder | ArmJog | JogTo | EndJog | StartFace
