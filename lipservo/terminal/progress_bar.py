"""Bars on stderr for work of several parts."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import Progress, TimeRemainingColumn

from lipservo.terminal.output import MESSAGES

#: What is done, how many, of how many.
Advance = Callable[[str, int, int], None]


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[Advance]:
    """A function (what, how many are done, of how many) that draws bars on stderr."""
    columns = (*Progress.get_default_columns()[:-1], TimeRemainingColumn())
    with Progress(*columns, console=MESSAGES, transient=True, disable=quiet) as progress:
        tasks = {}

        def advance(what: str, n_done: int, n_all: int) -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=n_all)
            progress.update(tasks[what], completed=n_done, total=n_all)

        yield advance
