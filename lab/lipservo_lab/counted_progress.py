"""Progress of work that reports each thing as it is done, without a number."""

from collections.abc import Callable
from itertools import count

from lipservo.terminal.output import Advance


def counting(advance: Advance, what: str, n_all: int) -> Callable[..., None]:
    """Return a function that advances the bar of `what` by one at each call.

    It ignores what it is called with, such as the name of what is done.
    """
    numbers = count(1)
    return lambda *_: advance(what, next(numbers), n_all)
