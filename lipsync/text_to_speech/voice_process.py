"""A voice in a child process: a crash, a hang or a memory leak costs one text, never the face.

The child answers each request, a line of JSON, with a line of JSON and bytes after it. It ends,
with all that it has started, when its standard input ends, so that nothing outlives the caller,
even one that crashed; the caller kills it, with all that it has started, when an answer is overdue.
"""

import atexit
import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from typing import IO, Any, Final

from lipsync.text_to_speech.synthesis import SynthesisError

#: An answer is overdue after so long: espeak-ng takes about two seconds for five minutes of speech.
LONGEST_S: Final = 30.0
#: A file of sound, or what a program prints: ten minutes at 48 kHz.
LARGEST_BYTES: Final = 64 * 2**20

Request = Mapping[str, Any]


class VoiceProcess:
    """A child process that answers requests one by one; a request starts it if it is not running.

    module: the module that it runs, which calls `serve`. failed: the error message for a text at
    which it crashes or hangs.
    """

    def __init__(self, module: str, failed: str) -> None:
        self._module = module
        self._failed = failed
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        atexit.register(self.close)

    @property
    def pid(self) -> int | None:
        """The id of the child process that was started last; None before the first start."""
        return None if self._child is None else self._child.pid

    def request(self, request: Request) -> tuple[dict[str, Any], bytes]:
        """Send a request to the child process; return its answer, and the bytes that follow it.

        Raises SynthesisError with the child's message, or with `failed` if it crashes or hangs.
        """
        with self._lock:
            if self._child is None or self._child.poll() is not None:
                self._child = self._start_child()
            killer = threading.Timer(LONGEST_S, _kill, [self._child])
            killer.daemon = True  # the face may end without waiting for it
            killer.start()
            try:
                answer, content = _exchange(self._child, request)
            except (OSError, ValueError):
                self.close()
                raise SynthesisError(self._failed) from None
            finally:
                killer.cancel()
        if "error" in answer:
            raise SynthesisError(str(answer["error"]))
        return answer, content

    def close(self) -> None:
        """Kill the child process and all that it has started; the next request starts it again."""
        if self._child is not None:
            _kill(self._child)
            self._child.communicate()

    def _start_child(self) -> "subprocess.Popen[bytes]":
        """Start the child process, in a session of its own, and return it without waiting."""
        # A session of its own: Ctrl-C is for the face.
        return subprocess.Popen(
            [sys.executable, "-P", "-m", self._module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )


def _kill(child: "subprocess.Popen[bytes]") -> None:
    """Kill the child process and its group, which are the processes that it has started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)


def _exchange(child: "subprocess.Popen[bytes]", request: Request) -> tuple[dict[str, Any], bytes]:
    """Send a request to the child process; return its answer and the bytes after it.

    Raises OSError or ValueError when the process ends before its answer is complete.
    """
    assert child.stdin is not None
    assert child.stdout is not None
    child.stdin.write(json.dumps(request).encode() + b"\n")
    child.stdin.flush()
    answer: dict[str, Any] = json.loads(child.stdout.readline())
    content = child.stdout.read(answer["n_bytes"])
    if len(content) < answer["n_bytes"]:
        raise ValueError("the voice's process broke off its answer")
    return answer, content


def serve(answered: Callable[[Request], tuple[dict[str, object], bytes]]) -> None:
    """Answer requests from standard input until its end; then end this process and its children.

    answered: returns for a request the answer, and bytes to be sent after it. The message of a
    SynthesisError that it raises is sent as the answer.
    """
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST_BYTES, LARGEST_BYTES))
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints is no answer
    requests: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_queue_lines, args=(sys.stdin.buffer, requests), daemon=True).start()
    while True:
        answer, content = _answer_or_error(answered, requests.get())
        answers.write(json.dumps({**answer, "n_bytes": len(content)}).encode() + b"\n" + content)
        answers.flush()


def _queue_lines(lines: IO[bytes], requests: "queue.Queue[bytes]") -> None:
    """Queue all lines; at their end kill this process and, if it leads a group, the group."""
    for line in lines:
        requests.put(line)
    if os.getpgrp() == os.getpid():
        os.killpg(0, signal.SIGKILL)
    os._exit(0)


def _answer_or_error(
    answered: Callable[[Request], tuple[dict[str, object], bytes]], line: bytes
) -> tuple[dict[str, object], bytes]:
    """Return what `answered` returns for the request in `line`, or its SynthesisError's message."""
    try:
        return answered(json.loads(line))
    except SynthesisError as error:
        return {"error": str(error)}, b""
