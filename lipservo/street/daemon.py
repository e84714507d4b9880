"""The loop around the pipeline, on the life cycle of the face."""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
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
    is_over: Callable[[float], bool],
    tally: Tally,
    observers: Sequence[TickObserver] = (),
) -> None:
    """Run the street until it is over or a person stops the face; then to rest.

    A life cycle that waits for a start goes on: sound is heard and dropped meanwhile, so that
    nothing has to be caught up with. is_over: asked at the monotonic time of each tick.
    """
    for time_s, late in life.ticks():
        if not life.stopping and is_over(time_s):
            life.stop()
        tally.begin_tick(time_s)
        if life.stopping and not life.waits:
            tick = street.rest(time_s, late)
        else:
            street.side.follow_stop(time_s, is_stopped=life.stopping)
            tick = street.tick(time_s, late)
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
