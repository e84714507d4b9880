"""The server of a study: a page for raters, which gets items one by one and sends the answers.

It reads what raters may see and the answers, never the key. Every request needs the study's token,
which is not that of a face: a rater cannot move a robot.
"""

import json
import os
import secrets
from collections.abc import Awaitable, Callable, Mapping
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from lipservo.access.admission import (
    Policy,
    is_same_token,
    redirect_to_cookie,
    refusal,
    request_of_scope,
)
from lipservo.dashboard.web.access_layer import (
    SECURITY_HEADERS,
    App,
    Message,
    Receive,
    RequestLimit,
    Scope,
    Send,
    answer_bytes,
    answer_json,
)
from lipservo_lab.study.answers import (
    MOST_CHARACTERS,
    AlreadyAnsweredError,
    AnswerFile,
    RaterRecord,
    Record,
    UnknownRaterError,
)
from lipservo_lab.study.sheets import CLIPS, FIRST, POINTS, SECOND, Item, Study, StudyError

TOKEN_FILE: Final = "token"
#: Labels of the points, from worst to best; the paper's raters too rated naturalness in five
#: points.
SCALE: Final = ("not at all natural", "hardly", "halfway", "fairly", "completely natural")
assert len(SCALE) == POINTS
_MOST_BODY_BYTES: Final = 8192
_MOST_S: Final = 1e6
_MOST_PLAYS: Final = 1000
_RATER_CHARACTERS: Final = 12
_NO_TOKEN: Final = (
    "<!doctype html><meta charset=utf-8><meta name=viewport content='width=device-width'>"
    "<title>Study</title><p style='font:1.1rem/1.5 system-ui;max-width:36rem;margin:3rem auto;"
    "padding:0 1rem'>This page needs the whole address that the person who runs the study gave "
    "you. It ends in <code>?token=…</code>"
)
_PAGE: Final = files("lipservo_lab.study.page")
_KINDS: Final = {"study.js": "text/javascript", "study.css": "text/css", "index.html": "text/html"}


class RequestError(StudyError):
    """A request that is invalid, by an error of the page or of another program."""


class StudyDesk:
    """The answers to what raters request; one for a server.

    minutes: that a rater will need, for the first page.
    """

    def __init__(self, study: Study, answers: AnswerFile, minutes: int) -> None:
        self.study = study
        self._answers = answers
        self._minutes = minutes

    def about(self) -> Mapping[str, Any]:
        """Return what the first page shows."""
        return {
            "identity": self.study.identity,
            "title": self.study.title,
            "consent": self.study.consent.replace("MINUTES", str(self._minutes)),
            "scale": SCALE,
            "vocabulary": self.study.vocabulary,
        }

    def join(self, given: Any) -> Mapping[str, Any]:
        """Let a rater who agrees join; return the first item that the rater has not answered.

        given: JSON with `rater` and `agrees`. Raises RequestError.
        """
        name = given.get("rater")
        if given.get("agrees") is not True:
            raise RequestError("a rater must agree before taking part")
        if not isinstance(name, str) or len(name) != _RATER_CHARACTERS or not name.isalnum():
            raise RequestError(f"rater: {_RATER_CHARACTERS} letters and digits are needed")
        return self._next(self._answers.join(name, len(self.study.sheets)))

    def next_item(self, name: str) -> Mapping[str, Any]:
        """Return the first item that a rater has not answered; its number is None when all are."""
        return self._next(self._answers.rater(name))

    def answer(self, name: str, given: Any) -> Mapping[str, Any]:
        """Store an answer; return the next item.

        given: JSON with `number`, `answer`, `seconds` and `plays`. Raises RequestError for invalid
        values, and what `AnswerFile.answer` raises.
        """
        rater = self._answers.rater(name)
        number = given.get("number")
        items = self.study.sheets[rater.sheet]
        if not _is_whole(number, 0, len(items) - 1):
            raise RequestError(f"number must be 0 to {len(items) - 1}")
        self._answers.answer(name, number, _checked(items[number], given))
        return self._next(rater)

    def leave(self, name: str, _given: Any) -> Mapping[str, Any]:
        """Note that a rater leaves: none of that rater's answers count."""
        self._answers.leave(name)
        return {"left": True}

    def _next(self, rater: RaterRecord) -> Mapping[str, Any]:
        """Return the first item that a rater has not answered; number None: there is none.

        A rater who has left has none.
        """
        items = self.study.sheets[rater.sheet]
        number = next((n for n in range(len(items)) if n not in rater.answers), None)
        if number is None or rater.has_left:
            return {"number": None, "of": len(items)}
        item = items[number]
        shown = {"kind": item.kind, "clips": item.clips, "expected": item.expected}
        return {"number": number, "of": len(items), **shown}


def _is_whole(value: object, low: int, high: int) -> bool:
    """Return whether a JSON value is an integer from `low` to `high`."""
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _checked(item: Item, fields: Any) -> Record:
    """Check an answer to an item; return the fields to store. Raises RequestError."""
    answer, seconds, plays = (fields.get(key) for key in ("answer", "seconds", "plays"))
    is_number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    if not is_number or not 0 <= seconds < _MOST_S or not _is_whole(plays, 0, _MOST_PLAYS):
        raise RequestError("seconds and plays must be numbers: time taken, times played")
    match item.kind:
        case "pair":
            is_valid = answer in (FIRST, SECOND)
        case "reading":
            is_valid = isinstance(answer, str) and len(answer) <= MOST_CHARACTERS
        case "sound":
            is_valid = answer == item.expected
        case _:
            is_valid = _is_whole(answer, 1, POINTS)
    if not is_valid:
        raise RequestError(f"this answer does not fit a {item.kind}")
    return {"answer": answer, "seconds": seconds, "plays": plays}


def study_app(desk: StudyDesk, folder: Path, token: str) -> App:
    """Return the whole server as an ASGI application.

    folder: of the study, with its clips. token: required in every request.
    """

    async def about(_request: Request) -> Response:
        return JSONResponse(desk.about())

    async def join(request: Request) -> Response:
        return await _reply(desk.join, await _body(request))

    async def next_item(request: Request) -> Response:
        return await _reply(desk.next_item, request.path_params["rater"])

    async def answer(request: Request) -> Response:
        return await _reply(desk.answer, request.path_params["rater"], await _body(request))

    async def leave(request: Request) -> Response:
        return await _reply(desk.leave, request.path_params["rater"], await _body(request))

    async def clip(request: Request) -> Response:
        name = request.path_params["name"]
        path = folder / CLIPS / f"{name}.mp4"
        if name not in desk.study.duration_s or not path.is_file():
            return JSONResponse({"error": f"clip {name} is missing"}, HTTPStatus.NOT_FOUND)
        return FileResponse(path, media_type="video/mp4")

    routes = [
        Route("/api/study", about),
        Route("/api/raters", join, methods=["POST"]),
        Route("/api/raters/{rater}", next_item),
        Route("/api/raters/{rater}/answers", answer, methods=["POST"]),
        Route("/api/raters/{rater}/leave", leave, methods=["POST"]),
        Route("/clips/{name}.mp4", clip),
        *(Route(f"/{name}", _file_of_page(name)) for name in ("study.js", "study.css")),
        Route("/", _file_of_page("index.html")),
    ]
    return RequestLimit(_TokenLayer(Starlette(routes=routes), token))


def _file_of_page(name: str) -> Callable[[Request], Awaitable[Response]]:
    """Return an endpoint that serves a file of the page; the file is read once, here."""
    content = (_PAGE / name).read_bytes()

    async def serve(_request: Request) -> Response:
        headers = {"cache-control": "no-cache"}
        return Response(content, media_type=_KINDS[name], headers=headers)

    return serve


async def _body(request: Request) -> Any:
    """Return the JSON object in a request's body; None for anything else, or more than 8 kB."""
    content = b""
    async for chunk in request.stream():
        content += chunk
        if len(content) > _MOST_BODY_BYTES:
            return None
    try:
        found = json.loads(content)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


async def _reply(call: Callable[..., Mapping[str, Any]], *given: Any) -> Response:
    """Run a call in a thread; return its result as JSON, or its error as one line with a status.

    given: arguments of the call; the last one None: the request's body was invalid.
    """
    status = HTTPStatus.OK
    try:
        if given[-1] is None:
            raise RequestError("the body must be one JSON object of at most 8 kB")
        # Answers are written to the disk before they are confirmed; other requests must not wait.
        answer = await run_in_threadpool(call, *given)
    except UnknownRaterError as error:
        status, answer = HTTPStatus.NOT_FOUND, {"error": str(error)}
    except AlreadyAnsweredError as error:
        status, answer = HTTPStatus.CONFLICT, {"error": str(error)}
    except RequestError as error:
        status, answer = HTTPStatus.UNPROCESSABLE_ENTITY, {"error": str(error)}
    except StudyError as error:
        hint = f"{error}. Please tell the person who runs the study; this page tries again."
        status, answer = HTTPStatus.INSUFFICIENT_STORAGE, {"error": hint}
    return JSONResponse(answer, status, headers={"cache-control": "no-store"})


class _TokenLayer:
    """Passes on requests with the token; a page opened with the token gets a cookie instead."""

    def __init__(self, app: App, token: str) -> None:
        self.app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on if it has the token; else refuse it, on the first page in words.

        A page that is opened with the token in its address is redirected, and gets a cookie
        instead. Scopes other than HTTP are passed on unchecked.
        """
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        try:
            request = request_of_scope(scope)
            refused = refusal(request, Policy(self._token))
            token = request.token_in_query
        except ValueError:
            await answer_json(send, HTTPStatus.BAD_REQUEST, {"error": "cannot be read"})
            return
        if refused is not None and request.is_page and request.path == "/":
            headers = [(b"content-type", b"text/html; charset=utf-8")]
            await answer_bytes(send, refused.status, headers, _NO_TOKEN.encode())
        elif refused is not None:
            await answer_json(send, refused.status, {"error": refused.text})
        elif request.is_page and token is not None and is_same_token(token, self._token):
            redirect = redirect_to_cookie(request, self._token)
            headers = [(b"location", redirect.location.encode("latin-1", "replace"))]
            headers += [(b"set-cookie", redirect.cookie.encode()), (b"cache-control", b"no-store")]
            await answer_bytes(send, HTTPStatus.SEE_OTHER, headers, b"")
        else:
            await self.app(scope, receive, _with_headers(send))


def _with_headers(send: Send) -> Send:
    """Return `send` with security headers added to the start of each response."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], *SECURITY_HEADERS]
        await send(message)

    return sent


def study_token(folder: Path) -> str:
    """Return the token of a study; it is made at the first start.

    Only its owner can read the file. Raises StudyError for a file that cannot be used.
    """
    path = folder / TOKEN_FILE
    try:
        if not path.exists():
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "w", encoding="ascii") as file:
                file.write(secrets.token_urlsafe(12) + "\n")
        token = path.read_text("ascii").strip()
    except (OSError, ValueError) as error:
        raise StudyError(f"{path}: cannot be used as a token: {error}") from error
    if not token:
        raise StudyError(f"{path}: is empty; delete it, and start again")
    return token


def minutes_of(study: Study) -> int:
    """Estimate how many minutes a rater takes: the clips, and a time for each answer."""
    thinking_s = {"reading": 15.0, "sound": 15.0, "rating": 5.0, "pair": 6.0, "check": 3.0}
    seconds = sum(
        thinking_s[item.kind] + sum(study.duration_s[clip] for clip in item.clips)
        for item in study.sheets[0]
    )
    return max(1, round(seconds / 60.0))
