"""How results and messages leave the program."""

import json
import platform
import sys
from collections.abc import Mapping

from rich.console import Console

#: Results go to stdout; everything else, progress and logs and complaints, to stderr.
RESULTS = Console()
MESSAGES = Console(stderr=True)


def print_json(result: Mapping[str, object]) -> None:
    """One object on one line of stdout."""
    sys.stdout.write(json.dumps(result) + "\n")


def machine_class() -> str:
    """What kind of machine measured: processor architecture, cores, Python."""
    import os

    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
