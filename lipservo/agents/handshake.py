"""What becomes of a connection to the agent server, by its HTTP request.

The policy is `lipservo/access/admission.py`, which the dashboard's server has too; here are the
paths, the number of clients, and the way in that a stop always has.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Final
from urllib.parse import urlsplit

from lipservo.access.admission import Refusal, Request, merged_headers, refusal
from lipservo.agents.agent_settings import AgentSettings

STREAM_PATH, CONTROL_PATH = "/stream", "/control"
#: Answered to a plain GET, for programs that watch over a service.
HEALTH_PATHS: Final = frozenset({"/", "/status"})


@dataclass(frozen=True, slots=True)
class Handshake:
    """refused: an HTTP answer instead of a WebSocket. may_only_stop: why a client may no more."""

    refused: Refusal | None = None
    may_only_stop: Refusal | None = None


def request_of(target: str, headers: Iterable[tuple[str, str]], peer: str) -> Request:
    """The request for a WebSocket. target: of its first line. Raises ValueError."""
    split = urlsplit(target)
    merged = merged_headers(headers)
    is_websocket = merged.get("upgrade", "").lower() == "websocket"
    return Request("GET", split.path, split.query, merged, is_websocket, peer)


def handshake(request: Request, settings: AgentSettings, n_connected: int) -> Handshake:
    """Decide about a request: full access, none, or a stop and nothing else.

    `/control` is open to a stop where everything else would be refused for a missing token on this
    computer, or because there are too many clients.
    """
    refused = _refused(request, settings, n_connected)
    if refused is None or request.path != CONTROL_PATH or not request.is_websocket:
        return Handshake(refused)
    if refusal(request, settings.policy, is_stop=True) is None:
        return Handshake(None, may_only_stop=refused)
    return Handshake(refused)


def _refused(request: Request, settings: AgentSettings, n_connected: int) -> Refusal | None:
    refused = refusal(request, settings.policy)
    if refused is not None:
        return refused
    if request.path in HEALTH_PATHS and "upgrade" not in request.headers:
        return None
    if request.path not in (STREAM_PATH, CONTROL_PATH):
        return Refusal(HTTPStatus.NOT_FOUND, f"there are {STREAM_PATH} and {CONTROL_PATH}")
    if not request.is_websocket:
        return Refusal(HTTPStatus.UPGRADE_REQUIRED, "this is a WebSocket; use ws://")
    if n_connected >= settings.most_connections:
        most = f"{settings.most_connections} clients are connected already"
        return Refusal(HTTPStatus.SERVICE_UNAVAILABLE, most)
    return None
