"""Who may talk to the dashboard: the door before every page, request and WebSocket of it.

Every web page in a browser on this computer reaches 127.0.0.1, and a page can make its own name
lead there (DNS rebinding). So without a token the dashboard answers to addresses and `localhost`
alone; with or without one, to what its own pages ask and to no other page's scripts.
"""

import hashlib
import hmac
import json
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any, Final
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.exceptions import HTTPException

from lipservo.agents.admission import bearer_token, is_plain_host, is_same_token

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

_SAFE: Final = ("GET", "HEAD")
#: Programs ask there; everything else is for people, who may follow a link to it.
_FOR_PROGRAMS: Final = ("/api", "/metrics", "/_nicegui_ws")
#: A sound file (`MOST_BYTES` of lipservo/dashboard/sound_lines.py) with what a form adds; the rest.
_MOST_FILE_BYTES: Final = 51_000_000
_MOST_BODY_BYTES: Final = 1 << 20
_YEAR_S: Final = 365 * 24 * 3600
#: Pages load nothing from elsewhere, stand in nobody's frame, and tell nobody where they are.
#: NiceGUI's pages are made by inline scripts, and Vue compiles its templates in the browser.
_SECURITY_HEADERS: Final = (
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


@dataclass(frozen=True, slots=True)
class Asked:
    """What the door knows of a request. headers: by lower-case name, `, ` between repeated ones."""

    method: str
    path: str
    query: str
    headers: dict[str, str]
    is_socket: bool

    @property
    def is_for_people(self) -> bool:
        """A page, to be seen by itself."""
        within = any(self.path == p or self.path.startswith(f"{p}/") for p in _FOR_PROGRAMS)
        return not self.is_socket and self.method in _SAFE and not within


@dataclass(frozen=True, slots=True)
class Refused:
    """An answer instead."""

    status: HTTPStatus
    text: str


@dataclass(frozen=True, slots=True)
class SentOn:
    """The token of the address becomes a cookie, and the address is asked again without it."""

    location: str
    cookie: str


def judged(asked: Asked, token: str | None) -> Refused | SentOn | None:
    """None: let it in. token: that clients must know; None: nobody is asked."""
    host = asked.headers.get("host", "")
    if token is None and not is_plain_host(host):
        hint = "this host name is not the dashboard's; use its address"
        return Refused(HTTPStatus.FORBIDDEN, hint)
    if not _is_own_page(asked, host):
        hint = "scripts of other web pages are not let in"
        return Refused(HTTPStatus.FORBIDDEN, hint)
    if token is None:
        return None
    given = dict(parse_qsl(asked.query, max_num_fields=64)).get("token")
    name, value = cookie_of(token)
    if given is not None and is_same_token(given, token):
        if not asked.is_for_people:
            return None
        age = f"Max-Age={_YEAR_S}; Path=/; HttpOnly; SameSite=Strict"
        return SentOn(_without_token(asked), f"{name}={value}; {age}")
    if _has_token(asked, token, name, value):
        return None
    hint = "open it with `?token=TOKEN`, or send `Authorization: Bearer TOKEN`"
    return Refused(HTTPStatus.UNAUTHORIZED, hint)


def cookie_of(token: str) -> tuple[str, str]:
    """Name and value of the cookie that says who has shown the token; neither tells it.

    Another dashboard of the same host has another token, and so a cookie of another name.
    """
    told = hmac.new(token.encode(), b"lipservo dashboard", hashlib.sha256).hexdigest()
    return f"lipservo_{told[:8]}", told[8:]


def _has_token(asked: Asked, token: str, name: str, value: str) -> bool:
    bearer = bearer_token(asked.headers.get("authorization", ""))
    if bearer is not None:
        return is_same_token(bearer, token)
    try:
        cookies = SimpleCookie(asked.headers.get("cookie", "").replace(", ", "; "))
    except CookieError:
        return False
    return name in cookies and is_same_token(cookies[name].value, value)


def _is_own_page(asked: Asked, host: str) -> bool:
    """Whether a page of ours asks, or nobody's page: a program, or a person who opens a page."""
    origin = asked.headers.get("origin")
    if origin is not None:
        try:
            asking = urlsplit(origin)
        except ValueError:
            return False
        if asking.scheme not in ("http", "https") or asking.netloc.lower() != host.lower():
            return False
    site = asked.headers.get("sec-fetch-site", "none")
    if site in ("none", "same-origin"):
        return True
    goes_there = asked.headers.get("sec-fetch-mode") == "navigate"
    is_whole = asked.headers.get("sec-fetch-dest") == "document"
    return asked.is_for_people and goes_there and is_whole


def _without_token(asked: Asked) -> str:
    rest = [pair for pair in parse_qsl(asked.query, max_num_fields=64) if pair[0] != "token"]
    # A path that begins with two slashes would name another host.
    path = "/" + asked.path.lstrip("/\\")
    return f"{path}?{urlencode(rest)}" if rest else path


class Door:
    """An ASGI application around another. app: what it leads to."""

    def __init__(self, app: App, token: str | None) -> None:
        self.app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or turn it away."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        is_socket = scope["type"] == "websocket"
        try:
            verdict = judged(_asked(scope), self._token)
        except ValueError:
            verdict = Refused(HTTPStatus.BAD_REQUEST, "the request cannot be read")
        if verdict is None and not is_socket:
            try:
                await self.app(scope, _bounded(scope, receive), _hardened(send))
            except RuntimeError as error:
                # Starlette's way of saying that the client has gone before it was answered.
                if str(error) != "No response returned.":
                    raise
        elif verdict is None:
            await self.app(scope, receive, send)
        elif isinstance(verdict, Refused):
            body = json.dumps({"error": verdict.text}).encode()
            kind = "websocket.http.response" if is_socket else "http.response"
            headers = [(b"content-type", b"application/json")]
            await _answer(send, kind, verdict.status, headers, body)
        else:
            headers = [
                (b"location", verdict.location.encode("latin-1", "replace")),
                (b"set-cookie", verdict.cookie.encode()),
                (b"cache-control", b"no-store"),
            ]
            await _answer(_hardened(send), "http.response", HTTPStatus.SEE_OTHER, headers, b"")


def _asked(scope: Scope) -> Asked:
    headers: dict[str, str] = {}
    for raw_name, raw in scope["headers"]:
        name, value = raw_name.decode("latin-1").lower(), raw.decode("latin-1")
        headers[name] = f"{headers[name]}, {value}" if name in headers else value
    return Asked(
        scope.get("method", "GET"),
        scope["path"],
        scope["query_string"].decode("latin-1"),
        headers,
        scope["type"] == "websocket",
    )


def _bounded(scope: Scope, receive: Receive) -> Receive:
    """What comes of a body, until it is longer than any that is meant."""
    n_bytes = 0

    async def receiving() -> Message:
        nonlocal n_bytes
        message = await receive()
        n_bytes += len(message.get("body", b""))
        if n_bytes > most_bytes(scope["path"]):
            raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "the body is too large")
        return message

    return receiving


def most_bytes(path: str) -> int:
    """How long the body of a request may be."""
    takes_files = path == "/api/lines" or path.startswith("/_nicegui/")
    return _MOST_FILE_BYTES if takes_files else _MOST_BODY_BYTES


async def _answer(
    send: Send, kind: str, status: HTTPStatus, headers: list[tuple[bytes, bytes]], body: bytes
) -> None:
    length = (b"content-length", str(len(body)).encode())
    await send({"type": f"{kind}.start", "status": int(status), "headers": [*headers, length]})
    await send({"type": f"{kind}.body", "body": body})


def _hardened(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), *_SECURITY_HEADERS]
        await send(message)

    return sending
