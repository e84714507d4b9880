"""One connection to `/control`: commands, each answered by a `result` or an `error` with its id.

This server is a client of the face's own control socket, so there is one command queue and one
status, and `lipservo stop` works even if this server fails. A stop is sent to that socket from the
event loop at once: it needs no thread, and no place among a client's eight pending commands. The
dashboard's server, too, awaits the answers to its stops with `stop_answer`.
"""

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from firmware_bridge.process.control_client import ask, change_setting, send_stop, start_face
from firmware_bridge.stopping import StopLevel
from lipservo.access.admission import Refusal
from lipservo.agents.listener import PlayFile, SayText, Utterance
from lipservo.agents.messages import (
    AskStatus,
    Command,
    MessageError,
    Outbox,
    Play,
    Say,
    Set,
    StartFace,
    Stop,
    command,
    id_of,
)
from lipservo.agents.turns import OpenStreams

#: Commands of one client that are worked on at a time.
_MOST_PENDING: Final = 8
#: Stops of one client whose answers are awaited. The next is sent all the same; the oldest, which
#: the face has long received, is answered by an error.
_MOST_STOPS: Final = 8
#: A supervisor notices a hung bridge within a second and answers in its place.
_ANSWER_S: Final = 2.0
#: A face whose process was replaced in between is sent the stop again after this.
_RETRY_S: Final = 0.05
#: Longer than the report of 252 servos.
_LONGEST_ANSWER: Final = 1 << 18

Answer = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Commands:
    """The control socket, speech functions and thread pools that the commands of clients need.

    say, play: speak a text or play a sound file; None: not available. statuses, changes, speaking:
    thread pools for `status`; `set` and `start`; `say` and `play`. They are separate so that no
    command waits for a synthesiser, and no change for a client that polls.
    """

    control_path: Path
    say: SayText | None
    play: PlayFile | None
    statuses: Executor
    changes: Executor
    speaking: Executor


class ControlSession:
    """The commands of one client connected to `/control`, and their results."""

    def __init__(
        self,
        outbox: Outbox,
        commands: Commands,
        streams: OpenStreams,
        may_only_stop: Refusal | None = None,
    ) -> None:
        """Create the session of one client that is connected to `/control`.

        outbox: queue of the messages to this client. commands: socket, functions and thread pools
        that carry commands out. streams: the speech of all clients. may_only_stop: why all commands
        but stops are refused; None: none is refused.
        """
        self._outbox = outbox
        self._commands = commands
        self._streams = streams
        self._may_only_stop = may_only_stop
        self._pending: dict[asyncio.Task[None], Command] = {}
        self._stops: dict[asyncio.Task[None], Stop] = {}

    async def hear(self, message: str | bytes) -> None:
        """Start the command in a client's message; send its result or error once it is done."""
        if isinstance(message, bytes):
            self._outbox.error("unexpected_binary", "commands are text; audio goes to /stream")
            return
        if (stop := _parse_stop(message)) is not None:
            self._send_stop(stop)
            return
        try:
            given = command(message)
            if given is None:
                return
            if self._may_only_stop is not None:
                raise MessageError("unauthorized", self._may_only_stop.text)
            if len(self._pending) >= _MOST_PENDING:
                busy = f"{_MOST_PENDING} commands wait for their results already"
                raise MessageError("too_many_requests", busy)
            if given.id is not None and given.id in [each.id for each in self._pending.values()]:
                in_use = f"id {given.id!r} is in use: its result has not come"
                raise MessageError("bad_message", in_use)
        except MessageError as error:
            self._outbox.error(error.code, str(error), id=id_of(message))
            return
        task = asyncio.get_running_loop().create_task(self._deliver(given, self._carry_out(given)))
        self._pending[task] = given
        task.add_done_callback(lambda done: self._pending.pop(done, None))

    def _send_stop(self, stop: Stop) -> None:
        """Send a stop to the face now; await its answer in a task and send that to the client."""
        if stop.end and self._may_only_stop is not None:
            self._outbox.error("unauthorized", self._may_only_stop.text, id=stop.id)
            return
        path, level = self._commands.control_path, StopLevel(stop.level)
        sent = None
        try:
            sent = send_stop(path, level, end=stop.end)
        except BlockingIOError:
            pass  # too many clients wait at the socket: `stop_answer` sends it again
        except OSError as error:
            self._outbox.error("not_answering", _not_answering(error), id=stop.id)
            return
        if len(self._stops) >= _MOST_STOPS:
            oldest = next(iter(self._stops))
            busy = f"{_MOST_STOPS} later stops were sent; the answer to this one is awaited no more"
            self._outbox.error("too_many_requests", busy, id=self._stops.pop(oldest).id)
            oldest.cancel()
        answered = stop_answer(sent, partial(send_stop, path, level, end=stop.end), stop.wait_s)
        task = asyncio.get_running_loop().create_task(
            self._deliver(stop, _stop_result(stop, answered))
        )
        self._stops[task] = stop
        task.add_done_callback(lambda done: self._stops.pop(done, None))

    def leave(self) -> None:
        """Discard all unsent results; called when the client has disconnected.

        Commands that are running are completed.
        """
        self._outbox.close()

    async def _deliver(
        self, given: Command, answered: Coroutine[None, None, Mapping[str, object] | None]
    ) -> None:
        """Await the result of the command `given`; queue it for the client, or an error event.

        An OSError becomes the error `not_answering`.
        """
        try:
            result = await answered
        except MessageError as error:
            self._outbox.error(error.code, str(error), id=given.id)
        except OSError as error:
            self._outbox.error("not_answering", _not_answering(error), id=given.id)
        else:
            self._outbox.put({"type": "result", "id": given.id, "result": result})

    async def _carry_out(self, given: Command) -> Mapping[str, object] | None:
        """Carry out a command other than a stop; return its result.

        Requests run in threads of the pool for their kind. Raises MessageError if the face refuses
        the command, OSError if the face does not answer.
        """
        commands = self._commands
        path = commands.control_path
        match given:
            case AskStatus():
                return await _query(commands.statuses, partial(ask, path, "status"))
            case Set():
                change = partial(change_setting, path, given.name, given.value)
                return await _query(commands.changes, change)
            case StartFace():
                return await _query(commands.changes, partial(start_face, path))
            case Say():
                say = commands.say and partial(commands.say, given)
                return await self._start_speech(given, say, "say")
            case Play():
                play = commands.play and partial(commands.play, given)
                return await self._start_speech(given, play, given.file)
            case Stop():
                raise AssertionError("a stop is sent before")

    async def _start_speech(
        self, given: Say | Play, speak: Callable[[str], Utterance] | None, name: str
    ) -> Mapping[str, object]:
        """Start the speech of a `say` or `play`; return its stream id, `duration_s` and `is_whole`.

        speak: starts the speech under a stream id, called in a thread; None: not available, an
        error. name: beginning of the stream id. Unless `is_whole`, `duration_s` counts the part
        synthesised so far. Raises MessageError.
        """
        if speak is None:
            why = f"this face takes no messages of type `{given.type}`; `play` needs `--sounds`"
            raise MessageError("not_available", why)
        speech = self._streams.open_own(self._outbox, given.id, name)
        loop = asyncio.get_running_loop()
        try:
            spoken = await loop.run_in_executor(self._commands.speaking, speak, speech.stream_id)
        except ValueError as error:
            self._streams.forget(speech)
            if isinstance(error, MessageError):
                raise
            raise MessageError("refused", " ".join(str(error).split())) from error
        except BaseException:
            self._streams.forget(speech)
            raise
        self._streams.keep(speech, spoken)
        length = {"duration_s": round(spoken.duration_s, 3), "is_whole": spoken.is_whole}
        return {"stream": speech.stream_id, **length}


def _parse_stop(text: str) -> Stop | None:
    """Parse a JSON text as a stop; None: another command, or invalid, as `command` reports."""
    try:
        fields = json.loads(text)
        is_stop = isinstance(fields, dict) and fields.get("type") == "stop"
        return Stop.model_validate(fields) if is_stop else None
    except (ValueError, RecursionError):
        return None  # the caller parses it again with `command`, which reports the mistake


async def _stop_result(
    stop: Stop, answered: Awaitable[tuple[Mapping[str, object], Mapping[str, object] | None]]
) -> Mapping[str, object]:
    """Return the result of a stop: the face's answer, and `report` if the client waits for it.

    Raises MessageError if the face refuses the stop, and what `answered` raises.
    """
    answer, report = await answered
    if "error" in answer:
        raise MessageError("refused", str(answer["error"]))
    return {**answer, "report": report} if stop.wait_s else answer


async def _query(pool: Executor, call: Callable[[], Mapping[str, object]]) -> Mapping[str, object]:
    """Run `call`, a request to the face, in `pool`; return its answer or raise MessageError."""
    answer = await asyncio.get_running_loop().run_in_executor(pool, call)
    if "error" in answer:
        raise MessageError("refused", str(answer["error"]))
    return answer


def _not_answering(error: OSError) -> str:
    return f"the face does not answer: {error.strerror or error}"


async def stop_answer(
    sent: socket.socket | None, send: Callable[[], socket.socket], wait_s: float = 0.0
) -> tuple[Answer, Answer | None]:
    """Wait for the face's answer to a stop and, if wanted, for its report that the face has ended.

    Parameters
    ----------
    sent : the connection on which the stop was sent; None: not sent, as too many clients waited.
    send : sends the stop again, as `send_stop`, in that case or if the face's process was replaced.
    wait_s : seconds to wait for the report, counted from the call; 0: do not wait for it.

    Returns
    -------
    The answer, and the report of what the servos confirmed (`StopReport`). The report is None if
    `wait_s` is 0, if it did not come in time, and after a freeze or a refusal.

    Raises
    ------
    TimeoutError
        No answer comes within 2 s: the face hangs.
    OSError
        No face listens at the control socket.
    """
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    answer_by_s, report_by_s = began_s + _ANSWER_S, began_s + wait_s
    reply: Answer | None = None
    # First the answer is awaited, then the report. Where the connection ends without them, as the
    # face's process was replaced, the stop is sent again.
    while True:
        try:
            connection, sent = sent or send(), None
            with connection:
                answer = await _receive(connection, answer_by_s if reply is None else report_by_s)
                reply = reply or answer
                # A face that freezes goes on, held; one that refuses goes on as before.
                if reply and not (wait_s and reply.get("accepted") in ("soft", "limp")):
                    return reply, None
                report = await _receive(connection, report_by_s) if answer else None
            if reply is not None and report is not None:
                return reply, report
        except BlockingIOError:  # so many clients wait at the socket that the kernel takes no more
            pass
        except OSError:
            if reply is None:
                raise
            return reply, None
        if loop.time() + _RETRY_S > (answer_by_s if reply is None else report_by_s):
            if reply is None:
                raise TimeoutError("no answer")
            return reply, None
        await asyncio.sleep(_RETRY_S)


async def _receive(connection: socket.socket, by_s: float) -> Answer | None:
    """Return the face's next message; None: the face has closed the connection.

    Raises TimeoutError at `by_s` of the event loop's clock.
    """
    loop = asyncio.get_running_loop()
    try:
        async with asyncio.timeout_at(by_s):
            raw = await loop.sock_recv(connection, _LONGEST_ANSWER)
    except ConnectionError:
        return None
    return dict(json.loads(raw)) if raw else None
