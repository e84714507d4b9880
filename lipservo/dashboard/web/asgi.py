"""ASGI as the dashboard's own layers use it: its types, answers, and headers of every answer."""

import json
from collections.abc import Awaitable, Callable, Mapping, MutableMapping, Sequence
from typing import Any, Final

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]
Headers = Sequence[tuple[bytes, bytes]]

#: Pages load nothing from elsewhere, stand in no other page's frame, and name no address to others.
#: NiceGUI's pages are made by inline scripts, and Vue compiles its templates in the browser.
SECURITY_HEADERS: Final = (
    (
        b"content-security-policy",
        b"default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
        b"style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
        b"media-src 'self' blob:; worker-src 'self' blob:; connect-src 'self'; "
        b"form-action 'self'; base-uri 'self'; frame-ancestors 'none'",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


async def answer_json(
    send: Send,
    status: int,
    answer: Mapping[str, Any],
    headers: Headers = (),
    *,
    is_websocket: bool = False,
) -> None:
    """Answer a request, or a WebSocket's handshake, with one JSON object."""
    of_json = [(b"content-type", b"application/json"), (b"cache-control", b"no-store"), *headers]
    await answer_bytes(send, status, of_json, json.dumps(answer).encode(), is_websocket)


async def answer_bytes(
    send: Send, status: int, headers: Headers, body: bytes, is_websocket: bool = False
) -> None:
    """Answer with a whole body."""
    kind = "websocket.http.response" if is_websocket else "http.response"
    length = (b"content-length", str(len(body)).encode())
    whole = [*headers, length, *SECURITY_HEADERS]
    await send({"type": f"{kind}.start", "status": int(status), "headers": whole})
    await send({"type": f"{kind}.body", "body": body})
