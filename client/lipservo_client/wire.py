"""One WebSocket of a client: texts out, events in, and plain errors."""

import asyncio
import contextlib
import json
from collections.abc import Callable
from http import HTTPStatus
from typing import Final

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus, InvalidURI

from lipservo_client.face_answers import Event, FaceError

#: A chunk is sent in pieces: the face takes messages of up to 1 MB.
_PIECE_BYTES: Final = 1 << 16


class Wire:
    """A connection whose events are read at all times, since the face drops who does not read."""

    def __init__(
        self,
        socket: ClientConnection,
        on_event: Callable[[Event], None],
        on_close: Callable[[FaceError], None],
    ) -> None:
        self._socket = socket
        self._on_event = on_event
        self._on_close = on_close
        self._reading = asyncio.get_running_loop().create_task(self._read())

    async def send(self, kind: str, **fields: object) -> None:
        """A message. Raises FaceError once the connection is gone."""
        given = {name: value for name, value in fields.items() if value is not None}
        await self._send(json.dumps({"type": kind, **given}))

    async def send_audio(self, data: bytes) -> None:
        """Samples; waits while the face takes them slower. Raises FaceError."""
        for first in range(0, len(data), _PIECE_BYTES):
            await self._send(data[first : first + _PIECE_BYTES])

    async def close(self) -> None:
        """Hang up; what was said whole is said to its end."""
        await self._socket.close()
        await self._reading

    async def _send(self, message: str | bytes) -> None:
        try:
            await self._socket.send(message)
        except ConnectionClosed as error:
            raise _gone(error) from error

    async def _read(self) -> None:
        try:
            while True:
                with contextlib.suppress(ValueError):
                    event = json.loads(await self._socket.recv())
                    if isinstance(event, dict) and isinstance(event.get("type"), str):
                        self._on_event(event)
        except ConnectionClosed as error:
            self._on_close(_gone(error))


async def connected(
    url: str,
    token: str | None,
    on_event: Callable[[Event], None],
    on_close: Callable[[FaceError], None],
    patience_s: float,
) -> Wire:
    """Connect to a face.

    Parameters
    ----------
    token : that the face requires; None: on this computer it is found in the runtime folders, of
        another none is sent.

    Raises
    ------
    FaceError
        unauthorized, refused, not_answering.

    """
    tokens = [token] if token is not None else await asyncio.to_thread(_found_tokens, url)
    for each in tokens[:-1]:
        with contextlib.suppress(_UnauthorizedError):
            return Wire(await _opened(url, each, patience_s), on_event, on_close)
    last = tokens[-1] if tokens else None
    return Wire(await _opened(url, last, patience_s), on_event, on_close)


class _UnauthorizedError(FaceError):
    """The token is another, or none was sent."""


def _found_tokens(url: str) -> list[str]:
    from lipservo.access.token_file import found_tokens  # only where one is searched

    return found_tokens(url)


async def _opened(url: str, token: str | None, patience_s: float) -> ClientConnection:
    """Raises FaceError."""
    headers = None if token is None else {"Authorization": f"Bearer {token}"}
    try:
        return await connect(
            url,
            additional_headers=headers,
            compression=None,
            open_timeout=patience_s,
            close_timeout=patience_s,
        )
    except InvalidStatus as error:
        answer = error.response
        why = bytes(answer.body or b"").decode("utf-8", "replace").strip()
        line = f"{url}: {why or answer.status_code}"
        if answer.status_code == HTTPStatus.UNAUTHORIZED:
            raise _UnauthorizedError("unauthorized", line) from error
        raise FaceError("refused", line) from error
    except (InvalidURI, InvalidHandshake) as error:
        raise FaceError("refused", f"{url}: is no address of a face: {error}") from error
    except (OSError, TimeoutError) as error:
        hint = "is a face running that takes speech?"
        raise FaceError("not_answering", f"{url}: nobody answers there; {hint}") from error


def _gone(error: ConnectionClosed) -> FaceError:
    reason = error.rcvd.reason if error.rcvd is not None else ""
    code, _, rest = reason.partition(":")
    return FaceError(code or "disconnected", rest.strip() or "the face has hung up")
