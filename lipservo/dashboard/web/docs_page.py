"""`/docs`: the API's OpenAPI description as a plain page, which loads nothing."""

import json
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any, Final

_STYLE: Final = """
body{font:16px/1.5 system-ui,sans-serif;max-width:52rem;margin:2rem auto;padding:0 1rem}
h2{margin:2rem 0 .3rem;font-size:1.05rem;font-family:monospace}
b{display:inline-block;min-width:4.5rem}pre{background:#8882;padding:.6rem;overflow:auto}
"""


def docs_html(openapi: Mapping[str, Any]) -> str:
    """Every path with what it takes, and how to call it."""
    name = escape(str(openapi["info"]["title"]))
    operations = "".join(_operations(openapi))
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{name}: API</title>"
        f"<style>{_STYLE}</style><h1>{name}: API</h1>"
        "<p>The same as <a href=/openapi.json>OpenAPI</a>. Errors are "
        '<code>{"error": "one line"}</code>. Streams: WebSockets <code>/api/state</code> (JSON) '
        "and <code>/api/twin</code> (binary); <a href=/metrics>/metrics</a> is for Prometheus."
        f"</p>{operations}</html>"
    )


def _operations(openapi: Mapping[str, Any]) -> Iterator[str]:
    for path, methods in openapi["paths"].items():
        for method, operation in methods.items():
            told = escape(operation.get("description", ""))
            yield f"<h2><b>{escape(method.upper())}</b>{escape(path)}</h2><p>{told}</p>"
            given = operation.get("parameters", ())
            if given:
                names = ", ".join(f"{each['name']} ({each['in']})" for each in given)
                yield f"<p>takes {escape(names)}</p>"
            body = operation.get("requestBody", {}).get("content", {}).get("application/json")
            if body:
                shown = json.dumps(_resolved(body["schema"], openapi), indent=1)
                yield f"<pre>{escape(shown)}</pre>"


def _resolved(schema: Any, openapi: Mapping[str, Any]) -> Any:
    """The schema with what it refers to in place; ours do not refer to themselves."""
    if isinstance(schema, list):
        return [_resolved(each, openapi) for each in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return _resolved(openapi["components"]["schemas"][name], openapi)
    return {key: _resolved(value, openapi) for key, value in schema.items() if key != "title"}
