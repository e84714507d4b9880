"""`POST /api/stop`, answered before everything else of the dashboard.

Its connection finds room in the server however many others wait. The outermost ASGI layer checks it
by the policy (`lipservo/access/admission.py`) and sends it to the face's control socket
(`control_client.send_stop`), in the event loop. It needs no thread, search, status or disk, so that
nothing else in the dashboard can delay it.
"""

import asyncio
import json
import logging
from collections.abc import Mapping
from functools import partial
from http import HTTPStatus
from typing import Any, Final

from lipservo_client.protocol import FaceError
from pydantic import ValidationError
from uvicorn.protocols.http.h11_impl import H11Protocol

from firmware_bridge.process.control_client import send_stop
from firmware_bridge.stopping import StopLevel
from lipservo.access.admission import Policy, Refusal, Request, refusal, request_of_scope
from lipservo.access.doorway import Doorway
from lipservo.agents.control_session import stop_answer
from lipservo.dashboard.face_link import FaceLink, NothingDrivenError
from lipservo.dashboard.web.access_layer import App, Receive, Scope, Send, answer_json, cors_headers
from lipservo.dashboard.web.api_models import StopBody, first_error, status_of

PATH: Final = "/api/stop"
#: A body is {"level": "soft", "wait_s": 15, "end": false} at most.
_LONGEST_BODY: Final = 1024
_SOFT_STOP: Final = StopBody()
#: Keys of a face's answer to a freeze, with names of servos.
_FREEZE_KEYS: Final[tuple[str, ...]] = ("holds", "limp", "unknown")


def is_stop(scope: Mapping[str, Any]) -> bool:
    """Return whether an ASGI scope is of a request to stop the face."""
    return (scope["type"], scope.get("path"), scope.get("method")) == ("http", PATH, "POST")


def http_connections(heads: Doorway, stops: Doorway) -> type[asyncio.Protocol]:
    """Return a uvicorn protocol class: HTTP connections whose number two doorways limit.

    A doorway aborts the oldest of too many waiting connections, so that idle clients cannot block a
    stop. heads: for connections whose next request's head, or a stop's body, is awaited. stops: for
    connections that wait for the answer to a stop. Those that wait for another answer are limited
    by `RequestLimit`.
    """

    class Connection(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            heads.enter(transport)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            self._update_doorways()

        def on_response_complete(self) -> None:
            super().on_response_complete()
            self._update_doorways()

        def connection_lost(self, exc: Exception | None) -> None:
            super().connection_lost(exc)
            heads.leave(self.transport)
            stops.leave(self.transport)

        def _update_doorways(self) -> None:
            """Enter the doorway for what this connection waits for, if there is one; leave others.

            Called whenever that may have changed: bytes came, or an answer was sent.
            """
            request, doorway = self.cycle, None
            if request is None or request.response_complete:
                # A connection that has become a WebSocket sends no further head.
                doorway = heads if self.transport.get_protocol() is self else None
            elif is_stop(request.scope):
                doorway = heads if request.more_body else stops
            for each in (heads, stops):
                each.enter(self.transport) if each is doorway else each.leave(self.transport)

    return Connection


class StopRoute:
    """An ASGI application that answers stops, and passes all other requests to the one within."""

    def __init__(self, app: App, link: FaceLink, token: str | None) -> None:
        """Wrap `app`. link: knows the face's control socket. token: see `Policy`."""
        self.app = app
        self._link = link
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a stop; pass every other request to the application within."""
        if not is_stop(scope):
            await self.app(scope, receive, send)
            return
        policy = Policy(self._token, self._link.origins)
        request = request_of_scope(scope)
        try:
            status, answer = await self._answer(request, policy, receive)
        except Exception as error:
            logging.getLogger("lipservo.dashboard").error("a fault of ours", exc_info=error)
            status, answer = 500, {"error": f"a fault of the dashboard's: {type(error).__name__}"}
        await answer_json(send, status, answer, cors_headers(request, policy))

    async def _answer(
        self, request: Request, policy: Policy, receive: Receive
    ) -> tuple[int, dict[str, Any]]:
        """Check a request to stop the face, send the stop, and return (HTTP status, JSON answer).

        A stop from this computer needs no token, unless it also ends the face's process.
        """
        # `stop` is the request's body, or why it is refused.
        try:
            stop = refusal(request, policy, is_stop=True) or await _read_body(receive)
            if isinstance(stop, StopBody) and stop.end:  # it ends the process: needs the token
                stop = refusal(request, policy) or stop
        except ValueError:
            stop = Refusal(HTTPStatus.BAD_REQUEST, "the request cannot be read")
        if isinstance(stop, Refusal):
            return stop.status, {"error": stop.text}
        try:
            return 200, await stop_face(self._link, stop)
        except FaceError as error:
            return status_of(error), {"error": str(error)}


async def stop_face(link: FaceLink, stop: StopBody) -> dict[str, Any]:
    """Send a stop to the face at once, and return its answer.

    Returns
    -------
    {"accepted": LEVEL}; with `wait_s` also "report": what the servos confirmed (`StopReport`), None
    if the stop did not end in time, or too many clients wait for one. For a freeze also `holds`,
    `limp` and `unknown`: names of servos. If no face drives servos {"accepted": None,
    "nothing_driven": a sentence, "is_limp": whether the servos confirmed torque off}.

    Raises
    ------
    FaceError
        not_answering: no face is found, or it hangs; refused: by the face.
    """
    path, connection, level = link.control_path, None, StopLevel(stop.level)
    try:
        if path is not None:
            connection = send_stop(path, level, end=stop.end)
    except BlockingIOError:
        pass  # too many clients wait at the socket; `stop_answer` sends it again
    except OSError:
        path = None  # no face listens there now: it is searched for
    try:
        if path is None:
            path = await link.find_control_path()
        with link.waiting_for_end(stop.wait_s) as wait_s:
            send_again = partial(send_stop, path, level, end=stop.end)
            answer, report = await stop_answer(connection, send_again, wait_s)
    except (OSError, FaceError, NothingDrivenError) as error:
        outcome = await link.release_unreached(error, level)
        return {"accepted": None, "nothing_driven": str(outcome), "is_limp": outcome.is_limp}
    if "error" in answer:
        raise FaceError("refused", str(answer["error"]))
    freeze_answer = {name: answer[name] for name in _FREEZE_KEYS if name in answer}
    return {
        "accepted": answer.get("accepted"),
        **freeze_answer,
        **({"report": report} if stop.wait_s else {}),
    }


async def _read_body(receive: Receive) -> StopBody | Refusal:
    """Return the body of a stop request, a soft stop for an empty body, or a refusal."""
    body, is_whole = b"", False
    while not is_whole:  # the doorway `heads` aborts a connection that sends it too slowly
        message = await receive()
        if message["type"] == "http.disconnect":
            return Refusal(HTTPStatus.BAD_REQUEST, "the client has gone")
        body += message.get("body", b"")
        if len(body) > _LONGEST_BODY:
            too_long = f"the body is longer than {_LONGEST_BODY} bytes"
            return Refusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, too_long)
        is_whole = not message.get("more_body")
    if not body:
        return _SOFT_STOP
    try:
        json.loads(body)
    except (ValueError, RecursionError):
        return Refusal(HTTPStatus.BAD_REQUEST, "the body is not JSON")
    try:
        return StopBody.model_validate_json(body)
    except ValidationError as error:
        return Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, first_error(error.errors()))
