"""Which buses faces have driven at a port, for a process that lets go of them after a crash.

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

from pydantic import ValidationError

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
    """Remember what is driven at its port; where nothing can be written, nothing is."""
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
    """What was driven there since it was plugged in; else what the plug says of itself.

    Several where boards share the port, all of the kind that was driven last. Settings: None: not
    known. Where nothing says anything, it is the kind of `AT_A_PORT`.
    """
    found = sorted(_noted(port), key=lambda each: each[0], reverse=True)
    of_kind = {bus.board: bus for _, bus in reversed(found) if bus.kind == found[0][1].kind}
    if not of_kind:
        return [(kind_at(port), None)]
    return [(bus_kind(bus.kind), bus) for _, bus in sorted(of_kind.items())]


def _noted(port: str) -> Iterator[tuple[int, BusSettings]]:
    """What was driven there since it was plugged in, and when that was noted."""
    plug = _plug(port)
    if plug is None:
        return
    for folder in searched_folders():
        for path in folder.glob(f"{_name(port)}@*{_SUFFIX}"):
            with contextlib.suppress(
                OSError, ValueError, KeyError, TypeError, UnknownBusError, ValidationError
            ):
                with path.open("rb") as file:
                    kept = json.loads(file.read(_LONGEST_BYTES))
                if kept["plug"] == plug:
                    settings = bus_kind(kept["bus"]["kind"]).settings
                    yield int(kept["noted_ns"]), settings.model_validate(kept["bus"])


def _name(port: str) -> str:
    """No `@` is in it, so that one port's name never begins another's file."""
    return name_in_path(os.path.realpath(port).replace("/", "_"))


def _plug(port: str) -> list[int] | None:
    """What is another after the plug was out; None: the port is gone."""
    try:
        found = Path(port).stat()
    except OSError:
        return None
    return [found.st_ino, found.st_rdev, found.st_ctime_ns]
