"""What a face answers to a stop that was sent to its control socket, awaited in an event loop.

The agent server and the dashboard's server send a stop themselves, at once
(`firmware_bridge.process.control_client.send_stop`); here is what comes after.
"""

import asyncio
import json
import socket
from collections.abc import Callable
from typing import Any, Final

#: A supervisor notices a hung bridge within a second and answers in its place.
_ANSWER_S: Final = 2.0
#: A face whose process was replaced in between is sent the stop again after this.
_RETRY_S: Final = 0.05
#: Longer than the report of 252 servos.
_LONGEST_ANSWER: Final = 1 << 18

Answer = dict[str, Any]


async def stop_answer(
    sent: socket.socket | None, send: Callable[[], socket.socket], wait_s: float = 0.0
) -> tuple[Answer, Answer | None]:
    """Wait for the answer to a stop, and for the report of the end.

    Parameters
    ----------
    sent : the connection on which the stop went out; None: too many clients waited there.
    send : sends it again, as `send_stop`, where the face's process was replaced.
    wait_s : so long for the report; 0: not at all.

    Returns
    -------
    The answer, and what the servos confirmed (`StopReport`); None where no report came in time, as
    of a freeze, which has no end.

    Raises
    ------
    TimeoutError
        Where no answer comes: the face hangs.
    OSError
        Where no face listens there.

    """
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    answer_by_s, report_by_s = began_s + _ANSWER_S, began_s + wait_s
    first: Answer | None = None
    while True:
        try:
            connection, sent = sent or send(), None
            with connection:
                answer = await _received(connection, answer_by_s if first is None else report_by_s)
                first = first or answer
                if first is not None and not (wait_s and _has_an_end(first)):
                    return first, None
                report = await _received(connection, report_by_s) if answer else None
            if first is not None and report is not None:
                return first, report
        except BlockingIOError:  # so many clients wait there that the kernel takes no more
            pass
        except OSError:
            if first is None:
                raise
            return first, None
        if loop.time() + _RETRY_S > (answer_by_s if first is None else report_by_s):
            if first is None:
                raise TimeoutError("no answer")
            return first, None
        await asyncio.sleep(_RETRY_S)


def _has_an_end(answer: Answer) -> bool:
    """A face that freezes goes on, held; one that refuses goes on as before."""
    return answer.get("accepted") in ("soft", "limp")


async def _received(connection: socket.socket, by_s: float) -> Answer | None:
    """The next message; None: the other end has hung up. Raises TimeoutError."""
    loop = asyncio.get_running_loop()
    try:
        async with asyncio.timeout_at(by_s):
            raw = await loop.sock_recv(connection, _LONGEST_ANSWER)
    except ConnectionError:
        return None
    return dict(json.loads(raw)) if raw else None
