"""The dashboard of one face as one ASGI application and one process that serves it.

Its layers, from the outermost: the route of stops, the access policy, the API and the pages.
"""

import contextlib
import os
import socket
import tempfile
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Final

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from lipservo.access.doorway import ACCEPTED, BACKLOG, HEAD_S, MOST_HEADS, Doorway, scaled
from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.first_hour.first_hour import FirstHour
from lipservo.dashboard.web.access_layer import (
    AccessLayer,
    App,
    OneTimeCode,
    Receive,
    RequestLimit,
    Scope,
    Send,
)
from lipservo.dashboard.web.api import make_api
from lipservo.dashboard.web.stop_route import StopRoute, http_connections
from lipsync.face.model import load_face

#: Paths, with all below them, that the API answers; every other one is a page.
_API_PATHS: Final = ("/api", "/docs", "/openapi.json", "/metrics", "/static")
#: WebSocket clients get a ping so often, and have so long to answer it.
_PING_S: Final = 4.0
_MOST_MESSAGE_BYTES: Final = 1 << 20
#: Stops that wait for their answer; beyond that, the oldest of them is aborted.
_MOST_STOPS: Final = 32
_CLOSING_S: Final = 1.0


class _ApiOrPages:
    """An ASGI application that passes requests, by path, to the API or to `app`, the pages."""

    def __init__(self, api: App, pages: App) -> None:
        self.app = pages
        self._api = api

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        path = scope.get("path", "")
        is_api = any(path == each or path.startswith(f"{each}/") for each in _API_PATHS)
        app = self._api if is_api and scope["type"] != "lifespan" else self.app
        await app(scope, receive, send)


def make_app(
    link: FaceLink,
    token: str | None,
    model: Path | None = None,
    code: OneTimeCode | None = None,
    hour: FirstHour | None = None,
) -> App:
    """Return the whole dashboard of one face as an application; `link` runs while it does.

    Once in a process: NiceGUI has one set of pages. model: the face model that the face runs with,
    whose components move the twin; None: the shipped one. token: see `Policy`. code: in the URL
    that the first browser is started with. hour: the setup of a new face. Raises ModelError.
    """
    # Otherwise FastAPI sends telemetry to an endpoint set in the environment.
    os.environ["OTEL_SDK_DISABLED"] = "true"

    @contextlib.asynccontextmanager
    async def running(_app: FastAPI) -> AsyncIterator[None]:
        async with link.running():
            yield

    # No page stores anything; if NiceGUI does, it is not in the working folder.
    os.environ.setdefault("NICEGUI_STORAGE_PATH", os.path.join(tempfile.gettempdir(), "nicegui"))
    from nicegui import ui

    from lipservo.dashboard.pages.pages import build_pages
    from lipservo.dashboard.twin.element import twin_routes
    from lipservo.dashboard.web.photo_routes import photo_routes

    pages = FastAPI(openapi_url=None, docs_url=None, redoc_url=None, lifespan=running)
    face = load_face(model)
    twin_routes(pages, face)
    photo_routes(pages, face)
    build_pages(link, None if hour is None else hour.path)
    ui.run_with(pages, title="lipservo", show_welcome_message=False, tailwind=False)
    return with_access(_ApiOrPages(make_api(link, hour), pages), link, token, code)


def with_access(
    app: App, link: FaceLink, token: str | None, code: OneTimeCode | None = None
) -> App:
    """Return `app` within the access policy, a limit of requests, and the route of stops.

    token, code: as for `make_app`.
    """
    admitted = AccessLayer(app, token, lambda: link.origins, code)
    return StopRoute(RequestLimit(admitted), link, token)


class _BoundedSocket(WebSocketsSansIOProtocol):
    """A WebSocket whose client is disconnected when it answers no ping, even with data unsent."""

    def keepalive_timeout(self) -> None:
        """Abort the connection of a client that did not answer a ping."""
        super().keepalive_timeout()
        self.transport.abort()


def serve(
    listener: socket.socket,
    link: FaceLink,
    token: str | None,
    on_ready: Callable[[], None],
    model: Path | None = None,
    code: OneTimeCode | None = None,
    hour: FirstHour | None = None,
) -> None:
    """Serve the dashboard until a signal ends it. on_ready: called once clients can connect.

    token, model, code, hour: as for `make_app`. Raises ModelError.
    """
    server_of(make_app(link, token, model, code, hour), on_ready).run([listener])


def server_of(
    app: App, on_ready: Callable[[], None] = lambda: None, ping_s: float = _PING_S
) -> uvicorn.Server:
    """Return a server of `app` with its limits; it is not running yet.

    on_ready: called once clients can connect. ping_s: WebSocket clients get a ping so often, and
    are dropped if they do not answer within as long.
    """
    config = uvicorn.Config(
        app,
        ws=_BoundedSocket,
        ws_max_size=_MOST_MESSAGE_BYTES,
        ws_ping_interval=ping_s,
        ws_ping_timeout=ping_s,
        ws_per_message_deflate=False,
        http=http_connections(Doorway(MOST_HEADS, HEAD_S), Doorway(_MOST_STOPS)),
        loop="asyncio",  # which accepts `backlog` connections at a time before it reads
        backlog=scaled(ACCEPTED),
        timeout_graceful_shutdown=round(_CLOSING_S),
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        lifespan="on",
    )
    return _ReadyServer(config, on_ready)


class _ReadyServer(uvicorn.Server):
    def __init__(self, config: uvicorn.Config, on_ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_ready = on_ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets=sockets)
        for listener in sockets or ():
            listener.listen(BACKLOG)
        if self.started:
            self._on_ready()
