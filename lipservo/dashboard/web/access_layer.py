"""Access control for all requests and WebSockets of the dashboard: admission, size, headers.

Here are the ASGI types, answers and headers that the layers of the dashboard share, the layer
itself, and the page that a browser on this computer gets without the token. The policy is
`lipservo/access/admission.py`; the stop is served before this layer.
"""

import json
import secrets
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping, MutableMapping, Sequence
from functools import cache
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final

from lipservo_client.local_token import are_listed, connected_users
from starlette.exceptions import HTTPException

from lipservo.access.admission import (
    Policy,
    Redirect,
    Refusal,
    Request,
    is_same_token,
    redirect_to_cookie,
    refusal,
    request_of_scope,
)
from lipservo.access.doorway import scaled

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]
Headers = Sequence[tuple[bytes, bytes]]

#: Pages load nothing from other sites, are shown in no other page's frame, and send no referrer.
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
#: The script of STOP on every page; it imports nothing.
_STOP_SCRIPT: Final = Path(__file__).parent.parent / "static" / "stop.js"
_PAGE: Final = """<!doctype html><html lang="en"><meta charset="utf-8"><title>lipservo: STOP</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body{font:1.1rem/1.5 system-ui,sans-serif;max-width:40rem;margin:3rem auto;padding:0 1rem}
#face-stop{font-size:2rem;padding:1.5rem 3rem;border:0;border-radius:.8rem;background:#c8102e;
color:#fff;cursor:pointer}#face-stop small{display:block;font-size:1rem}
#face-stop-report{font-weight:600}#face-stop-report[data-tone=good]{color:#176b2c}
#face-stop-report[data-tone=bad]{color:#c8102e}
</style>
<h1>lipservo</h1>
<p><button id="face-stop" type="button" title="Stops the face. Pressed again: limp at once.">
<b>STOP</b><small>Esc</small></button></p>
<p id="face-stop-report" role="alert" hidden></p>
<p>The page itself needs the face's token: open the address that was printed when the face started
(it ends in <code>?token=…</code>), or run <code>lipservo dashboard --open</code>.</p>
<script type="module">%s</script></html>
"""
#: Bytes of a body with a file (`MOST_BYTES` of sound_lines.py, and what a form adds); of others.
_MOST_FILE_BYTES: Final = 51_000_000
_MOST_BODY_BYTES: Final = 1 << 20
_MOST_REQUESTS: Final = 256
#: What scripts of a listed origin may send (CORS): https://fetch.spec.whatwg.org/#http-cors-protocol
_PREFLIGHT_HEADERS: Final = (
    (b"access-control-allow-methods", b"GET, POST, PATCH, DELETE"),
    (b"access-control-allow-headers", b"authorization, content-type"),
    (b"access-control-max-age", b"600"),
)


async def answer_json(
    send: Send,
    status: int,
    answer: Mapping[str, Any],
    headers: Headers = (),
    *,
    is_websocket: bool = False,
) -> None:
    """Send one JSON object as the answer to a request, or to a WebSocket's handshake.

    status: HTTP status. is_websocket: the answer refuses a handshake.
    """
    json_head = [(b"content-type", b"application/json"), (b"cache-control", b"no-store"), *headers]
    await answer_bytes(send, status, json_head, json.dumps(answer).encode(), is_websocket)


async def answer_bytes(
    send: Send, status: int, headers: Headers, body: bytes, is_websocket: bool = False
) -> None:
    """Send a whole answer to a request, or to a WebSocket's handshake.

    Its length and the security headers are added to `headers`.
    """
    kind = "websocket.http.response" if is_websocket else "http.response"
    length = (b"content-length", str(len(body)).encode())
    all_headers = [*headers, length, *SECURITY_HEADERS]
    await send({"type": f"{kind}.start", "status": int(status), "headers": all_headers})
    await send({"type": f"{kind}.body", "body": body})


@cache
def stop_page() -> str:
    """Return the HTML of the page with STOP alone, its script inline, since files need a token."""
    script = _STOP_SCRIPT.read_text("utf-8")
    return _PAGE.replace("%s", script.replace("</script", "<\\/script"), 1)


class OneTimeCode:
    """A code that replaces the token in the URL with which this user's browser is started.

    Every user sees the command lines of others, and a browser keeps its own for long. The code
    works once, and only for a program of this user.
    """

    def __init__(self, user: int) -> None:
        """Make a random code. user: numeric id of the user whose browser is admitted."""
        self.code = secrets.token_urlsafe()
        self._user = user
        self._is_used = False

    def admits(self, given: str, client_port: int, server_port: int) -> bool:
        """Return whether a request with code `given` may get the token's cookie; True only once.

        The code must be right and not yet used, and the program at the other end of the connection
        must belong to the constructor's `user` (not checked where the operating system does not
        list its sockets). client_port, server_port: of that connection.
        """
        if self._is_used or not is_same_token(given, self.code):
            return False
        if are_listed() and self._user not in connected_users(client_port, server_port):
            return False
        self._is_used = True
        return True


class RequestLimit:
    """An ASGI application that passes 256 requests and WebSockets at a time to another.

    Further ones are refused, as are those of a peer (an IP address) that has half of them already.
    """

    def __init__(self, app: App) -> None:
        """Wrap `app`."""
        self.app = app
        self._most = scaled(_MOST_REQUESTS)
        self._n_of_peer: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request to the application within; answer 503 where too many are open already.

        Too many are 256, or half as many of one peer (an IP address).
        """
        peer = (scope.get("client") or ("",))[0]
        if 2 * self._n_of_peer[peer] >= self._most or self._n_of_peer.total() >= self._most:
            busy, status = {"error": "too many requests at a time"}, HTTPStatus.SERVICE_UNAVAILABLE
            await answer_json(send, status, busy, is_websocket=scope["type"] == "websocket")
            return
        self._n_of_peer[peer] += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self._n_of_peer -= Counter((peer,))  # `-=` removes a peer that has none left


class AccessLayer:
    """An ASGI application around another, which gets only the requests that are admitted."""

    def __init__(
        self,
        app: App,
        token: str | None,
        origins: Callable[[], tuple[str, ...]] = tuple,
        code: OneTimeCode | None = None,
    ) -> None:
        """Wrap `app`. token, origins: as in `Policy`; `origins` is called at each request.

        code: admits the browser that was started with the program; None: no code does.
        """
        self.app = app
        self._token = token
        self._origins = origins
        self._code = code

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass one request to the application within, or answer with a refusal or redirect."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        policy = Policy(self._token, self._origins())
        is_websocket = scope["type"] == "websocket"
        try:
            request = request_of_scope(scope)
            verdict = self._verdict(request, policy, scope)
        except ValueError:
            refused = {"error": "the request cannot be read"}
            await answer_json(send, HTTPStatus.BAD_REQUEST, refused, is_websocket=is_websocket)
            return
        cors = cors_headers(request, policy)
        if isinstance(verdict, Redirect):
            headers = [
                (b"location", verdict.location.encode("latin-1", "replace")),
                (b"set-cookie", verdict.cookie.encode()),
                (b"cache-control", b"no-store"),
            ]
            await answer_bytes(send, HTTPStatus.SEE_OTHER, headers, b"")
        elif cors and request.method == "OPTIONS":
            # A preflight carries no token; the request that follows needs it.
            await answer_bytes(send, HTTPStatus.NO_CONTENT, [*cors, *_PREFLIGHT_HEADERS], b"")
        elif verdict is not None and _shows_stop(request, policy):
            headers = [(b"content-type", b"text/html; charset=utf-8")]
            headers.append((b"cache-control", b"no-store"))
            body = b"" if request.method == "HEAD" else stop_page().encode()
            await answer_bytes(send, verdict.status, headers, body)
        elif verdict is not None:
            refused = {"error": verdict.text}
            await answer_json(send, verdict.status, refused, is_websocket=is_websocket)
        elif is_websocket:
            await self.app(scope, receive, send)
        else:
            try:
                await self.app(scope, _with_size_limit(scope, receive), _with_headers(send, cors))
            except RuntimeError as error:
                # Starlette's way of saying that the client has gone before it was answered.
                if str(error) != "No response returned.":
                    raise

    def _verdict(self, request: Request, policy: Policy, scope: Scope) -> Refusal | Redirect | None:
        """Return a refusal, a redirect that sets the token's cookie, or None: admitted.

        The redirect is for a page whose URL has the token, or the one-time code in its place; it
        takes them out of the URL. Raises ValueError for a request that cannot be read.
        """
        refused = refusal(request, policy)
        token = request.token_in_query
        if policy.token is None or token is None or not request.is_page:
            return refused
        gets_cookie = is_same_token(token, policy.token) and refused is None
        lacks_token = refused is not None and refused.status == HTTPStatus.UNAUTHORIZED
        may_use_code = lacks_token and request.method == "GET"
        if not gets_cookie and self._code is not None and may_use_code:
            client, server = scope.get("client"), scope.get("server")
            ports = (client[1], server[1]) if client and server else (0, 0)
            gets_cookie = self._code.admits(token, *ports)
        return redirect_to_cookie(request, policy.token) if gets_cookie else refused


def most_bytes(path: str) -> int:
    """Return how many bytes a request's body may have: 51 MB for files, 1 MiB elsewhere."""
    takes_files = path == "/api/lines" or path.startswith("/_nicegui/")
    return _MOST_FILE_BYTES if takes_files else _MOST_BODY_BYTES


def cors_headers(request: Request, policy: Policy) -> Headers:
    """Return the headers that let a listed origin's scripts read an answer; else none."""
    origin = request.headers.get("origin", "")
    if origin not in policy.origins:
        return []
    return [(b"access-control-allow-origin", origin.encode("latin-1")), (b"vary", b"origin")]


def _shows_stop(request: Request, policy: Policy) -> bool:
    """Return whether a refused request is for a page that may show STOP instead.

    So it is for every HTML page requested on this computer, from where a stop needs no token, but
    not for files that pages load.
    """
    is_html = "text/html" in request.headers.get("accept", "")
    may_stop = refusal(request, policy, is_stop=True) is None
    return request.is_page and is_html and may_stop and not request.path.startswith("/static/")


def _with_size_limit(scope: Scope, receive: Receive) -> Receive:
    """Return `receive`, but raising HTTPException 413 once the body exceeds `most_bytes`."""
    n_bytes = 0

    async def receive_counted() -> Message:
        nonlocal n_bytes
        message = await receive()
        n_bytes += len(message.get("body", b""))
        if n_bytes > most_bytes(scope["path"]):
            raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "the request is too large")
        return message

    return receive_counted


def _with_headers(send: Send, cors: Headers) -> Send:
    """Return `send`, but adding the security headers and `cors` to an answer's headers."""

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), *SECURITY_HEADERS, *cors]
        await send(message)

    return send_with_headers
