"""The WebSocket connection to a face: opening with a token, reading at all times, time limits."""

import asyncio
import contextlib
import json
from collections.abc import Callable
from http import HTTPStatus
from typing import Final

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus, InvalidURI

from lipservo_client.local_token import found_tokens
from lipservo_client.protocol import Event, FaceError

#: An answer that takes longer will not come.
PATIENCE_S: Final = 10.0
#: Interval of pings, wait for their answer, and wait for closing: a peer that is gone is noticed
#: after all three, within ten seconds.
_PING_S, _PONG_S, _CLOSING_S = 3.0, 6.0, 0.5


class Wire:
    """A connection that reads events at all times, since a face drops clients that do not read."""

    def __init__(
        self,
        socket: ClientConnection,
        token: str | None,
        on_event: Callable[[Event], None],
        on_close: Callable[[FaceError], None],
    ) -> None:
        """Read from an open `socket` in a task: `on_event` gets each event, `on_close` the end.

        token: that opened it; None: none.
        """
        self._socket = socket
        self.token = token
        self._on_event = on_event
        self._on_close = on_close
        self._reading = asyncio.get_running_loop().create_task(self._read())

    async def send(self, kind: str, **fields: object) -> None:
        """Send a message of type `kind` with `fields` but those that are None. Raises FaceError."""
        given = {name: value for name, value in fields.items() if value is not None}
        await self.send_message(json.dumps({"type": kind, **given}))

    async def close(self) -> None:
        """Disconnect; ended streams are played on, unless another is open or paused."""
        await self._socket.close()
        await self._reading

    async def send_message(self, message: str | bytes) -> None:
        """Send text or samples, as bytes. FaceError if disconnected, or not taken within 10 s."""
        try:
            async with asyncio.timeout(PATIENCE_S):
                await self._socket.send(message)
        except ConnectionClosed as error:
            raise _disconnection_error(error) from error
        except TimeoutError as error:
            raise FaceError("not_answering", f"it accepted nothing for {PATIENCE_S:g} s") from error

    async def _read(self) -> None:
        """Call `on_event` with each message that has a `type`; `on_close` when disconnected."""
        try:
            while True:
                with contextlib.suppress(ValueError):
                    event = json.loads(await self._socket.recv())
                    if isinstance(event, dict) and isinstance(event.get("type"), str):
                        self._on_event(event)
        except ConnectionClosed as error:
            self._on_close(_disconnection_error(error))


async def connected(
    url: str,
    token: str | None,
    on_event: Callable[[Event], None],
    on_close: Callable[[FaceError], None],
    patience_s: float,
) -> Wire:
    """Connect to the WebSocket of the face at `url`; return the connection.

    token: that the face requires; None: tokens found in this computer's runtime folders are tried,
    for a face of another computer none. on_event: called with each event; on_close: called once
    with the error when the connection ends; patience_s: for the connection to open.

    Raises
    ------
    FaceError
        unauthorized, refused, not_answering.
    """
    tokens = [token] if token is not None else await asyncio.to_thread(found_tokens, url)
    for each in tokens[:-1]:
        with contextlib.suppress(_UnauthorizedError):
            return Wire(await _open(url, each, patience_s), each, on_event, on_close)
    last = tokens[-1] if tokens else None
    return Wire(await _open(url, last, patience_s), last, on_event, on_close)


class _UnauthorizedError(FaceError):
    """An error: the face refused the token, or required one and got none."""


async def _open(url: str, token: str | None, patience_s: float) -> ClientConnection:
    """Open a WebSocket within patience_s, with a token or, for None, without.

    Raises FaceError: unauthorized, refused, not_answering.
    """
    headers = None if token is None else {"Authorization": f"Bearer {token}"}
    try:
        return await connect(
            url,
            additional_headers=headers,
            compression=None,
            proxy=None,  # a proxy would get the token, and reaches no face on this computer
            open_timeout=patience_s,
            ping_interval=_PING_S,
            ping_timeout=_PONG_S,
            close_timeout=_CLOSING_S,
        )
    except InvalidStatus as error:
        answer = error.response
        why = bytes(answer.body or b"").decode("utf-8", "replace").strip()
        line = f"{url}: {why or answer.status_code}"
        if answer.status_code == HTTPStatus.UNAUTHORIZED:
            raise _UnauthorizedError("unauthorized", line) from error
        raise FaceError("refused", line) from error
    except (InvalidURI, InvalidHandshake) as error:
        raise FaceError("refused", f"{url} is not the address of a face: {error}") from error
    except (OSError, TimeoutError) as error:
        hint = "is a face running that takes speech?"
        raise FaceError("not_answering", f"{url}: no face answers there; {hint}") from error


def _disconnection_error(error: ConnectionClosed) -> FaceError:
    """Return the error of a closed connection: code and text as the face sent them on closing."""
    reason = error.rcvd.reason if error.rcvd is not None else ""
    code, _, rest = reason.partition(":")
    return FaceError(code or "disconnected", rest.strip() or "the face has hung up")
