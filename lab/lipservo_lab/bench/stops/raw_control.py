"""A client of a face's control socket that uses nothing of ours: bytes, and the clock.

The campaign judges the program from outside, so its own client must not change with it.
"""

import contextlib
import json
import socket
import time
from pathlib import Path
from typing import Any, Final

_LONGEST_ANSWER: Final = 1 << 18
_RETRY_S: Final = 0.05

Answer = dict[str, Any]


def request(path: Path, word: str, timeout_s: float) -> Answer:
    """Send a request to a control socket; return the answer.

    It is sent again where the connection ends without an answer. Raises OSError where no answer
    comes within `timeout_s`.
    """
    return _send_until_answered(path, word, timeout_s, waits_for_end=False)[0]


def request_stop(path: Path, word: str, timeout_s: float) -> tuple[Answer, Answer | None]:
    """Send a stop until it is answered; return the answer, and the report of its end, or None.

    word: the level of the stop. A stop that was answered is never sent again. None: the report did
    not come in time. Raises OSError where no answer comes within `timeout_s`.
    """
    return _send_until_answered(path, word, timeout_s, waits_for_end=True)


def _send_until_answered(
    path: Path, word: str, timeout_s: float, *, waits_for_end: bool
) -> tuple[Answer, Answer | None]:
    """Send a request until it is answered; return the answer and, if waited for, the end's report.

    The report is None where the connection ends, or time is over, before it comes. Raises OSError
    where no answer comes in time.
    """
    give_up_s = time.monotonic() + timeout_s
    while True:
        with contextlib.suppress(ConnectionError), connected(path, give_up_s) as client:
            client.send(word.encode())
            if answer := receive(client, give_up_s):
                with contextlib.suppress(OSError):
                    return answer, receive(client, give_up_s) if waits_for_end else None
                return answer, None
        if time.monotonic() + _RETRY_S > give_up_s:
            raise TimeoutError(f"{path}: no answer to {word!r} within {timeout_s:g} s")
        time.sleep(_RETRY_S)


def connected(path: Path, give_up_s: float) -> socket.socket:
    """Connect to a control socket; give up at monotonic `give_up_s`.

    Raises OSError: ConnectionError where another try may succeed.
    """
    client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    client.settimeout(max(0.001, give_up_s - time.monotonic()))
    try:
        client.connect(str(path))
    except BlockingIOError as error:
        client.close()
        raise ConnectionRefusedError("too many wait there") from error
    except OSError:
        client.close()
        raise
    return client


def receive(client: socket.socket, give_up_s: float) -> Answer | None:
    """Return the next message; None where the other end has closed. Raises TimeoutError."""
    client.settimeout(max(0.001, give_up_s - time.monotonic()))
    raw = client.recv(_LONGEST_ANSWER)
    return dict(json.loads(raw)) if raw else None
