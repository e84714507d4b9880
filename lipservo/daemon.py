"""The loop around the pipeline: clock, signals, and a defined end whatever happens."""

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from firmware_bridge.clock import Clock, ticks
from lipservo.pipeline import Street, TickObserver
from lipservo.summary import Tally


def play(
    street: Street,
    clock: Clock,
    *,
    rate_hz: float,
    until_s: float,
    stop: threading.Event,
    tally: Tally,
    observers: Sequence[TickObserver] = (),
) -> None:
    """Run the street on the clock's grid until monotonic `until_s` or until `stop` is set.

    However it ends, also by an exception, the face eases to neutral and torque goes off.
    """
    street.bridge.arm()
    try:
        for time_s, late in ticks(clock, rate_hz):
            if time_s >= until_s or stop.is_set():
                break
            tally.begin_tick(time_s)
            tick = street.tick(time_s, late)
            tally.observe(tick)
            for observer in observers:
                observer.observe(tick)
    finally:
        street.bridge.ease_to_neutral(clock)


@contextmanager
def stopped_by_signals() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set, so that the loop ends at its next tick.

    A handler that only sets an event cannot leave a tick half done, wherever it strikes.
    """
    stop = threading.Event()

    def ask_to_stop(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    previous = {n: signal.signal(n, ask_to_stop) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
