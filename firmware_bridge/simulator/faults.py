"""What can go wrong on the simulated wire and in the simulated servos: seeded, scripted in YAML."""

import math
import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import yaml

#: What happens to a status packet on its way, by chance.
ON_REPLIES: Final = frozenset(
    {
        "drop_reply",
        "corrupt_reply",
        "truncate_reply",
        "duplicate_reply",
        "late_reply",
        "wrong_id",
        "error_reply",
        "babble",
        "echo",
    }
)
#: What happens to an instruction packet on its way, by chance.
ON_INSTRUCTIONS: Final = frozenset({"drop_instruction", "corrupt_instruction"})
#: What happens to a servo, or to all, at a moment; `lasts_s` later it is over.
ON_SERVOS: Final = frozenset(
    {
        "silence",
        "reboot",
        "brown_out",
        "overload",
        "overheat",
        "undervoltage",
        "overvoltage",
        "shock",
        "encoder_fault",
        "jam",
        "load",
        "torque_lost",
        "id_change",
        "baud_reset",
        "return_delay_drift",
        "limits_drift",
        "answers_stop",
        "watchdog_trip",
        "pushed",
        "unplug",
    }
)
KINDS: Final = tuple(sorted(ON_REPLIES | ON_INSTRUCTIONS | ON_SERVOS))


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault. servos: indices in the chain, empty = all.

    On packets: happens with `probability` between from_s and until_s.
    On servos: happens at each of at_s and every `every_s` (0 = never), for lasts_s.
    amount: what the kind needs: seconds late, bits corrupted, degrees pushed, load share.
    """

    kind: str
    servos: tuple[int, ...] = ()
    probability: float = 1.0
    from_s: float = 0.0
    until_s: float = math.inf
    at_s: tuple[float, ...] = ()
    every_s: float = 0.0
    lasts_s: float = 0.0
    amount: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"fault {self.kind!r} is not known; use one of {', '.join(KINDS)}")
        if not 0.0 <= self.probability <= 1.0:
            raise ValueError(f"fault {self.kind}: probability {self.probability} is outside 0..1")

    def hits(self, index: int, now_s: float, rng: random.Random) -> bool:
        """Whether it befalls a packet of servo `index` now."""
        return (
            (not self.servos or index in self.servos)
            and self.from_s <= now_s < self.until_s
            and rng.random() < self.probability
        )

    def moments_s(self, until_s: float) -> list[float]:
        """When it befalls servos, in order, up to `until_s`."""
        moments = [s for s in self.at_s if s <= until_s]
        if self.every_s > 0.0:
            last = min(until_s, self.until_s)
            n = int((last - self.from_s) / self.every_s)
            moments += [self.from_s + k * self.every_s for k in range(1, n + 1)]
        return sorted(moments)


def read_faults(text: str) -> tuple[int, tuple[Fault, ...]]:
    """Seed and faults of a YAML script: `seed: 1` and a list `faults`.

    Raises ValueError for anything unknown in it.
    """
    content = yaml.safe_load(text)
    if not isinstance(content, dict) or set(content) - {"seed", "faults"}:
        raise ValueError("a fault script needs `faults: [...]` and may have `seed: <number>`")
    faults = tuple(_fault(raw) for raw in content.get("faults") or ())
    return int(content.get("seed", 0)), faults


def _fault(raw: Any) -> Fault:
    known = set(Fault.__dataclass_fields__)
    if not isinstance(raw, dict) or "kind" not in raw or set(raw) - known:
        raise ValueError(f"a fault needs `kind` and knows {', '.join(sorted(known))}; got {raw!r}")
    tuples = {
        key: tuple(value if isinstance(value, Sequence) else [value])
        for key, value in raw.items()
        if key in ("servos", "at_s")
    }
    return Fault(**{**raw, **tuples})


def schedule(faults: Iterable[Fault], until_s: float) -> list[tuple[float, Fault]]:
    """Every moment at which something befalls a servo, in order."""
    moments = [
        (s, fault) for fault in faults if fault.kind in ON_SERVOS for s in fault.moments_s(until_s)
    ]
    return sorted(moments, key=lambda moment: moment[0])
