"""How a face ended, and the exit status that says so."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

ENDED_WELL: Final = 0
#: It ended as asked, but not every servo confirmed to be limp.
UNCONFIRMED: Final = 3
#: A critical servo has failed: starting again would not help.
NOT_AGAIN: Final = 4


@dataclass(frozen=True, slots=True)
class EndReport:
    """Which servos confirmed to be limp, by name, and why the others did not."""

    status: int
    confirmed: tuple[str, ...] = ()
    unconfirmed: Mapping[str, str] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """For JSON, and for those who asked for the stop."""
        return {
            "exit_status": self.status,
            "confirmed": list(self.confirmed),
            "unconfirmed": dict(self.unconfirmed),
        }

    def text(self) -> str:
        """In one line."""
        if not self.unconfirmed:
            return f"torque off confirmed by all {len(self.confirmed)} servos"
        n, left = len(self.confirmed), named_by_reason(self.unconfirmed)
        return f"torque off confirmed by {n} servos, NOT by {left}"


def named_by_reason(unconfirmed: Mapping[str, str]) -> str:
    """Servos and reasons in words, each reason once: `jaw, left: did not answer` for one."""
    servos: dict[str, list[str]] = {}
    for name, why in unconfirmed.items():
        servos.setdefault(why, []).append(name)
    return "; ".join(f"{', '.join(names)}: {why}" for why, names in servos.items())
