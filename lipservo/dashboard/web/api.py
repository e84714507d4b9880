"""The dashboard's API as an application of its own, with `/docs`; errors are one line of JSON."""

import json
import struct
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any, Final

from fastapi import FastAPI
from fastapi.responses import HTMLResponse, Response
from fastapi.staticfiles import StaticFiles

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.first_hour.first_hour import FirstHour
from lipservo.dashboard.web.api_models import ErrorAnswer, add_error_answers
from lipservo.dashboard.web.api_routes import VERSION, face_routes, file_routes
from lipservo.dashboard.web.first_hour_routes import first_hour_routes
from lipservo.dashboard.web.metrics import CONTENT_TYPE, FaceCollector, metrics_text
from lipservo.dashboard.web.streams import add_streams

_STATIC: Final = Path(__file__).parent.parent / "static"
_ERRORS: Final[dict[int | str, dict[str, Any]]] = {422: {"model": ErrorAnswer}}
_LENGTH: Final = struct.Struct("<H")
_STYLE: Final = """
body{font:16px/1.5 system-ui,sans-serif;max-width:52rem;margin:2rem auto;padding:0 1rem}
h2{margin:2rem 0 .3rem;font-size:1.05rem;font-family:monospace}
b{display:inline-block;min-width:4.5rem}pre{background:#8882;padding:.6rem;overflow:auto}
"""


def make_api(link: FaceLink, hour: FirstHour | None = None) -> FastAPI:
    """Return the application of `/api`, `/docs`, `/metrics`, `/static`.

    hour: the setup of a new face, for its routes; None: the face is made already.
    """
    app = FastAPI(
        title="lipservo",
        version=VERSION,
        docs_url=None,
        redoc_url=None,
        responses=_ERRORS,
    )
    add_error_answers(app)
    streams = add_streams(app, link)
    app.include_router(face_routes(link))
    app.include_router(file_routes(link))
    if hour is not None:
        app.include_router(first_hour_routes(hour))
    collector = FaceCollector(link, lambda: {name: hub.n_clients for name, hub in streams.items()})

    @app.get("/api/history", response_class=Response)
    async def history() -> Response:
        """The last frames of `/api/twin`, oldest first, each behind its length as u16."""
        frames = [_LENGTH.pack(len(frame)) + frame for frame in link.history]
        return Response(b"".join(frames), media_type="application/octet-stream")

    @app.get("/metrics", response_class=Response)
    async def metrics() -> Response:
        """Return the metrics for Prometheus."""
        return Response(metrics_text(collector), media_type=CONTENT_TYPE)

    @app.get("/docs", response_class=HTMLResponse, include_in_schema=False)
    async def docs() -> HTMLResponse:
        return HTMLResponse(docs_html(app.openapi()))

    app.mount("/static", _FreshFiles(directory=_STATIC), name="static")
    return app


class _FreshFiles(StaticFiles):
    """Static files that a browser revalidates at each request; most answers are 304, unchanged."""

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        """Return a file's response with the header `cache-control: no-cache`."""
        answer = super().file_response(*args, **kwargs)
        answer.headers["cache-control"] = "no-cache"
        return answer


def docs_html(openapi: Mapping[str, Any]) -> str:
    """Return an HTML page of every path in an OpenAPI schema: description, parameters, body."""
    name = escape(str(openapi["info"]["title"]))
    operations = "".join(_operations_html(openapi))
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{name}: API</title>"
        f"<style>{_STYLE}</style><h1>{name}: API</h1>"
        "<p>The same as <a href=/openapi.json>OpenAPI</a>. Errors are "
        '<code>{"error": "one line"}</code>. Streams: WebSockets <code>/api/state</code> (JSON) '
        "and <code>/api/twin</code> (binary); <a href=/metrics>/metrics</a> is for Prometheus."
        f"</p>{operations}</html>"
    )


def _operations_html(openapi: Mapping[str, Any]) -> Iterator[str]:
    """Yield HTML of each operation of an OpenAPI schema: method, path, description, input."""
    for path, methods in openapi["paths"].items():
        for method, operation in methods.items():
            description = escape(operation.get("description", ""))
            yield f"<h2><b>{escape(method.upper())}</b>{escape(path)}</h2><p>{description}</p>"
            parameters = operation.get("parameters", ())
            if parameters:
                names = ", ".join(f"{each['name']} ({each['in']})" for each in parameters)
                yield f"<p>takes {escape(names)}</p>"
            body = operation.get("requestBody", {}).get("content", {}).get("application/json")
            if body:
                schema_text = json.dumps(_inlined(body["schema"], openapi), indent=1)
                yield f"<pre>{escape(schema_text)}</pre>"


def _inlined(schema: Any, openapi: Mapping[str, Any]) -> Any:
    """Return a schema without titles, each `$ref` replaced by what it refers to."""
    if isinstance(schema, list):
        return [_inlined(each, openapi) for each in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return _inlined(openapi["components"]["schemas"][name], openapi)
    return {key: _inlined(value, openapi) for key, value in schema.items() if key != "title"}
