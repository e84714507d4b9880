"""How often a bus of so many servos can be written and read, from bytes and baud rate alone."""

from typing import Final

from firmware_bridge.dynamixel.wire.codec import BITS_PER_BYTE

#: Sync write of goals; sync read of ten bytes, a frame each; one health read a cycle.
_WRITE, _WRITE_EACH = 14, 5
_ASK, _ASK_EACH, _ANSWER_EACH = 14, 1, 21
_HEALTH: Final = 14 + 11 + 35
#: What computer and adapter add to each of the two questions; one USB frame.
_TURNAROUND_S: Final = 0.001
#: Rates that servos and most adapters have.
USUAL_RATES: Final = (57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)


def cycle_s(
    n_servos: int, baud_rate: int, return_delay_s: float = 0.0, latency_s: float = 0.0
) -> float:
    """Seconds of one cycle: goals out, places of all and health of one back.

    latency_s: how long the adapter holds an answer back; a USB frame at least.
    """
    n_bytes = _WRITE + _ASK + _HEALTH + n_servos * (_WRITE_EACH + _ASK_EACH + _ANSWER_EACH)
    waits_s = 2 * max(_TURNAROUND_S, latency_s) + (n_servos + 1) * return_delay_s
    return n_bytes * BITS_PER_BYTE / baud_rate + waits_s


def slow_adapter(
    n_servos: int, baud_rate: int, rate_hz: float, latency_timer_ms: float | None
) -> str | None:
    """Why this adapter cannot do `rate_hz`, and what to do; None when it can or does not tell.

    latency_timer_ms: as `serial_transport.latency_timer_ms` reads it; 16 is what FTDI chips come
    with: https://github.com/ROBOTIS-GIT/DynamixelSDK/issues/302
    """
    tick_s = cycle_s(n_servos, baud_rate, latency_s=(latency_timer_ms or 0.0) * 1e-3)
    if latency_timer_ms is None or latency_timer_ms <= 1.0 or tick_s * rate_hz <= 1.0:
        return None
    return (
        f"at {latency_timer_ms:g} ms of adapter latency a tick takes {tick_s * 1e3:.0f} ms: "
        f"{rate_hz:g} Hz cannot be met; set the latency timer to 1 ms (docs/hardware.md)"
    )


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
