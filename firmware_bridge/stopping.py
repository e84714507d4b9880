"""How a face is stopped by a person, and what is known of its servos afterwards."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class StopLevel(StrEnum):
    """How a face comes to its end."""

    SOFT = "soft"  # ease to neutral, then let go
    FREEZE = "freeze"  # stay, held, until another level is asked for
    LIMP = "limp"  # let go now


@dataclass(frozen=True, slots=True)
class StopReport:
    """What the servos themselves said at the end; nothing is claimed for the others.

    confirmed: servos that were read with torque off. unconfirmed: why not, by servo.
    at_rest: the face had come to neutral before it let go. dry_run: nothing was ever switched on.
    """

    confirmed: tuple[str, ...]
    unconfirmed: Mapping[str, str]
    at_rest: bool
    dry_run: bool = False

    @property
    def complete(self) -> bool:
        """Whether every servo confirmed."""
        return not self.unconfirmed

    def text(self) -> str:
        """For a person: one line, or one more for each servo that did not confirm."""
        if self.dry_run:
            return "dry run over; no torque was switched on"
        where = "at rest and limp" if self.at_rest else "limp"
        n = len(self.confirmed)
        if self.complete:
            return f"stopped; the face is {where}: confirmed by {_servos(n)}"
        lines = [
            f"torque off was confirmed by {_servos(n)}, NOT by {_servos(len(self.unconfirmed))}:"
        ]
        lines += [f"  {name}: {why}" for name, why in self.unconfirmed.items()]
        lines.append("keep your hands away; `lipservo limp` lets go what can be reached")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            "complete": self.complete,
            "at_rest": self.at_rest,
            "dry_run": self.dry_run,
            "confirmed": list(self.confirmed),
            "unconfirmed": dict(self.unconfirmed),
        }


def _servos(n: int) -> str:
    return "1 servo" if n == 1 else f"{n} servos"
