"""How a running face is told to stop, and asked how it is: a socket of its own.

The lowest control: it needs nothing of the speech side and works when that is dead. The socket
listens, so that an answer reaches whoever may connect, and what waits in it outlives the process
that serves it. `firmware_bridge.process.control_client` is the other end.
"""

import contextlib
import errno
import fcntl
import json
import os
import pwd
import select
import socket
import stat
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final, Self

from firmware_bridge.process.command_queue import CommandError, CommandQueue
from firmware_bridge.process.runtime_folder import ControlError
from firmware_bridge.stopping import StopLevel

#: `status`, a level of stop, or `set NAME VALUE`; bytes.
LONGEST_WORD: Final = 128
#: The first word of a change of a setting.
SET_WORD: Final = "set"
#: People who wait for a stop, and some who ask; the oldest of these makes room.
_MOST_CLIENTS: Final = 16
_ACCEPTED_AT_ONCE: Final = 4
#: Who connects while nobody serves waits here.
_BACKLOG: Final = 128
#: A folder is held by others for as long as a socket is made in it.
_FOLDER_PATIENCE_S: Final = 1.0
#: The owner, and the group of the folder's face: docs/hardware.md, "As a service".
_MODE: Final = 0o660
_CREDENTIALS: Final = struct.Struct("3i")


class _Client:
    """Somebody connected; asked_to_stop: waits for the report of the end."""

    def __init__(self, end: socket.socket) -> None:
        self.end = end
        self.asked_to_stop = False

    def send(self, answer: Mapping[str, object]) -> None:
        """Without waiting: who does not read gets nothing."""
        with contextlib.suppress(OSError):
            self.end.send(json.dumps(answer).encode(), socket.MSG_NOSIGNAL)


class ControlSocket:
    """The face's end. Use it as a context manager; `poll` never waits.

    What it hears goes into its `CommandQueue`, where others may write as well.
    """

    def __init__(
        self,
        listener: socket.socket,
        path: Path,
        about: Mapping[str, object] | None = None,
        commands: CommandQueue | None = None,
        describe: Callable[[Mapping[str, object]], Mapping[str, object]] = dict,
    ) -> None:
        """Use `bind` or `adopt`.

        about: what every answer says besides, such as the face's name and port. describe: makes
        the answer to `status` of what the loop knows and of `about`.
        """
        self._listener = listener
        self._listener.setblocking(False)
        self._path = path
        self._about = {} if about is None else dict(about)
        self._commands = CommandQueue() if commands is None else commands
        self._describe = describe
        self._clients: dict[int, _Client] = {}
        self._ready = select.poll()
        self._ready.register(listener.fileno(), select.POLLIN)
        self._bound_inode: tuple[int, int] | None = None
        self.asked_by = ""  # who asked for the last stop, for a log

    @classmethod
    def bind(
        cls,
        path: Path,
        about: Mapping[str, object] | None = None,
        commands: CommandQueue | None = None,
        describe: Callable[[Mapping[str, object]], Mapping[str, object]] = dict,
    ) -> Self:
        """Listen at `path`, and remove it in the end.

        Raises ControlError where a face listens already, where something else lies that is no dead
        socket of ours, and where no socket can be.
        """
        path = path.parent.resolve() / path.name  # the kernel lists it as it is bound
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            with held_folder(path.parent):
                _make_room(path)
                os.fchmod(listener.fileno(), 0o600)  # Linux gives the file this mode: no gap
                listener.bind(str(path))
                listener.listen(_BACKLOG)
                path.chmod(_MODE)
        except OSError as error:
            listener.close()
            why = error.strerror or str(error)
            raise ControlError(f"{path}: cannot listen there: {why}") from error
        except ControlError:
            listener.close()
            raise
        control = cls(listener, path, about, commands, describe)
        control._bound_inode = _inode(path)
        return control

    @classmethod
    def adopt(
        cls,
        fd: int,
        path: Path,
        about: Mapping[str, object] | None = None,
        commands: CommandQueue | None = None,
        describe: Callable[[Mapping[str, object]], Mapping[str, object]] = dict,
    ) -> Self:
        """Serve a listening socket that another process made; its file is left to that process."""
        return cls(socket.socket(fileno=fd), path, about, commands, describe)

    @property
    def path(self) -> Path:
        """Where it listens."""
        return self._path

    def fileno(self) -> int:
        """The listening socket: readable when somebody comes."""
        return self._listener.fileno()

    def filenos(self) -> list[int]:
        """All that may become readable: the listening socket, and who is connected."""
        return [self._listener.fileno(), *self._clients]

    def poll(self, status: Callable[[], Mapping[str, object]]) -> StopLevel | None:
        """Answer what has come; the next stop of the queue, if any. status: made when asked."""
        for fd, _ in self._ready.poll(0):
            if fd == self._listener.fileno():
                self._accept()
                continue
            client = self._clients.get(fd)  # it may have made room for somebody just now
            if client is not None:
                self._hear(client, status)
        request = self._commands.take_stop()
        if request is None:
            return None
        self.asked_by = request.asked_by
        return request.level

    def report_end(self, report: Mapping[str, object]) -> None:
        """Say to everybody who asked for a stop how it ended: who confirmed to be limp."""
        for client in list(self._clients.values()):
            if client.asked_to_stop:
                client.send({"ended": True, **self._about, **report})
            self._drop(client)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        for client in list(self._clients.values()):
            self._drop(client)
        self._listener.close()
        if self._bound_inode is not None and self._bound_inode == _inode(self._path):
            self._path.unlink(missing_ok=True)

    def _accept(self) -> None:
        for _ in range(_ACCEPTED_AT_ONCE):
            try:
                end, _ = self._listener.accept()
            except OSError:
                return
            end.setblocking(False)
            if len(self._clients) == _MOST_CLIENTS:
                idle = [each for each in self._clients.values() if not each.asked_to_stop]
                self._drop((idle or list(self._clients.values()))[0])
            self._clients[end.fileno()] = _Client(end)
            self._ready.register(end.fileno(), select.POLLIN)

    def _hear(self, client: _Client, status: Callable[[], Mapping[str, object]]) -> None:
        try:
            word = client.end.recv(LONGEST_WORD).decode("utf-8", "replace").strip()
        except BlockingIOError:
            return
        except OSError:
            word = ""
        if not word:
            self._drop(client)
        elif word == "status":
            client.send(self._describe({**status(), **self._about}))
        elif word in set(StopLevel):
            client.asked_to_stop = True
            client.send({"accepted": word, **self._describe({**status(), **self._about})})
            self._commands.stop(StopLevel(word), _named_peer(client.end))
        elif word.split()[0] == SET_WORD:
            client.send(self._changed(word.split()[1:]))
        else:
            client.send({"error": f"{word!r} is not known here"})

    def _changed(self, words: list[str]) -> dict[str, object]:
        """The answer to `set NAME VALUE`."""
        try:
            name, value = words[0], float(words[1])
            self._commands.change(name, value)
        except (IndexError, CommandError) as error:
            text = str(error) if isinstance(error, CommandError) else "say: set NAME VALUE"
            return {"error": text}
        except ValueError:
            return {"error": f"{words[1]!r} is not a number"}
        return {"set": name, "value": value, **self._about}

    def _drop(self, client: _Client) -> None:
        fd = client.end.fileno()
        del self._clients[fd]
        self._ready.unregister(fd)
        client.end.close()


@contextlib.contextmanager
def held_folder(folder: Path) -> Iterator[None]:
    """Nobody else makes or removes a socket in the folder meanwhile.

    Raises ControlError where it cannot be opened, or others hold it for a second.
    """
    give_up_s = time.monotonic() + _FOLDER_PATIENCE_S
    try:
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise ControlError(f"{folder}: cannot be used: {error.strerror}") from error
    try:
        while True:
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > give_up_s:
                    raise ControlError(f"{folder}: is held by another program") from None
                time.sleep(0.01)
        yield
    finally:
        os.close(fd)


def knock(path: Path) -> int:
    """Connect and hang up again: 0 when somebody listens, else the number of the error."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.setblocking(False)
        try:
            refused = probe.connect_ex(str(path))
        except OSError:  # longer than a socket's address may be
            return errno.ENAMETOOLONG
    return 0 if refused == errno.EAGAIN else refused  # so many wait there already


def is_dead_socket(path: Path) -> bool:
    """Whether a socket lies there that nobody listens on any more, and it is ours to remove."""
    try:
        found = path.lstat()
    except OSError:
        return False
    is_ours = os.geteuid() in (0, found.st_uid)
    return stat.S_ISSOCK(found.st_mode) and is_ours and knock(path) == errno.ECONNREFUSED


def _make_room(path: Path) -> None:
    if not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise ControlError(f"{path}: is no socket and stays as it is; choose another --control")
    if not is_dead_socket(path):
        raise ControlError(f"{path}: a face listens there already; stop it, or choose another")
    path.unlink()


def _inode(path: Path) -> tuple[int, int] | None:
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def peer(end: socket.socket) -> tuple[int, int]:
    """Process and user at the other end, as the kernel knows them."""
    raw = end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, uid, _ = _CREDENTIALS.unpack(raw)
    return pid, uid


def _named_peer(end: socket.socket) -> str:
    pid, uid = peer(end)
    try:
        user = pwd.getpwuid(uid).pw_name
    except KeyError:
        user = str(uid)
    return f"process {pid} of user {user}"
