"""The dashboard as one ASGI application: stop, policy, and within these the API and the pages."""

import contextlib
import os
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

from fastapi import FastAPI

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.twin.routes import twin_routes
from lipservo.dashboard.web.access_layer import AccessLayer, OneTimeCode
from lipservo.dashboard.web.api import make_api
from lipservo.dashboard.web.asgi import App, Receive, Scope, Send
from lipservo.dashboard.web.stop_route import StopRoute
from lipsync.face.model import load_face

#: What the API answers; everything else is a page.
_OF_THE_API: Final = ("/api", "/docs", "/openapi.json", "/metrics", "/static")


class _Parted:
    """Two applications, by path. app: the pages', which also begins and ends with the server."""

    def __init__(self, api: App, pages: App) -> None:
        self.app = pages
        self._api = api

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        path = scope.get("path", "")
        is_api = any(path == each or path.startswith(f"{each}/") for each in _OF_THE_API)
        app = self._api if is_api and scope["type"] != "lifespan" else self.app
        await app(scope, receive, send)


def make_app(
    link: FaceLink,
    token: str | None,
    model: Path | None = None,
    code: OneTimeCode | None = None,
) -> App:
    """The whole dashboard of one face; the link runs while it does.

    Of one process: NiceGUI has one set of pages. model: the face model that the face runs with,
    whose components move the twin; None: the shipped one. token: see `Policy`. code: that the
    first browser is started with. Raises ModelError.
    """
    # FastAPI would send what it measures to wherever the environment says.
    os.environ["OTEL_SDK_DISABLED"] = "true"

    @contextlib.asynccontextmanager
    async def running(_app: FastAPI) -> AsyncIterator[None]:
        async with link.running():
            yield

    # Nothing of a page is kept on disk; where NiceGUI would, it is no folder of the user's.
    os.environ.setdefault("NICEGUI_STORAGE_PATH", os.path.join(tempfile.gettempdir(), "nicegui"))
    from nicegui import ui

    from lipservo.dashboard.pages.pages import build_pages

    pages = FastAPI(openapi_url=None, docs_url=None, redoc_url=None, lifespan=running)
    twin_routes(pages, load_face(model))
    build_pages(link)
    ui.run_with(pages, title="lipservo", show_welcome_message=False, tailwind=False)
    return with_access(_Parted(make_api(link), pages), link, token, code)


def with_access(
    app: App, link: FaceLink, token: str | None, code: OneTimeCode | None = None
) -> App:
    """An application behind its policy, and before both the stop."""
    return StopRoute(AccessLayer(app, token, lambda: link.origins, code), link, token)
