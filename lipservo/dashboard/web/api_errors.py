"""Whatever goes wrong is told as {"error": one line}, with the status that fits."""

import logging
from typing import Any, Final

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from lipservo.client.face_answers import FaceError

#: By the code of a `FaceError`; those of an agent server that are not here say that it is busy.
_STATUS_OF: Final = {
    "refused": 422,
    "bad_message": 422,
    "not_found": 404,
    "exists": 409,
    "not_available": 409,
    "too_large": 413,
    "not_sound": 415,
    "not_saved": 409,
    "not_answering": 503,
    "disconnected": 503,
}
_BUSY: Final = 503
_LONGEST: Final = 300


def add_error_answers(app: FastAPI) -> None:
    """Answer every error of an application in JSON."""

    async def of_face(_request: Request, error: Exception) -> JSONResponse:
        code = getattr(error, "code", "")
        return _answer(_STATUS_OF.get(code, _BUSY), str(error))

    async def of_body(_request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"] if part != "body")
        if first["type"] == "json_invalid":
            return _answer(400, "the body is no JSON")
        return _answer(422, f"{where}: {first['msg']}" if where else str(first["msg"]))

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


def _answer(status: int, text: str, headers: Any = None) -> JSONResponse:
    line = " ".join(text.split())[:_LONGEST]
    line = line.encode("utf-8", "replace").decode()
    return JSONResponse({"error": line}, status, headers)
