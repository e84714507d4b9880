"""Processor time of the whole bridge process, beside a loop with dynamixel-sdk or rustypot."""

import statistics
import tempfile
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from lipservo.bench.bus.measured_process import (
    BAUD_RATE,
    N_SERVOS,
    MeasuredProcess,
    bridge_process,
    client_process,
)
from lipservo.bench.bus.servo_clients import canned_peer
from lipservo.face.sim_process import simulated_port

#: What the ratio over each loop is called: cpu_process*_ratio. Peers that answer at once.
_AT_ONCE: Final = {
    "sdk": "",
    "sdk_all_fast": "_all_fast",
    "sdk_in_turn": "_in_turn",
    "sdk_waiting": "_waiting",
    "sdk_in_turn_waiting": "_in_turn_waiting",
    "rustypot_in_turn": "_rustypot",
}
#: The same with servos that take the time of the wire.
_ON_THE_WIRE: Final = {
    "sdk": "_wire",
    "sdk_in_turn": "_wire_in_turn",
    "rustypot_in_turn": "_wire_rustypot",
}
_TURNS, _TURNS_ON_THE_WIRE = 30, 10


def process_ratios() -> dict[str, float]:
    """CPU a tick of `lipservo bridge-process` over that of a process with another's loop.

    Ours is the process that a daemon starts, whole: grid, control socket, lifeline, targets through
    a socket, gate, goals written, places read (fast), one servo's health read, supervision, live
    board. The others: goals through the same socket, written; places read (fast); voltage and
    temperature of all read (`GroupSyncRead`; `all_fast`: in one frame, too), or, `in_turn`, the
    very reads of our tick: one servo's health; no gate, nobody who may stop them, no status.

    User and system time of all threads of a process, by its own clock; medians of the turns, each
    of some sixty ticks, while the others stand still. Each has a peer of its own, which answers at
    once, with real-time scheduling where permitted. dynamixel-sdk polls while it waits for it; `waiting`: with a port that sleeps instead,
    which is not the SDK's. `wire`: with simulated servos that take the time of the wire, 1 Mbaud,
    as real ones do; the SDK polls all the while.
    """
    at_once, n_ticks = _medians_us(_AT_ONCE, lambda: canned_peer(N_SERVOS, on_time=True), _TURNS)
    options = ["--servos", str(N_SERVOS), "--baud-rate", str(BAUD_RATE), "--on-time"]
    on_the_wire, _ = _medians_us(_ON_THE_WIRE, lambda: simulated_port(options), _TURNS_ON_THE_WIRE)
    figures = {
        "cpu_process_us": at_once["own"],
        "cpu_process_wire_us": on_the_wire["own"],
        "cpu_process_ticks": n_ticks,
    }
    for middle_us, names in ((at_once, _AT_ONCE), (on_the_wire, _ON_THE_WIRE)):
        for kind, name in names.items():
            if kind in middle_us:
                figures[f"cpu_process{name}_ratio"] = middle_us["own"] / middle_us[kind]
    return figures


def _medians_us(
    kinds: Iterable[str],
    peer: Callable[[], AbstractContextManager[str]],
    n_turns: int,
) -> tuple[dict[str, float], int]:
    """CPU a tick by loop, `own` among them, the median of the turns; and our ticks in all."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="lipservo-bench-"))
        ours = bridge_process(Path(folder), stack.enter_context(peer()))
        loops: dict[str, MeasuredProcess] = {"own": stack.enter_context(ours)}
        for kind in kinds:
            if "rustypot" not in kind or find_spec("rustypot") is not None:
                other = client_process(kind, stack.enter_context(peer()))
                loops[kind] = stack.enter_context(other)
        for _ in range(n_turns):
            for each in loops.values():
                each.take_turn()
        middle_us = {
            name: statistics.median(each.spent_us) for name, each in loops.items() if each.spent_us
        }
        return middle_us, loops["own"].n_rounds
