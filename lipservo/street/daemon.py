"""The loop around the pipeline, on the life cycle of the face."""

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from firmware_bridge.loop.life_cycle import LifeCycle
from lipservo.status.street_tick import TickObserver
from lipservo.street.street import Street
from lipservo.street.summary import Tally


def play(
    street: Street,
    life: LifeCycle,
    *,
    until_s: float,
    tally: Tally,
    observers: Sequence[TickObserver] = (),
) -> None:
    """Run the street until monotonic `until_s` or until somebody stops the face; then to rest."""
    for time_s, late in life.ticks():
        if time_s >= until_s and not life.stopping:
            life.stop()
        tally.begin_tick(time_s)
        tick = street.rest(time_s, late) if life.stopping else street.tick(time_s, late)
        tally.observe(tick)
        for observer in observers:
            observer.observe(tick)


@contextmanager
def stopped_by_signals() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set: for work that moves nothing and has a result to keep.

    A handler that only sets an event cannot leave anything half done, wherever it strikes.
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
