"""One connection to `/control`: commands, each answered by a `result` or an `error` with its id.

The server is a client of the face's own control socket here: there is one command queue, one
status, and `lipservo stop` works whatever becomes of this server.
"""

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from firmware_bridge.process.control_client import ask, change_setting
from lipservo.agents.agent_settings import Speak
from lipservo.agents.messages import (
    AskStatus,
    Command,
    MessageError,
    Play,
    Say,
    Set,
    Stop,
    command,
    id_of,
)
from lipservo.agents.outbox import Outbox

#: Commands of one client that are worked on at a time.
_MOST_PENDING: Final = 8


@dataclass(frozen=True, slots=True)
class Commands:
    """What a command needs. at_once: threads for stop, status and set; speaking: for say and play.

    They are apart, so that no stop waits for a synthesiser.
    """

    control_path: Path
    say: Speak | None
    play: Speak | None
    at_once: Executor
    speaking: Executor


class ControlSession:
    """What one client's commands do."""

    def __init__(self, outbox: Outbox, commands: Commands) -> None:
        self._outbox = outbox
        self._commands = commands
        self._pending: set[asyncio.Task[None]] = set()

    async def hear(self, message: str | bytes) -> None:
        """Begin what one message asks for; its answer comes when there is one."""
        if isinstance(message, bytes):
            self._outbox.error("unexpected_binary", "commands are text; audio goes to /stream")
            return
        try:
            said = command(message)
            if said is None:
                return
            if len(self._pending) >= _MOST_PENDING:
                busy = f"{_MOST_PENDING} commands wait for their results already"
                raise MessageError("too_many_requests", busy)
        except MessageError as error:
            self._outbox.error(error.code, str(error), id=id_of(message))
            return
        task = asyncio.get_running_loop().create_task(self._answer(said))
        self._pending.add(task)
        task.add_done_callback(self._pending.discard)

    def leave(self) -> None:
        """The client has gone; what it asked for is done, and nobody is told."""
        self._outbox.close()

    async def _answer(self, said: Command) -> None:
        try:
            result = await self._result(said)
        except MessageError as error:
            self._outbox.error(error.code, str(error), id=said.id)
        except OSError as error:
            why = error.strerror or str(error)
            self._outbox.error("not_answering", f"the face does not answer: {why}", id=said.id)
        else:
            self._outbox.put({"type": "result", "id": said.id, "result": result})

    async def _result(self, said: Command) -> Mapping[str, object] | None:
        path = self._commands.control_path
        match said:
            case AskStatus():
                return await self._face(partial(ask, path, "status"))
            case Stop():
                return await self._face(partial(ask, path, said.level))
            case Set():
                return await self._face(partial(change_setting, path, said.name, said.value))
            case Say():
                return await self._speak("say", self._commands.say, said.text)
            case Play():
                return await self._speak("play", self._commands.play, said.file)

    async def _face(self, call: Callable[[], Mapping[str, object]]) -> Mapping[str, object]:
        loop = asyncio.get_running_loop()
        answer = await loop.run_in_executor(self._commands.at_once, call)
        if "error" in answer:
            raise MessageError("refused", str(answer["error"]))
        return answer

    async def _speak(
        self, name: str, speak: Speak | None, what: str
    ) -> Mapping[str, object] | None:
        if speak is None:
            raise MessageError("not_available", f"not available: this face has no {name}")
        loop = asyncio.get_running_loop()
        try:
            return await loop.run_in_executor(self._commands.speaking, speak, what)
        except MessageError:
            raise
        except ValueError as error:
            raise MessageError("refused", " ".join(str(error).split())) from error
