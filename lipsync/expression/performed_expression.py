"""Head and eyes of a performance in place of the live ones, and the way over between them."""

from dataclasses import replace
from typing import Final

from lipsync.expression.bounded import smoothstep, toward
from lipsync.expression.cue import CUE_PERIOD_S
from lipsync.face.frame import NO_EXPRESSION, Expression

#: How long each takes to go over: a neck as in a slow turn, eyes as in a large saccade, lids as in
#: a blink, so that none is left half shut.
_OVER_S: Final = {
    "neck_pitch_deg": 0.8, "neck_yaw_deg": 0.8, "neck_roll_deg": 0.8,
    "eye_pitch_deg": 0.2, "eye_yaw_deg": 0.2,
    "lid_left": 0.1, "lid_right": 0.1, "brow": 0.3,
}  # fmt: skip
#: A changed amount is there after as long a time for each 1 of change, as in `LiveExpression`.
_AMOUNT_S: Final = 1.0


class PerformedExpression:
    """`step` once for every 10 ms that are shown."""

    def __init__(self) -> None:
        self._shares = dict.fromkeys(_OVER_S, 0.0)
        self._held = dict.fromkeys(_OVER_S, 0.0)
        self._amount = 0.0

    def step(self, live: Expression, stored: Expression, amount: float) -> Expression:
        """What is shown. stored: what the performance says, `NO_EXPRESSION` where there is none.

        amount: how lively the face is to be; at 0 it is still, as without a performance. Where a
        performance ends or is cut off, its last pose is left for the live one.
        """
        self._amount = toward(self._amount, amount, CUE_PERIOD_S / _AMOUNT_S)
        is_still = amount <= 0.0
        mixed = {}
        for name, over_s in _OVER_S.items():
            value = None if is_still or stored is NO_EXPRESSION else getattr(stored, name)
            if value is not None:
                self._held[name] = value if name.startswith("lid") else self._amount * value
            wanted = float(value is not None)
            share = toward(self._shares[name], wanted, CUE_PERIOD_S / over_s)
            self._shares[name] = share
            if share > 0.0:
                ours = getattr(live, name) or 0.0
                mixed[name] = ours + smoothstep(share) * (self._held[name] - ours)
        return replace(live, **mixed) if mixed else live
