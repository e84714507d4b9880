"""Who may connect, told by the HTTP request: path, host, origin, token, and how many there are.

Scripts of any web page reach 127.0.0.1 from a browser on this computer, and a page can make its own
name lead there. So a page is asked for by its origin, and a face that asks for no token answers to
names of this computer and to plain addresses alone.
"""

import hmac
import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import Final
from urllib.parse import parse_qs, urlsplit

from lipservo.agents.agent_settings import AgentSettings

STREAM_PATH, CONTROL_PATH = "/stream", "/control"
#: Answered to a plain GET, for whoever watches over the service.
HEALTH_PATHS: Final = frozenset({"/", "/status"})

#: Of a query; there is one.
_MOST_FIELDS: Final = 16


@dataclass(frozen=True, slots=True)
class Refusal:
    """An HTTP answer instead of a WebSocket: one line."""

    status: HTTPStatus
    text: str


def refusal(
    target: str, headers: Mapping[str, str], settings: AgentSettings, n_connected: int
) -> Refusal | None:
    """Why a request is turned away; None: it may come in.

    target: of the request line, with its query. headers: `Host`, `Origin`, `Authorization`,
    `Upgrade`, each empty where it is not given.
    """
    try:
        path, given = _path_and_token(target)
    except ValueError:
        return Refusal(HTTPStatus.BAD_REQUEST, "the request line has no path that can be read")
    if not _is_host_ours(headers["Host"], settings):
        return Refusal(HTTPStatus.FORBIDDEN, "this host name is not the face's; use its address")
    if headers["Origin"] and not _is_allowed(headers["Origin"], settings):
        return Refusal(HTTPStatus.FORBIDDEN, "web pages of this origin are not allowed here")
    if settings.token is not None and not _is_token(settings.token, given, headers):
        hint = "send the token as `Authorization: Bearer TOKEN` or `?token=TOKEN`"
        return Refusal(HTTPStatus.UNAUTHORIZED, hint)
    if path in HEALTH_PATHS and not headers["Upgrade"]:
        return None
    if path not in (STREAM_PATH, CONTROL_PATH):
        return Refusal(HTTPStatus.NOT_FOUND, f"there are {STREAM_PATH} and {CONTROL_PATH}")
    if headers["Upgrade"].lower() != "websocket":
        return Refusal(HTTPStatus.UPGRADE_REQUIRED, "this is a WebSocket; use ws://")
    if n_connected >= settings.most_connections:
        most = f"{settings.most_connections} clients are connected already"
        return Refusal(HTTPStatus.SERVICE_UNAVAILABLE, most)
    return None


def is_loopback(host: str) -> bool:
    """Whether a host, by name or address, is this computer seen from itself."""
    address = _address(host)
    return host.lower() == "localhost" if address is None else address.is_loopback


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def host_of(url: str) -> str:
    """The host that a URL names; empty where it names none."""
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return ""


def is_plain_host(host: str) -> bool:
    """Whether a `Host` header is an address or this computer: no page makes that lead elsewhere."""
    name = host_of(f"//{host}")
    return is_loopback(name) or _address(name) is not None


def is_same_token(given: str, token: str) -> bool:
    """Compared in a time that tells nothing of how much of it was right."""
    return hmac.compare_digest(given.encode("utf-8", "replace"), token.encode())


def bearer_token(authorization: str) -> str | None:
    """What a header `Authorization: Bearer TOKEN` gives; None: it is no such header."""
    scheme, _, given = authorization.partition(" ")
    return given.strip() if scheme.lower() == "bearer" else None


def _is_host_ours(host: str, settings: AgentSettings) -> bool:
    return is_plain_host(host) or not host or settings.token is not None


def _is_allowed(origin: str, settings: AgentSettings) -> bool:
    return origin in settings.allowed_origins or is_loopback(host_of(origin))


def _path_and_token(target: str) -> tuple[str, str]:
    """Of a request's target. Raises ValueError."""
    split = urlsplit(target)
    return split.path, parse_qs(split.query, max_num_fields=_MOST_FIELDS).get("token", [""])[0]


def _is_token(token: str, in_query: str, headers: Mapping[str, str]) -> bool:
    given = bearer_token(headers["Authorization"])
    return is_same_token(in_query if given is None else given, token)
