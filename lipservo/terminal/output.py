"""The output of results, messages and progress to stdout and stderr."""

import contextlib
import json
import logging
import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, cast

from firmware_bridge.process.logs import LOG_JSON

if TYPE_CHECKING:
    from rich.console import Console

#: Reports progress: (what is done, how many are done, of how many).
Advance = Callable[[str, int, int], None]
#: With `--log-json` messages for stderr become log lines of this logger.
_LOG: Final = logging.getLogger("lipservo.messages")
_LOG.setLevel(logging.INFO)
#: What rich leaves out of a text.
_CONTROLS: Final = dict.fromkeys(map(ord, "\a\b\v\f\r"))


class _LazyConsole:
    """A console of rich that is created on first need; plain lines are written without rich."""

    def __init__(self, *, stderr: bool) -> None:
        self._stderr = stderr
        self._rich: Console | None = None

    def print(self, *objects: object, **options: Any) -> None:
        """Print as `rich.console.Console.print`; the terminal breaks lines that are too long.

        With `--log-json` a line for stderr becomes a log line.
        """
        # Plain text without options needs no rich, which takes long to import.
        is_line = len(objects) == 1 and type(objects[0]) is str
        options = {"soft_wrap": is_line, **options}
        is_plain = not any(value for name, value in options.items() if name != "soft_wrap")
        if self._stderr and is_line and os.environ.get(LOG_JSON):
            _LOG.info("%s", objects[0])
        elif self._rich is None and is_line and is_plain:
            stream = sys.stderr if self._stderr else sys.stdout
            stream.write(f"{objects[0]}\n".translate(_CONTROLS))
            stream.flush()
        else:
            self._console().print(*objects, **options)

    def _console(self) -> "Console":
        if self._rich is None:
            from rich.console import Console

            self._rich = Console(stderr=self._stderr, markup=False, emoji=False, highlight=False)
        return self._rich

    def __getattr__(self, name: str) -> Any:
        return getattr(self._console(), name)

    def __enter__(self) -> "Console":
        return self._console().__enter__()

    def __exit__(self, *exc: Any) -> None:
        self._console().__exit__(*exc)


#: Results go to stdout; everything else, progress and logs and complaints, to stderr. Names that
#: people gave to files and joints are printed as they are: `[a].wav` is no markup, `:b:` no emoji.
RESULTS = cast("Console", _LazyConsole(stderr=False))
MESSAGES = cast("Console", _LazyConsole(stderr=True))


def complain(text: str) -> None:
    """Print to stderr why the program ends; ignore a terminal that is gone."""
    if os.environ.get(LOG_JSON):
        _LOG.error("%s", text)
        return
    with contextlib.suppress(OSError):
        sys.stderr.write("".join(f"lipservo: {line}\n" for line in text.splitlines()))
        sys.stderr.flush()


def print_json(result: Mapping[str, object]) -> None:
    """Print an object as one line of JSON on stdout."""
    sys.stdout.write(json.dumps(result) + "\n")


def say_simulated() -> None:
    """Print a warning that the command moves simulated servos only."""
    MESSAGES.print(
        "SIMULATED: no real servo moves; for real ones give --port, or `bus:` in the face's YAML",
        style="bold yellow",
    )


def machine_class() -> str:
    """Return the machine in words: processor architecture, cores, Python."""
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[Advance]:
    """Yield a function that draws bars on stderr: (label, number done, number in all).

    quiet: it draws nothing.
    """
    from rich.progress import Progress, TimeRemainingColumn

    columns = (*Progress.get_default_columns()[:-1], TimeRemainingColumn())
    with Progress(*columns, console=MESSAGES, transient=True, disable=quiet) as progress:
        tasks = {}

        def advance(label: str, n_done: int, n_all: int) -> None:
            if label not in tasks:
                tasks[label] = progress.add_task(label, total=n_all)
            progress.update(tasks[label], completed=n_done, total=n_all)

        yield advance
