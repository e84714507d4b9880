"""The dashboard's API as an application of its own: errors are JSON, one line."""

import struct
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from fastapi import FastAPI
from fastapi.responses import HTMLResponse, Response
from fastapi.staticfiles import StaticFiles

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.web.api_errors import add_error_answers
from lipservo.dashboard.web.api_models import ErrorAnswer
from lipservo.dashboard.web.docs_page import docs_html
from lipservo.dashboard.web.face_routes import face_routes
from lipservo.dashboard.web.file_routes import file_routes
from lipservo.dashboard.web.metrics import CONTENT_TYPE, FaceCollector, metrics_text
from lipservo.dashboard.web.stream_routes import add_streams

_STATIC: Final = Path(__file__).parent.parent / "static"
_ERRORS: Final[dict[int | str, dict[str, Any]]] = {422: {"model": ErrorAnswer}}
_LENGTH: Final = struct.Struct("<H")


def make_api(link: FaceLink) -> FastAPI:
    """All of `/api`, `/docs`, `/metrics`, `/static`."""
    app = FastAPI(
        title="lipservo",
        version=version("lipservo"),
        docs_url=None,
        redoc_url=None,
        responses=_ERRORS,
    )
    add_error_answers(app)
    hubs = add_streams(app, link)
    app.include_router(face_routes(link))
    app.include_router(file_routes(link))
    collector = FaceCollector(link, lambda: {name: hub.n_clients for name, hub in hubs.items()})

    @app.get("/api/history", response_class=Response)
    async def history() -> Response:
        """The last frames of `/api/twin`, oldest first, each behind its length as u16."""
        frames = [_LENGTH.pack(len(frame)) + frame for frame in link.history]
        return Response(b"".join(frames), media_type="application/octet-stream")

    @app.get("/metrics", response_class=Response)
    async def metrics() -> Response:
        """For Prometheus."""
        return Response(metrics_text(collector), media_type=CONTENT_TYPE)

    @app.get("/docs", response_class=HTMLResponse, include_in_schema=False)
    async def docs() -> HTMLResponse:
        return HTMLResponse(docs_html(app.openapi()))

    app.mount("/static", _FreshFiles(directory=_STATIC), name="static")
    return app


class _FreshFiles(StaticFiles):
    """A browser asks each time whether its copy is still the newest, and mostly it is (304)."""

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        """With the header that says so."""
        answer = super().file_response(*args, **kwargs)
        answer.headers["cache-control"] = "no-cache"
        return answer
