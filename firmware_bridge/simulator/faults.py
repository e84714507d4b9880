"""What can go wrong on the simulated wire and in the simulated servos, by seed and by moment."""

import math
import random
from dataclasses import dataclass
from typing import Final

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
#: Those that are over after `lasts_s`; the others are a matter of a moment.
LASTING: Final = frozenset(
    {
        *("silence", "brown_out", "overload", "overheat", "undervoltage", "overvoltage"),
        *("jam", "load", "answers_stop", "unplug"),
    }
)


@dataclass(frozen=True, slots=True)
class Amount:
    """What `amount` means for one kind, and between which bounds it lies; whole: no fractions."""

    meaning: str
    low: float
    high: float
    whole: bool = False
    needed: bool = False


#: Kinds that are not here have no amount.
AMOUNTS: Final = {
    "late_reply": Amount("seconds late", 0.0, 10.0, needed=True),
    "error_reply": Amount("error byte of the reply, else 1", 1, 255, whole=True),
    "babble": Amount("bytes of noise, else 8", 1, 1000, whole=True),
    "overload": Amount("load as a share of the stall torque, else 0.9", 0.0, 1.0),
    "overheat": Amount("degC, else 5 above the limit", 0.0, 200.0),
    "undervoltage": Amount("volt, else 0.6 of nominal", 0.0, 60.0),
    "overvoltage": Amount("volt, else 1.5 of nominal", 0.0, 60.0),
    "encoder_fault": Amount("degrees that the reading jumps", -360.0, 360.0),
    "jam": Amount("load as a share of the stall torque", 0.0, 1.0),
    "load": Amount("load as a share of the stall torque", 0.0, 1.0, needed=True),
    "id_change": Amount("the new id", 0, 252, whole=True, needed=True),
    "return_delay_drift": Amount("register value, else 250", 1, 254, whole=True),
    "limits_drift": Amount("the new max_position_limit, else 4095", 1, 4095, whole=True),
    "pushed": Amount("degrees", -360.0, 360.0, needed=True),
}


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
        """Whether it hits a packet of servo `index` now."""
        return (
            (not self.servos or index in self.servos)
            and self.from_s <= now_s < self.until_s
            and rng.random() < self.probability
        )
