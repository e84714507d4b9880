"""The Unix socket of a running face, by which it is stopped, started, commanded and queried.

The lowest control: it needs nothing of the speech side and works when that is dead. A stop is acted
on before anything is answered: `poll` receives all requests and puts the stops into the command
queue, the loop acts, and only then `answer` answers, stops first, status last. Requests in the
listening socket outlive the process that serves it. `firmware_bridge.process.control_client` is the
client.
"""

import contextlib
import json
import os
import select
import socket
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Self

from firmware_bridge.process.commands import END_WORD, CommandQueue, command_answer
from firmware_bridge.process.runtime_folder import ControlError, held_folder, inode_of, make_room
from firmware_bridge.stopping import Order, StopLevel, StopRequest

Describe = Callable[[Mapping[str, object]], Mapping[str, object]]

#: Bytes of a request: `status`, `watch`, a level of stop, or a command with up to fifty settings.
LONGEST_WORD: Final = 2048
#: Requests the descriptor of the shared memory in which the face writes what it does now.
WATCH_WORD: Final = "watch"
STATUS_WORD: Final = "status"
#: Clients connected at a time; a further one takes the place of the oldest
#: that waits for no stop, or, if all wait for one, of the oldest.
_MOST_CLIENTS: Final = 16
_ACCEPTED_AT_ONCE: Final = 4
#: Clients that connect while no process serves wait here.
_BACKLOG: Final = 128
#: The owner, and the group of the folder's face: docs/hardware.md, "As a service".
_MODE: Final = 0o660
_CREDENTIALS: Final = struct.Struct("3i")
#: What is received for a stop: a level alone, or with the end of the process.
_STOPS: Final = {
    **{level.value: (level, False) for level in StopLevel},
    **{f"{level.value} {END_WORD}": (level, True) for level in StopLevel},
}


@dataclass(eq=False, slots=True)
class _Client:
    """A connected client. end: our end of the connection.

    waits_for_end: whether the client requested a stop, and is sent the report of the stop's end.
    """

    end: socket.socket
    waits_for_end: bool = False

    def send(self, answer: Mapping[str, object]) -> None:
        """Send an answer as JSON without waiting; a client that does not read gets nothing."""
        with contextlib.suppress(OSError):
            self.end.send(json.dumps(answer).encode(), socket.MSG_NOSIGNAL)


class ControlSocket:
    """The face's end of its control socket, where clients stop and query it; a context manager.

    No method waits. Stops and orders go into its `CommandQueue`, where others may write as well. In
    each round of the loop: `poll`, act on the returned stop, `answer`. path: of its file.
    """

    def __init__(
        self,
        path: Path,
        about: Mapping[str, object] | None = None,
        commands: CommandQueue | None = None,
        describe: Describe = dict,
        watched_fd: int | None = None,
        listener_fd: int | None = None,
    ) -> None:
        """Listen at `path`, and remove that file at the exit.

        Raises ControlError where a face listens already, where a file exists that is no dead socket
        of ours, and where no socket can be made.

        Parameters
        ----------
        about : part of every answer, such as the face's name and port.
        commands : the queue for stops and orders; None: a new one.
        describe : makes the answer to `status` from the loop's status and `about`.
        watched_fd : descriptor of shared memory that `watch` hands out, to read only; None: none.
        listener_fd : of another process's socket that listens at `path`, which is served instead;
            its file stays at the exit.

        """
        self.path = path
        self._bound_inode: tuple[int, int] | None = None
        if listener_fd is None:
            # The kernel lists the socket as it is bound.
            self.path = path.parent.resolve() / path.name
            self._listener = _listener_at(self.path)
            self._bound_inode = inode_of(self.path)
        else:
            self._listener = socket.socket(fileno=listener_fd)
        self._listener.setblocking(False)
        self._about = {} if about is None else dict(about)
        self._commands = CommandQueue() if commands is None else commands
        self._describe = describe
        self._watched_fd = watched_fd
        self._clients: dict[int, _Client] = {}
        self._unanswered: list[tuple[_Client, str]] = []
        self._ready = select.poll()
        self._ready.register(self._listener.fileno(), select.POLLIN)

    def fileno(self) -> int:
        """Return the descriptor of the listening socket: readable when a client connects."""
        return self._listener.fileno()

    def filenos(self) -> list[int]:
        """Return the descriptors of the listening socket and of all connections."""
        return [self._listener.fileno(), *self._clients]

    def poll(self) -> StopRequest | None:
        """Receive the requests of all clients, without answering; return the furthest stop queued.

        Limp goes further than soft, soft further than freeze. None: no stop is queued.
        """
        for fd, _ in self._ready.poll(0):
            if fd == self._listener.fileno():
                self._accept()
            elif client := self._clients.get(fd):  # it may have made room for another just now
                self._receive(client)
        return self._commands.take_stop()

    def answer(
        self,
        status: Callable[[], Mapping[str, object]],
        of_stop: Callable[[], Mapping[str, object]] = dict,
    ) -> None:
        """Answer the requests that `poll` received, stops first.

        status: returns the face's status; called only if a client requests it. of_stop: returns
        what the answer to a stop says of the servos, after the stop was acted on.
        """
        waiting, self._unanswered = self._unanswered, []
        for client, word in sorted(waiting, key=lambda each: each[1] not in _STOPS):
            if self._clients.get(client.end.fileno()) is client:
                if word in _STOPS:
                    level, _ = _STOPS[word]
                    client.send({"accepted": level.value, **of_stop(), **self._about})
                else:
                    self._answer(client, word, status)

    def attend(self, refusal: Callable[[Order], str]) -> None:
        """Accept orders from now on.

        refusal: returns the reason why an order is refused, or an empty text to accept it.
        """
        self._commands.attend(refusal)

    def take_orders(self) -> list[Order]:
        """Return and remove the orders queued since the last call, oldest first."""
        return self._commands.take_orders()

    def send_away(self) -> None:
        """Drop all clients but those that wait for the end of a stop.

        Call it once another process serves the socket: clients then connect to that process.
        """
        for client in [each for each in self._clients.values() if not each.waits_for_end]:
            self._drop(client)

    def report_end(self, report: Mapping[str, object]) -> None:
        """Send `report` to all clients that requested a stop, as its end, and drop all clients."""
        for client in list(self._clients.values()):
            if client.waits_for_end:
                client.send({"ended": True, **self._about, **report})
            self._drop(client)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        for client in list(self._clients.values()):
            self._drop(client)
        self._listener.close()
        if self._bound_inode is not None and self._bound_inode == inode_of(self.path):
            self.path.unlink(missing_ok=True)

    def _accept(self) -> None:
        """Accept up to four waiting clients, and receive what they have sent already.

        Where all 16 places are taken, the oldest client is dropped; clients that wait for the end
        of a stop are dropped last.
        """
        for _ in range(_ACCEPTED_AT_ONCE):
            try:
                end, _ = self._listener.accept()
            except OSError:
                return
            end.setblocking(False)
            if len(self._clients) == _MOST_CLIENTS:
                idle = [each for each in self._clients.values() if not each.waits_for_end]
                self._drop((idle or list(self._clients.values()))[0])
            client = self._clients[end.fileno()] = _Client(end)
            self._ready.register(end.fileno(), select.POLLIN)
            self._receive(client)  # most have sent their word with the connection

    def _receive(self, client: _Client) -> None:
        """Read one request (word) of a client; queue a stop at once, and store it for `answer`.

        A client that has closed its connection, or sends nothing but spaces, is dropped.
        """
        try:
            raw = client.end.recv(LONGEST_WORD + 1)
        except BlockingIOError:
            return
        except OSError:
            raw = b""
        word = raw.decode("utf-8", "replace").strip()
        if word in _STOPS:
            level, ends = _STOPS[word]
            client.waits_for_end = True
            self._commands.stop(level, _peer_words(client.end), ends=ends)
        if not word:
            self._drop(client)
        else:  # a word that was too long is cut off, perhaps within a number: it is refused
            too_long = len(raw) > LONGEST_WORD
            self._unanswered.append((client, "" if too_long else word))

    def _answer(
        self, client: _Client, word: str, status: Callable[[], Mapping[str, object]]
    ) -> None:
        """Answer one word of a client that is no stop: status, watch, or a command.

        status: returns the face's status. An empty word stands for one that was too long.
        """
        if not word:
            client.send({"error": f"longer than {LONGEST_WORD} bytes"})
        elif word == STATUS_WORD:
            client.send(self._status(status))
        elif word == WATCH_WORD:
            self._hand_out(client)
        elif answer := command_answer(word, self._commands, partial(_peer_words, client.end)):
            client.send(answer if "error" in answer else {**answer, **self._about})
        else:
            client.send({"error": f"{word[:40]!r} is not known here"})

    def _status(self, status: Callable[[], Mapping[str, object]]) -> Mapping[str, object]:
        """Return the answer to `status`; an error in making it is reported in it, not raised."""
        try:
            return self._describe({**status(), **self._about})
        except Exception as error:
            why = f"the status cannot be made: {type(error).__name__}: {error}"
            return {**self._about, "state": "unknown", "error": " ".join(why.split())}

    def _hand_out(self, client: _Client) -> None:
        """Send the client a read-only descriptor of the watched memory, or an error without one."""
        if self._watched_fd is None:
            client.send({"error": "this face cannot be watched"})
            return
        answer = json.dumps({"watching": True, **self._about}).encode()
        memory = Path(f"/proc/self/fd/{self._watched_fd}")
        with contextlib.suppress(OSError), memory.open("rb", buffering=0) as to_read:
            socket.send_fds(client.end, [answer], [to_read.fileno()], socket.MSG_NOSIGNAL)

    def _drop(self, client: _Client) -> None:
        fd = client.end.fileno()
        del self._clients[fd]
        self._ready.unregister(fd)
        client.end.close()


def _listener_at(path: Path) -> socket.socket:
    """Return a socket that listens at `path`. Raises ControlError."""
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
    return listener


def peer(end: socket.socket) -> tuple[int, int]:
    """Return the process id and user id of the other end of a Unix socket, from the kernel."""
    raw = end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, uid, _ = _CREDENTIALS.unpack(raw)
    return pid, uid


def _peer_words(end: socket.socket) -> str:
    """Return process and user at the other end of a socket for a log, by number.

    Looking up names may take seconds.
    """
    pid, uid = peer(end)
    return f"process {pid} of user {uid}"
