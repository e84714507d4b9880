"""How results and messages leave the program."""

import contextlib
import json
import platform
import sys
from collections.abc import Mapping

from rich.console import Console

#: Results go to stdout; everything else, progress and logs and complaints, to stderr. Names that
#: people gave to files and joints are printed as they are: `[a].wav` is no markup, `:b:` no emoji.
RESULTS = Console(markup=False, emoji=False, highlight=False)
MESSAGES = Console(stderr=True, markup=False, emoji=False, highlight=False)


def complain(text: str) -> None:
    """Why the program ends, on stderr; in vain where the terminal is gone."""
    with contextlib.suppress(OSError):
        sys.stderr.write("".join(f"lipservo: {line}\n" for line in text.splitlines()))
        sys.stderr.flush()


def print_json(result: Mapping[str, object]) -> None:
    """One object on one line of stdout."""
    sys.stdout.write(json.dumps(result) + "\n")


def say_simulated() -> None:
    """Tell a person that nothing real moves: a command moves servos that are only simulated."""
    MESSAGES.print(
        "SIMULATED: no real servo moves; --port, or `bus:` in the face's YAML, names real ones",
        style="bold yellow",
        soft_wrap=True,
    )


def machine_class() -> str:
    """What kind of machine measured: processor architecture, cores, Python."""
    import os

    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
