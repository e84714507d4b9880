"""The admission policy for TCP clients, shared by the agent server and the dashboard's server.

Every request needs the token, on this computer too, but for a stop from this computer. Scripts of
any web page in a browser reach 127.0.0.1, and a page can make its own name lead there (DNS
rebinding): so a browser's request counts only if it comes from the server's own page or from an
origin that the face's YAML lists, and without the token only if `Host` is an address.
docs/hardware.md, "Who may connect over TCP", describes this for users.
"""

import hashlib
import hmac
from collections.abc import Iterable, Mapping, MutableMapping
from dataclasses import dataclass
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any, Final
from urllib.parse import parse_qsl, urlencode, urlsplit

from lipservo_client.local_token import host_address, is_loopback

_SAFE: Final = ("GET", "HEAD")
#: Paths for programs; all others are pages, which a person may open by a link.
_FOR_PROGRAMS: Final = ("/api", "/metrics", "/_nicegui_ws", "/stream", "/control")
#: With one of these a request came through a proxy: it may be from any computer.
_FORWARDED: Final = frozenset(
    ("forwarded", "via", "x-forwarded-for", "x-forwarded-host", "x-real-ip")
)
_YEAR_S: Final = 365 * 24 * 3600
_MOST_FIELDS: Final = 64


@dataclass(frozen=True, slots=True)
class Policy:
    """The requirements of a server on its clients.

    token: that clients must send; None: clients on this computer need none. origins: web pages, as
    `https://kiosk.example`, whose scripts may connect besides the server's own pages.
    """

    token: str | None = None
    origins: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Request:
    """The parts of an HTTP request that the policy needs.

    headers: by lower-case name, `, ` between repeated ones. peer: address of the client.
    """

    method: str
    path: str
    query: str
    headers: Mapping[str, str]
    is_websocket: bool
    peer: str

    @property
    def is_page(self) -> bool:
        """Whether the request is a GET or HEAD for a page that a browser shows by itself."""
        for_programs = any(self.path == p or self.path.startswith(f"{p}/") for p in _FOR_PROGRAMS)
        return not self.is_websocket and self.method in _SAFE and not for_programs

    @property
    def token_in_query(self) -> str | None:
        """The value of `?token=...`; None: none given. ValueError: over 64 fields in the query."""
        return dict(parse_qsl(self.query, max_num_fields=_MOST_FIELDS)).get("token")


@dataclass(frozen=True, slots=True)
class Refusal:
    """An HTTP status and a one-line text, sent in place of the requested answer."""

    status: HTTPStatus
    text: str


@dataclass(frozen=True, slots=True)
class Redirect:
    """A redirect to the page's address without its token, which becomes a cookie."""

    location: str
    cookie: str


def request_of_scope(scope: MutableMapping[str, Any]) -> Request:
    """Return the request that an ASGI scope describes."""
    pairs = [(name.decode("latin-1"), value.decode("latin-1")) for name, value in scope["headers"]]
    return Request(
        scope.get("method", "GET"),
        scope["path"],
        scope["query_string"].decode("latin-1"),
        merged_headers(pairs),
        scope["type"] == "websocket",
        (scope.get("client") or ("",))[0],
    )


def merged_headers(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return headers by lower-case name, repeated ones joined by ", " as HTTP allows."""
    headers: dict[str, str] = {}
    for name, value in pairs:
        key = name.lower()
        headers[key] = f"{headers[key]}, {value}" if key in headers else value
    return headers


def refusal(request: Request, policy: Policy, *, is_stop: bool = False) -> Refusal | None:
    """Return why a request is refused; None: it is admitted.

    Parameters
    ----------
    is_stop : whether the request can only stop the face, which needs no token on this computer.

    Raises
    ------
    ValueError
        For a query with too many fields.
    """
    if not _is_own_page(request, policy):
        hint = "scripts of this web page are not admitted; its origin is not in the face's YAML"
        return Refusal(HTTPStatus.FORBIDDEN, hint)
    needs_no_token = (is_stop or policy.token is None) and _is_from_this_computer(request)
    if needs_no_token and is_plain_host(request.headers.get("host", "")):
        return None
    if policy.token is not None and has_token(request, policy.token):
        return None
    if needs_no_token:
        return Refusal(HTTPStatus.FORBIDDEN, "this host name is not the face's; use its address")
    hint = "needs the token: `Authorization: Bearer TOKEN` or `?token=TOKEN`; docs/hardware.md"
    return Refusal(HTTPStatus.UNAUTHORIZED, hint)


def has_token(request: Request, token: str) -> bool:
    """Return whether a request has the token: in its query, header or cookie."""
    in_query = request.token_in_query
    if in_query is not None and is_same_token(in_query, token):
        return True
    scheme, _, given = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return is_same_token(given.strip(), token)
    name, value = cookie_of(token)
    try:
        cookies = SimpleCookie(request.headers.get("cookie", "").replace(", ", "; "))
    except CookieError:
        return False
    return name in cookies and is_same_token(cookies[name].value, value)


def cookie_of(token: str) -> tuple[str, str]:
    """Return name and value of the cookie that replaces the token; neither contains it.

    Another server of the same host may have another token, and so a cookie of another name.
    """
    digest = hmac.new(token.encode(), b"lipservo dashboard", hashlib.sha256).hexdigest()
    return f"lipservo_{digest[:8]}", digest[8:]


def redirect_to_cookie(request: Request, token: str) -> Redirect:
    """Return the redirect for a page's request with the token in its query.

    It leads to the same page without the token, and sets the cookie that replaces the token.
    """
    name, value = cookie_of(token)
    age = f"Max-Age={_YEAR_S}; Path=/; HttpOnly; SameSite=Strict"
    fields = parse_qsl(request.query, max_num_fields=_MOST_FIELDS)
    rest = [pair for pair in fields if pair[0] != "token"]
    # A path that begins with two slashes would name another host.
    path = "/" + request.path.lstrip("/\\")
    return Redirect(f"{path}?{urlencode(rest)}" if rest else path, f"{name}={value}; {age}")


def is_same_token(given: str, token: str) -> bool:
    """Return whether two tokens are equal, in a time independent of how much matches."""
    return hmac.compare_digest(given.encode("utf-8", "replace"), token.encode())


def is_plain_host(host: str) -> bool:
    """Return whether a `Host` header is an IP address or `localhost`, safe from DNS rebinding."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    return name.lower() == "localhost" or host_address(name) is not None


def _is_from_this_computer(request: Request) -> bool:
    return is_loopback(request.peer) and _FORWARDED.isdisjoint(request.headers)


def _is_own_page(request: Request, policy: Policy) -> bool:
    """Return whether a request is from a page of this server, of a listed origin, or from no page.

    Browsers state the page by `Origin`, and its relation to this server by `Sec-Fetch-Site`;
    other programs send neither. A link from any page may open one of this server's pages.
    """
    origin = request.headers.get("origin")
    if origin in policy.origins:
        return True
    if origin is not None:
        try:
            page = urlsplit(origin)
        except ValueError:
            return False
        own_host = request.headers.get("host", "").lower()
        if page.scheme not in ("http", "https") or page.netloc.lower() != own_host:
            return False
    fetch_site = request.headers.get("sec-fetch-site", "none")
    if fetch_site in ("none", "same-origin"):
        return True
    is_navigation = request.headers.get("sec-fetch-mode") == "navigate"
    is_document = request.headers.get("sec-fetch-dest") == "document"
    return request.is_page and is_navigation and is_document
