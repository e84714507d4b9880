"""One process that serves the dashboard of one face."""

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Final

import uvicorn
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.web.access_layer import OneTimeCode
from lipservo.dashboard.web.asgi import App
from lipservo.dashboard.web.dashboard_app import make_app

#: Frames that the kernel may hold for a client that does not read; by itself it takes megabytes.
_KERNEL_BYTES: Final = 1 << 16
#: A client is asked so often whether it is there, and has so long to answer.
_PING_S: Final = 4.0
_MOST_MESSAGE_BYTES: Final = 1 << 20
_MOST_CONNECTIONS: Final = 256
_CLOSING_S: Final = 1.0


class _BoundedSocket(WebSocketsSansIOProtocol):
    """Is hung up on when it gives no sign of life, whatever waits to be sent to it."""

    def keepalive_timeout(self) -> None:
        """No answer to a ping."""
        super().keepalive_timeout()
        self.transport.abort()


def serve(
    listener: socket.socket,
    link: FaceLink,
    token: str | None,
    on_ready: Callable[[], None],
    model: Path | None = None,
    code: OneTimeCode | None = None,
) -> None:
    """Serve until a signal ends it. link: to the face; on_ready: called once it can.

    token, code: as `make_app`. model: that the face runs with. Raises ModelError.
    """
    app = make_app(link, token, model, code)
    server_of(app, on_ready).run([bounded(listener)])


def bounded(listener: socket.socket) -> socket.socket:
    """The same, whose connections hold little that was not read."""
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BYTES)
    return listener


def server_of(
    app: App, on_ready: Callable[[], None] = lambda: None, ping_s: float = _PING_S
) -> uvicorn.Server:
    """A server with every bound that is ours. ping_s: so long a client may give no sign of life."""
    config = uvicorn.Config(
        app,
        ws=_BoundedSocket,
        ws_max_size=_MOST_MESSAGE_BYTES,
        ws_ping_interval=ping_s,
        ws_ping_timeout=ping_s,
        ws_per_message_deflate=False,
        limit_concurrency=_MOST_CONNECTIONS,
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
        if self.started:
            self._on_ready()
