"""Records of the buses that faces have driven at a port, to switch torque off after a crash.

A file for each board beside the control sockets, written before the port is opened: nothing of one
kind of servo may be written to another.
"""

import contextlib
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from firmware_bridge.bus_kinds import BusKind, UnknownBusError, bus_kind, kind_at
from firmware_bridge.bus_settings import BusSettings
from firmware_bridge.process.runtime_folder import (
    ControlError,
    name_in_path,
    runtime_folder,
    searched_folders,
)

_SUFFIX: Final = ".bus"
_LONGEST_BYTES: Final = 4096


def note_port(settings: BusSettings) -> None:
    """Write bus settings and port to a file, so that a later process can switch its torque off.

    The file is in the runtime folder; errors of writing are ignored.
    """
    assert settings.port is not None
    content = {
        "plug": _plug(settings.port),
        "noted_ns": time.monotonic_ns(),
        "bus": settings.model_dump(),
    }
    with contextlib.suppress(OSError, ControlError):
        name = f"{_name(settings.port)}@{name_in_path(settings.board)}{_SUFFIX}"
        path = runtime_folder() / name
        coming = path.with_name(f".{name}.{os.getpid()}")
        coming.write_text(json.dumps(content))
        coming.replace(path)


def buses_at(port: str) -> list[tuple[BusKind, BusSettings | None]]:
    """Return the buses driven at a port since it was plugged in, as (kind, settings).

    Several if boards share the port: the newest record of each board, all of the kind that was
    driven last. Without a record: the kind that the plugged-in device itself reports, else that of
    `AT_A_PORT`, with settings None.
    """
    found = sorted(_noted(port), key=lambda each: each[0], reverse=True)
    of_kind = {bus.board: bus for _, bus in reversed(found) if bus.kind == found[0][1].kind}
    if not of_kind:
        return [(kind_at(port), None)]
    return [(bus_kind(bus.kind), bus) for _, bus in sorted(of_kind.items())]


def _noted(port: str) -> Iterator[tuple[int, BusSettings]]:
    """Yield (time noted in ns, settings) of the buses driven at a port since it was plugged in."""
    plug = _plug(port)
    if plug is None:
        return
    for folder in searched_folders():
        for path in folder.glob(f"{_name(port)}@*{_SUFFIX}"):
            # A ValidationError is a ValueError.
            with contextlib.suppress(OSError, ValueError, KeyError, TypeError, UnknownBusError):
                with path.open("rb") as file:
                    kept = json.loads(file.read(_LONGEST_BYTES))
                if kept["plug"] == plug:
                    settings = bus_kind(kept["bus"]["kind"]).settings
                    yield int(kept["noted_ns"]), settings.model_validate(kept["bus"])


def _name(port: str) -> str:
    """Return a port's part of a file name, without `@`, so that no port's name begins another's."""
    return name_in_path(os.path.realpath(port).replace("/", "_"))


def _plug(port: str) -> list[int] | None:
    """Return numbers that change when `port` is plugged in anew; None: there is no such port."""
    try:
        found = Path(port).stat()
    except OSError:
        return None
    return [found.st_ino, found.st_rdev, found.st_ctime_ns]
