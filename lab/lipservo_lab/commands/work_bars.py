"""Bars of long work: a bar for each thing that is counted, and a line that says what is done."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from rich.progress import Progress, TaskID

from lipservo.terminal.output import MESSAGES

_Item = TypeVar("_Item")


class WorkBars:
    """Shows the progress of long work; use `work_bars` to make one."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._step: TaskID | None = None

    def track(self, what: str, items: Sequence[_Item]) -> Iterable[_Item]:
        """Yield the items, with a bar of its own that counts them."""
        yield from self._progress.track(items, description=what)

    def read(self, names: Sequence[str]) -> Iterable[str]:
        """Yield the names of recordings, counted as they are read."""
        return self.track("reading", names)

    def listen(self, items: Sequence[_Item]) -> Iterable[_Item]:
        """Yield the items, counted as they are listened to."""
        return self.track("listening", items)

    def tell(self, text: str) -> None:
        """Show what is done now, without a count."""
        if self._step is None:
            self._step = self._progress.add_task(text, total=None)
        self._progress.update(self._step, description=text)

    def advance(self, what: str, n_done: int, n_all: int) -> None:
        """Show what is done now with a count, on the line of `tell`."""
        self.tell(what)
        if self._step is not None:
            self._progress.update(self._step, completed=n_done, total=n_all)


@contextmanager
def work_bars(*, quiet: bool) -> Iterator[WorkBars]:
    """Show progress bars on stderr until the block ends; nothing if `quiet`."""
    with Progress(console=MESSAGES, transient=True, disable=quiet) as progress:
        yield WorkBars(progress)
