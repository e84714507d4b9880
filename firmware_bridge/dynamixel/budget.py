"""How often a bus of so many servos can be written and read, from bytes and baud rate alone."""

from typing import Final

BITS_PER_BYTE: Final = 10
#: Sync write of goals; sync read of ten bytes, a frame each; one health read a cycle.
_WRITE, _WRITE_EACH = 14, 5
_ASK, _ASK_EACH, _ANSWER_EACH = 14, 1, 21
_HEALTH: Final = 14 + 11 + 35
#: What computer and adapter add to each of the two questions; one USB frame.
_TURNAROUND_S: Final = 0.001
#: Rates that servos and most adapters have.
USUAL_RATES: Final = (57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)


def cycle_s(n_servos: int, baud_rate: int, return_delay_s: float = 0.0) -> float:
    """Seconds of one cycle: goals out, places of all and health of one back."""
    n_bytes = _WRITE + _ASK + _HEALTH + n_servos * (_WRITE_EACH + _ASK_EACH + _ANSWER_EACH)
    waits_s = 2 * _TURNAROUND_S + (n_servos + 1) * return_delay_s
    return n_bytes * BITS_PER_BYTE / baud_rate + waits_s


def budget(
    n_servos: int, baud_rate: int, rate_hz: float, return_delay_s: float = 0.0
) -> str | None:
    """Why this bus cannot do `rate_hz` with feedback, and what would; None when it can."""
    if cycle_s(n_servos, baud_rate, return_delay_s) * rate_hz <= 1.0:
        return None
    better = [r for r in USUAL_RATES if cycle_s(n_servos, r) * rate_hz <= 1.0]
    can_hz = 1.0 / cycle_s(n_servos, baud_rate, return_delay_s)
    remedy = f"set {better[0]:,} baud" if better else "use fewer servos or a lower rate"
    if return_delay_s and cycle_s(n_servos, baud_rate) * rate_hz <= 1.0:
        remedy = "set the return delay to 0"
    return (
        f"{n_servos} servos at {baud_rate:,} baud cannot do {rate_hz:g} Hz with feedback, "
        f"only {can_hz:.0f}: {remedy} (`lipservo setup-servos`)"
    )
