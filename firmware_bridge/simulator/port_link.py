"""A path that always leads to a simulated port, as /dev/serial/by-id does to a real one."""

import contextlib
import os
import secrets
from pathlib import Path
from typing import Final

from firmware_bridge.bus import PortError

_TERMINALS: Final = Path("/dev/pts")


class PortLink:
    """A symbolic link of ours. Whatever is somebody else's stays as it is."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._port = ""

    def lead_to(self, port: str) -> None:
        """Let the path lead to `port`.

        Taken over is a link of ours, or one to a pseudo-terminal that is no more, as a simulator
        that was killed leaves behind. Raises PortError for anything else, and where no link can
        be made.
        """
        if not self._path.name:
            raise PortError(f"--link {self._path}: is a folder, not the name of a link")
        if not self._may_take(port):
            raise PortError(
                f"--link {self._path}: something is there already, which is left alone; "
                "remove it or give another path"
            )
        # Beside it under a name that nobody has, then in one step to its place.
        fresh = self._path.with_name(f"{self._path.name}.{secrets.token_hex(8)}")
        try:
            fresh.symlink_to(port)
            try:
                fresh.replace(self._path)
            except OSError:
                fresh.unlink()
                raise
        except OSError as error:
            raise PortError(
                f"--link {self._path}: no link can be made there: {error.strerror}"
            ) from error
        self._port = port

    def remove(self) -> None:
        """Take the link away, if it still leads to our port."""
        if self._port and self._target() == self._port:
            with contextlib.suppress(OSError):
                self._path.unlink()
        self._port = ""

    def _may_take(self, port: str) -> bool:
        target = self._target()
        if target is None:
            return not os.path.lexists(self._path)
        if target in (port, self._port):
            return True
        return Path(target).parent == _TERMINALS and not os.path.lexists(target)

    def _target(self) -> str | None:
        """Where the link leads; None where there is none."""
        try:
            return os.readlink(self._path)
        except (OSError, ValueError):
            return None
