"""Processor time of the whole bridge process, beside a loop with dynamixel-sdk or rustypot."""

import statistics
import tempfile
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from lipservo.face.sim_process import simulated_port
from lipservo_lab.bench.bus import servo_clients
from lipservo_lab.bench.bus.measured_process import (
    N_SERVOS,
    MeasuredProcess,
    bridge_process,
    client_process,
)
from lipservo_lab.bench.bus.servo_clients import canned_peer

_WIRE_BAUD_RATE: Final = 1_000_000
_SIMULATED: Final = ("--servos", str(N_SERVOS), "--baud-rate", str(_WIRE_BAUD_RATE), "--on-time")


@dataclass(frozen=True, slots=True)
class Comparison:
    """The same servos for our process and for others.

    peer: opens their port. loops: what the ratio over each loop of `client_loop` is called.
    """

    peer: Callable[[], AbstractContextManager[str]]
    baud_rate: int
    loops: Mapping[str, str]
    n_turns: int


AT_ONCE = Comparison(
    partial(canned_peer, N_SERVOS, on_time=True),
    servo_clients.BAUD_RATE,
    {
        "sdk": "cpu_process_ratio",
        "sdk_all_fast": "cpu_process_all_fast_ratio",
        "sdk_in_turn": "cpu_process_in_turn_ratio",
        "sdk_waiting": "cpu_process_waiting_ratio",
        "sdk_in_turn_waiting": "cpu_process_in_turn_waiting_ratio",
        "rustypot_in_turn": "cpu_process_ratio_rustypot",
    },
    n_turns=30,
)
ON_THE_WIRE = Comparison(
    partial(simulated_port, _SIMULATED),
    _WIRE_BAUD_RATE,
    {
        "sdk": "cpu_process_wire_ratio",
        "sdk_in_turn": "cpu_process_wire_in_turn_ratio",
        "rustypot_in_turn": "cpu_process_wire_ratio_rustypot",
    },
    n_turns=10,
)


def process_ratios() -> dict[str, float]:
    """CPU a tick of `lipservo bridge-process` over that of a process with another's loop.

    Ours is the process that a daemon starts, whole: grid, control socket, lifeline, targets through
    a socket, gate, goals written, places read (fast), one servo's health read, supervision, live
    board. The others: goals through the same socket, written; places read (fast); voltage and
    temperature of all read (`GroupSyncRead`; `all_fast`: in one frame, too), or, `in_turn`, the
    very reads of our tick: one servo's health; no gate, no stop, no status.

    User and system time of all threads of a process, by its own clock; medians of the turns, each
    of some sixty ticks, while the others stand still; `least`: of the least turns. Each has a peer
    of its own, which answers at once, with real-time scheduling where permitted. dynamixel-sdk
    polls while it waits for it, which is in its figures; `waiting`: with a port that sleeps
    instead, which is not the SDK's. `wire`: with simulated servos that take the time of 1 Mbaud, as
    real ones do; the SDK polls all the while.
    """
    at_once, on_the_wire = _turns_us(AT_ONCE), _turns_us(ON_THE_WIRE)
    figures = {
        "cpu_process_us": statistics.median(at_once["own"]),
        "cpu_process_wire_us": statistics.median(on_the_wire["own"]),
        "cpu_process_ratio_least": min(at_once["own"]) / min(at_once["sdk"]),
    }
    for turns_us, comparison in ((at_once, AT_ONCE), (on_the_wire, ON_THE_WIRE)):
        own_us = statistics.median(turns_us["own"])
        for kind, name in comparison.loops.items():
            if kind in turns_us:
                figures[name] = own_us / statistics.median(turns_us[kind])
    return figures


def _turns_us(comparison: Comparison) -> dict[str, list[float]]:
    """CPU a tick of every turn in which servos were driven, by loop, ours called `own`."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="lipservo-bench-"))
        port, rate = stack.enter_context(comparison.peer()), comparison.baud_rate
        ours = bridge_process(Path(folder), port, rate)
        loops: dict[str, MeasuredProcess] = {"own": stack.enter_context(ours)}
        for kind in comparison.loops:
            if "rustypot" not in kind or find_spec("rustypot") is not None:
                port = stack.enter_context(comparison.peer())
                loops[kind] = stack.enter_context(client_process(kind, port, rate))
        for _ in range(comparison.n_turns):
            for each in loops.values():
                each.take_turn()
        return {kind: each.spent_us for kind, each in loops.items() if each.spent_us}
