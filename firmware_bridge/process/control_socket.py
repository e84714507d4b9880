"""How a running face is told to stop, and asked how it is: a socket of its own.

The lowest control: it needs nothing of the speech side and works when that is dead. The socket
listens, so that an answer reaches whoever may connect, and what waits in it outlives the process
that serves it. `firmware_bridge.process.control_client` is the other end.
"""

import contextlib
import json
import os
import pwd
import select
import socket
import struct
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Final, Self

from firmware_bridge.orders import Order
from firmware_bridge.process.command_queue import CommandQueue
from firmware_bridge.process.command_words import command_answer
from firmware_bridge.process.runtime_folder import ControlError
from firmware_bridge.process.socket_files import held_folder, inode_of, make_room
from firmware_bridge.stopping import StopLevel

#: `status`, `watch`, a level of stop, or a command; bytes. Fifty settings can be set at once.
LONGEST_WORD: Final = 2048
#: Asks for the memory in which the face tells what it does at this moment.
WATCH_WORD: Final = "watch"
#: People who wait for a stop, and some who ask; the oldest of these makes room.
_MOST_CLIENTS: Final = 16
_ACCEPTED_AT_ONCE: Final = 4
#: Who connects while nobody serves waits here.
_BACKLOG: Final = 128
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
        #: What `watch` hands out, to read only: a descriptor of shared memory; None: nothing.
        self.watched_fd: int | None = None
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
                make_room(path)
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
        control._bound_inode = inode_of(path)
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

    def attend(self, refusal: Callable[[Order], str]) -> None:
        """From now on orders to single servos are taken: as `CommandQueue.attend`."""
        self._commands.attend(refusal)

    def take_orders(self) -> list[Order]:
        """The orders of the queue since the last call."""
        return self._commands.take_orders()

    def send_away(self) -> None:
        """Let go of everybody who waits for no stop: another process serves, and they ask again."""
        for client in [each for each in self._clients.values() if not each.asked_to_stop]:
            self._drop(client)

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
        if self._bound_inode is not None and self._bound_inode == inode_of(self._path):
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
            raw = client.end.recv(LONGEST_WORD + 1)
            word = raw.decode("utf-8", "replace").strip()
        except BlockingIOError:
            return
        except OSError:
            raw, word = b"", ""
        if not word:
            self._drop(client)
        elif len(raw) > LONGEST_WORD:  # cut off, so that its last number may be another
            client.send({"error": f"longer than {LONGEST_WORD} bytes"})
        elif word == "status":
            client.send(self._describe({**status(), **self._about}))
        elif word == WATCH_WORD:
            self._hand_out(client)
        elif word in set(StopLevel):
            client.asked_to_stop = True
            client.send({"accepted": word, **self._describe({**status(), **self._about})})
            self._commands.stop(StopLevel(word), _named_peer(client.end))
        elif answer := command_answer(word, self._commands, partial(_numbered_peer, client.end)):
            client.send(answer if "error" in answer else {**answer, **self._about})
        else:
            client.send({"error": f"{word[:40]!r} is not known here"})

    def _hand_out(self, client: _Client) -> None:
        """Let somebody watch: the memory itself, which they cannot write."""
        if self.watched_fd is None:
            client.send({"error": "this face cannot be watched"})
            return
        answer = json.dumps({"watching": True, **self._about}).encode()
        with contextlib.suppress(OSError):
            to_read = os.open(f"/proc/self/fd/{self.watched_fd}", os.O_RDONLY | os.O_CLOEXEC)
            try:
                socket.send_fds(client.end, [answer], [to_read], socket.MSG_NOSIGNAL)
            finally:
                os.close(to_read)

    def _drop(self, client: _Client) -> None:
        fd = client.end.fileno()
        del self._clients[fd]
        self._ready.unregister(fd)
        client.end.close()


def peer(end: socket.socket) -> tuple[int, int]:
    """Process and user at the other end, as the kernel knows them."""
    raw = end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, uid, _ = _CREDENTIALS.unpack(raw)
    return pid, uid


def _numbered_peer(end: socket.socket) -> str:
    """As `_named_peer`, without looking a name up while servos are driven."""
    pid, uid = peer(end)
    return f"process {pid} of user {uid}"


def _named_peer(end: socket.socket) -> str:
    pid, uid = peer(end)
    try:
        user = pwd.getpwuid(uid).pw_name
    except KeyError:
        user = str(uid)
    return f"process {pid} of user {user}"
