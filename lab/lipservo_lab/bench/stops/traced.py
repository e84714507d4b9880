"""Writes down which functions of ours a stop passes: copied as `sitecustomize.py`, as troubles are.

While the file `trace` lies in the folder that `LIPSERVO_BENCH_FOLDER` names, the calls of every
thread are examined. A walk begins in a server with the first function of ours that gets the request
among its arguments, known by `MARKER` in it; in the process that owns the control socket with the
function of ours that receives a level of stop. It goes on in whatever that context calls, starts as
a task, or gives to a thread of an executor. It ends in a server where a function of ours sends on a
Unix socket; in the owner where `CommandQueue.stop` is called, which counts. Each walk becomes a
file, `walk.PID.N.json`.

Where a stop has come to the queue, what that process does in the tick in which it takes it up is a
walk of its own, `register.PID.N.json`: from the end of a clock's `sleep_until` in the thread of the
loop to the write whose bytes clear a servo's register of torque.

A call is an entry into a function of ours, a coroutine's or generator's resumption included; what
libraries do between is not counted, nor what only waits for the answer afterwards.
"""

import contextvars
import itertools
import json
import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from types import FrameType
from typing import Any

FOLDER_VARIABLE = "LIPSERVO_BENCH_FOLDER"
ROOT_VARIABLE = "LIPSERVO_TRACED_ROOT"
FLAG = "trace"
MARKER = "stop-path-marker"
PACKAGES = ("calibration", "client", "firmware_bridge", "lipservo", "lipsync")
QUEUE = "CommandQueue.stop"
_LEVELS = (b"soft", b"freeze", b"limp")
_ROLES = ("bridge-process", "speech-process", "dashboard")
_LOOK_S = 0.02
_SENDS = ("send", "sendall", "sendmsg")
_MOST_LOOKED_AT = 64
_DEEPEST = 4
#: https://emanual.robotis.com/docs/en/dxl/protocol2: write and sync write, to torque enable (64).
_WRITE, _SYNC_WRITE = 0x03, 0x83
_TORQUE_ENABLE = b"\x40\x00"


@dataclass(eq=False, slots=True, kw_only=True)
class Walk:
    """The functions that one stop passes in one process.

    calls: (file, function), in their order. at_owner: it is of the process that owns the control
    socket; there a sending on a socket is an answer and does not end the walk.
    """

    calls: list[tuple[str, str]] = field(default_factory=list)
    at_owner: bool = False
    is_over: bool = False


class StopTracer:
    """Finds the walks of stops among all calls of a process; see the module's docstring."""

    def __init__(
        self, root: str, write: Callable[[Walk], None], write_register: Callable[[Walk], None]
    ) -> None:
        """root: the folder of our packages. write: called with each walk at its end.

        write_register: called with the walk from a tick's beginning to the torque register.
        """
        self._prefixes = tuple(os.path.join(root, each) + os.sep for each in PACKAGES)
        self._root = os.path.join(root, "")
        self._write = write
        self._write_register = write_register
        #: What each thread passed since its last wait.
        self._ticks = threading.local()
        self._is_queued = False
        self._walk: contextvars.ContextVar[Walk | None] = contextvars.ContextVar(
            "walk", default=None
        )
        self.is_on = False

    def look(self, flag: str) -> None:
        """Switch tracing on or off: it is on while the file `flag` exists."""
        self.is_on = os.path.exists(flag)

    def profile(self, frame: FrameType, event: str, arg: Any) -> None:
        """Record a call, for `sys.setprofile` and `threading.setprofile`."""
        if not self.is_on or event not in ("call", "c_call"):
            return
        if not self._is_ours(frame):
            return
        walk = self._walk.get()
        if event == "c_call":
            if walk is not None and not (walk.is_over or walk.at_owner) and _is_unix_send(arg):
                self._end(walk)
            return
        self._follow_tick(frame)
        if walk is None:
            if not has_marker(_arguments(frame)):
                return
            walk = Walk()
            self._walk.set(walk)
        if not walk.is_over:
            self._add(walk, frame)

    def received(self, raw: bytes, frame: FrameType) -> None:
        """Begin a walk if the bytes that `frame` has just received from a socket are a stop."""
        level = raw.split(b" ")[0] if len(raw) < 16 else b""
        if self.is_on and level in _LEVELS and self._is_ours(frame):
            walk = Walk(at_owner=True)
            self._walk.set(walk)
            self._add(walk, frame)

    def submitted(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function given to an executor, wrapped to belong to the submitter's walk."""
        if self._walk.get() is None:
            return function
        return partial(contextvars.copy_context().run, function)

    def _add(self, walk: Walk, frame: FrameType) -> None:
        """Add a call to a walk; end the walk if the call is that of the command queue."""
        code = frame.f_code
        walk.calls.append((code.co_filename.removeprefix(self._root), code.co_qualname))
        if code.co_qualname == QUEUE:
            self._is_queued = True
            self._end(walk)

    def _follow_tick(self, frame: FrameType) -> None:
        """Add a call to its thread's walk of this tick; write the walk when torque is cleared.

        `sleep_until` begins a new walk. Only the first one after a stop was queued is written.
        """
        code = frame.f_code
        if code.co_name == "sleep_until":
            self._ticks.walk = Walk()
            return
        walk = getattr(self._ticks, "walk", None)
        if walk is None:
            return
        walk.calls.append((code.co_filename.removeprefix(self._root), code.co_qualname))
        if self._is_queued and any(clears_torque(each) for each in _arguments(frame)):
            self._is_queued = False
            self._write_register(walk)

    def _end(self, walk: Walk) -> None:
        walk.is_over = True
        self._walk.set(None)
        self._write(walk)

    def _is_ours(self, frame: FrameType) -> bool:
        return frame.f_code.co_filename.startswith(self._prefixes)


def clears_torque(value: Any) -> bool:
    """Return whether a value is a Dynamixel packet that writes 0 to the torque register."""
    if not isinstance(value, bytes | bytearray) or len(value) < 13:
        return False
    instruction, address = value[7], bytes(value[8:10])
    if address != _TORQUE_ENABLE or instruction not in (_WRITE, _SYNC_WRITE):
        return False
    return value[10 if instruction == _WRITE else 13] == 0


def has_marker(value: Any, depth: int = 0) -> bool:
    """Return whether `MARKER` is in a text, in bytes, or in containers of these.

    Containers are searched `_DEEPEST` levels deep, of each the first `_MOST_LOOKED_AT` parts.
    """
    if isinstance(value, str):
        return MARKER in value
    if isinstance(value, bytes | bytearray):
        return MARKER.encode() in value
    if depth >= _DEEPEST or not isinstance(value, dict | list | tuple):
        return False
    parts = itertools.chain(value, value.values()) if isinstance(value, dict) else value
    return any(has_marker(each, depth + 1) for each in itertools.islice(parts, _MOST_LOOKED_AT))


def _arguments(frame: FrameType) -> tuple[Any, ...]:
    code = frame.f_code
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    local_values = frame.f_locals
    return tuple(local_values[name] for name in names if name in local_values)


def _is_unix_send(function: Any) -> bool:
    end = getattr(function, "__self__", None)
    is_send = getattr(function, "__name__", "") in _SENDS
    return is_send and isinstance(end, socket.socket) and end.family == socket.AF_UNIX


def install(folder: str, root: str) -> None:
    """Trace this process's calls from now on, while the flag file exists in `folder`.

    Walks become files in `folder`. root: the folder of our packages.
    """
    numbers = itertools.count()
    role = next((each for each in _ROLES if each in sys.orig_argv), "daemon")

    def write(walk: Walk, kind: str = "walk") -> None:
        path = os.path.join(folder, f"{kind}.{os.getpid()}.{next(numbers)}.json")
        with open(f"{path}.coming", "w", encoding="utf-8") as file:
            json.dump({"role": role, "calls": walk.calls}, file)
        os.replace(f"{path}.coming", path)

    tracer = StopTracer(root, write, partial(write, kind="register"))
    plain_recv, plain_submit = socket.socket.recv, ThreadPoolExecutor.submit

    def recv(sock: socket.socket, *arguments: Any) -> bytes:
        raw = plain_recv(sock, *arguments)
        tracer.received(raw, sys._getframe(1))
        return raw

    def submit(
        executor: ThreadPoolExecutor, function: Callable[..., Any], /, *arguments: Any, **named: Any
    ) -> "Future[Any]":
        return plain_submit(executor, tracer.submitted(function), *arguments, **named)

    def watch() -> None:
        while True:
            tracer.look(os.path.join(folder, FLAG))
            time.sleep(_LOOK_S)

    socket.socket.recv = recv  # type: ignore[method-assign, assignment]
    ThreadPoolExecutor.submit = submit  # type: ignore[method-assign, assignment]
    threading.Thread(target=watch, name="trace", daemon=True).start()
    threading.setprofile(tracer.profile)
    sys.setprofile(tracer.profile)


if ROOT_VARIABLE in os.environ:
    install(os.environ[FOLDER_VARIABLE], os.environ[ROOT_VARIABLE])
