"""Errors of the API: {"error": one line}, with the status that fits."""

import logging
from collections.abc import Sequence
from typing import Any, Final

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from lipservo_client.face_answers import FaceError
from starlette.exceptions import HTTPException

#: By the code of a `FaceError`; those of an agent server that are not here say that it is busy.
_STATUS_OF: Final = {
    "refused": 422,
    "bad_message": 422,
    "not_found": 404,
    "exists": 409,
    "not_available": 409,
    "too_large": 413,
    "not_sound": 415,
    "stalled": 408,
    "not_saved": 409,
    "not_answering": 503,
    "disconnected": 503,
}
_BUSY: Final = 503
_LONGEST: Final = 300


def add_error_answers(app: FastAPI) -> None:
    """Answer every error of an application in JSON."""

    async def of_face(_request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, FaceError)
        return _answer(status_of(error), str(error))

    async def of_body(_request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        if error.errors()[0]["type"] == "json_invalid":
            return _answer(400, "the body is no JSON")
        return _answer(422, first_error(error.errors()))

    async def of_http(_request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)
        return _answer(error.status_code, str(error.detail), error.headers)

    async def of_ours(_request: Request, error: Exception) -> JSONResponse:
        logging.getLogger("lipservo.dashboard").error("a fault of ours", exc_info=error)
        return _answer(500, f"a fault of the dashboard's: {type(error).__name__}")

    app.add_exception_handler(FaceError, of_face)
    app.add_exception_handler(RequestValidationError, of_body)
    app.add_exception_handler(HTTPException, of_http)
    app.add_exception_handler(Exception, of_ours)


def status_of(error: FaceError) -> int:
    """The HTTP status of what a face refuses."""
    return _STATUS_OF.get(error.code, _BUSY)


def first_error(errors: Sequence[Any]) -> str:
    """One line of pydantic's: where in the body, and what."""
    where = ".".join(str(part) for part in errors[0]["loc"] if part != "body")
    return f"{where}: {errors[0]['msg']}" if where else str(errors[0]["msg"])


def _answer(status: int, text: str, headers: Any = None) -> JSONResponse:
    line = " ".join(text.split())[:_LONGEST]
    line = line.encode("utf-8", "replace").decode()
    return JSONResponse({"error": line}, status, headers)
