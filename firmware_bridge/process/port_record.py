"""Which kind of bus a face has driven at a port, for whoever lets go of it when the face is dead.

A file beside the control sockets, written before the port is opened: nothing of one kind of servo
may be written to another.
"""

import contextlib
import json
import os
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
    content = {"plug": _plug(settings.port), "bus": settings.model_dump()}
    with contextlib.suppress(OSError, ControlError):
        path = runtime_folder() / _name(settings.port)
        coming = path.with_name(f".{path.name}.{os.getpid()}")
        coming.write_text(json.dumps(content))
        coming.replace(path)


def bus_at(port: str) -> tuple[BusKind, BusSettings | None]:
    """What was driven there since it was plugged in; else what the plug says of itself.

    Settings: None: not known. Where nothing says anything, it is the kind of `AT_A_PORT`.
    """
    plug = _plug(port)
    for folder in searched_folders():
        with contextlib.suppress(
            OSError, ValueError, KeyError, TypeError, UnknownBusError, ValidationError
        ):
            with (folder / _name(port)).open("rb") as file:
                kept = json.loads(file.read(_LONGEST_BYTES))
            if plug is not None and kept["plug"] == plug:
                kind = bus_kind(kept["bus"]["kind"])
                return kind, kind.settings.model_validate(kept["bus"])
    return kind_at(port), None


def _name(port: str) -> str:
    return name_in_path(os.path.realpath(port).replace("/", "_")) + _SUFFIX


def _plug(port: str) -> list[int] | None:
    """What is another after the plug was out; None: the port is gone."""
    try:
        found = Path(port).stat()
    except OSError:
        return None
    return [found.st_ino, found.st_rdev, found.st_ctime_ns]
