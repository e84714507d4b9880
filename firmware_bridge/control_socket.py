"""How a running bridge is told to stop, and asked how it is: a socket of its own.

It needs nothing of the speech side and so works when that is dead.
"""

import contextlib
import json
import os
import socket
import tempfile
from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Final

_LONGEST: Final = 8_192
_PATIENCE_S: Final = 5.0


class StopLevel(StrEnum):
    """How a face comes to its end."""

    SOFT = "soft"  # ease to neutral, then let go
    FREEZE = "freeze"  # stay, held, until another level is asked for
    LIMP = "limp"  # let go now


def default_path() -> Path:
    """Where the bridge of this user listens: one bridge a user, unless told otherwise."""
    folder = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(folder) / f"lipservo-{os.getuid()}.sock"


class ControlSocket:
    """The bridge's end. Use it as a context manager; `poll` never waits."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def poll(self, status: Callable[[], Mapping[str, object]]) -> StopLevel | None:
        """Answer what has come; the stop that was asked for, if any. status: made when asked."""
        try:
            request, sender = self._socket.recvfrom(_LONGEST)
        except OSError:
            return None
        word = request.decode("utf-8", "replace").strip()
        stop = StopLevel(word) if word in set(StopLevel) else None
        if sender:
            answer = status() if stop or word == "status" else {"error": f"{word!r} is not known"}
            with contextlib.suppress(OSError):
                self._socket.sendto(json.dumps(answer).encode(), sender)
        return stop

    def __enter__(self) -> "ControlSocket":
        self._path.unlink(missing_ok=True)
        self._socket.bind(str(self._path))
        self._path.chmod(0o600)
        return self

    def __exit__(self, *exc: object) -> None:
        self._socket.close()
        self._path.unlink(missing_ok=True)


def ask(path: Path, word: str, patience_s: float = _PATIENCE_S) -> dict[str, object]:
    """Send one word to the bridge at `path`; its answer. Raises OSError when nobody answers."""
    with tempfile.TemporaryDirectory() as folder:
        own = Path(folder) / "answer.sock"
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
            client.bind(str(own))
            client.settimeout(patience_s)
            client.sendto(word.encode(), str(path))
            answer = json.loads(client.recv(_LONGEST))
    return dict(answer)
