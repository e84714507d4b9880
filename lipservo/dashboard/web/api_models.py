"""Bodies of API requests, checked before a face gets them, and the error answers.

An error answer is {"error": one line}, with the HTTP status that fits.
"""

import logging
from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from lipservo_client.protocol import FaceError
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException

from firmware_bridge.joints import LONGEST_FOUND_US, SHORTEST_FOUND_US
from lipservo.settings.found_limits import PulseLimit
from lipsync.text_to_speech.synthesis import FASTEST_WPM, HIGHEST_PITCH, SLOWEST_WPM

_Name = Annotated[str, Field(min_length=1, max_length=64)]
Pulse = Annotated[float, Field(ge=SHORTEST_FOUND_US, le=LONGEST_FOUND_US)]
_Number = Annotated[float, Field(ge=-1e6, le=1e6)]
#: HTTP status by the code of a `FaceError`. Codes that are not listed, all of an agent server, mean
#: that it is busy.
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


class Body(BaseModel):
    """The base of all bodies: no unknown field, no conversion between types, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class StopBody(Body):
    """soft: to rest, then limp; freeze: held where it is; limp: at once.

    wait_s: answer once the servos have confirmed the end, at most so much later; 0: at once.
    end: a daemon ends with it, and waits for no start; needs the token.
    """

    level: Literal["soft", "freeze", "limp"] = "soft"
    wait_s: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    end: bool = False


class StartBody(Body):
    """wait_s: seconds to wait until the face is driven, or reports why not; 0: no wait."""

    wait_s: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0


class SayBody(Body):
    """A text for the face to speak in its own voice; what is left out is as in its YAML."""

    text: Annotated[str, Field(min_length=1, max_length=20_000)]
    language: Annotated[str, Field(min_length=2, max_length=40)] | None = None
    voice: Annotated[str, Field(max_length=200)] | None = None
    rate_wpm: Annotated[int, Field(ge=SLOWEST_WPM, le=FASTEST_WPM)] | None = None
    pitch: Annotated[int, Field(ge=0, le=HIGHEST_PITCH)] | None = None


class PlayBody(Body):
    """The file name of the line (sound or performance) to play."""

    file: Annotated[str, Field(min_length=1, max_length=200)]


class ServoBody(Body):
    """off: torque off; on: driven again; reboot: restarted."""

    action: Literal["off", "on", "reboot"]


class JogBody(Body):
    """arm: allow or renew jogging; move: one servo, to a joint angle or by its pulse; end."""

    action: Literal["arm", "move", "end"]
    servo: _Name | None = None
    deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None
    pulse_us: Pulse | None = None


class PulseLimitBody(Body):
    """A limit of a hobby servo, and the pulse (us) that it becomes at the next start."""

    servo: _Name
    limit: PulseLimit
    pulse_us: Pulse


class PortBody(Body):
    """Port and bus kind of a new face's servos; simulated: at a port made for simulated ones."""

    port: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    kind: _Name | None = None
    simulated: bool = False


class NameBody(Body):
    """A found servo's joint. same: its first move went in the direction of `positive`."""

    id: Annotated[int, Field(ge=0, le=253)]
    name: _Name
    positive: _Name
    part: Literal["mouth", "neck", "eyes", "lids", "brows", "tongue", "other"] = "mouth"
    same: bool = True


class WireBody(Body):
    """A hobby servo to add, `jaw=0:opens`, or by its name alone to remove."""

    channel: Annotated[str, Field(min_length=1, max_length=200)]


class WriteBody(Body):
    """board: of hobby servos, the Maestro's model or the PCA9685's address."""

    board: _Name | None = None


class StepBody(Body):
    """A step of a new face's setup, and its options.

    clear: find; id: nudge; may_jump: jog; lags, accept: a calibration; tracker, camera,
    eye_distance_mm: measure; play: speak.
    """

    step: Literal["find", "nudge", "limits", "jog", "set_up", "by_eye", "measure", "drawn", "speak"]
    id: int | None = None
    clear: bool = False
    may_jump: bool = False
    lags: bool = False
    accept: bool = False
    tracker: Annotated[str, Field(min_length=1, max_length=400)] | None = None
    camera: _Name | None = None
    eye_distance_mm: Annotated[float, Field(ge=10.0, le=500.0)] | None = None
    play: bool = False


class OrderBody(Body):
    """Order to a step: move joints to angles (deg), or a key: Enter keeps the pose, x skips it."""

    move: Annotated[dict[_Name, _Number], Field(min_length=1, max_length=64)] | None = None
    key: Literal["\r", "x", "b", "q"] | None = None


class EndBody(Body):
    """A joint whose present angle, at which a hand keeps it, becomes its min, neutral or max."""

    servo: _Name
    end: Literal["min", "neutral", "max"]


class TurnBody(Body):
    """A simulated servo to turn as a hand would, by degrees of its joint."""

    servo: _Name
    by_deg: Annotated[float, Field(ge=-90.0, le=90.0)]


class SettingsBody(Body):
    """values: settings by name, all changed or none; save: into the face's YAML as well."""

    values: Annotated[dict[_Name, _Number], Field(min_length=1, max_length=16)]
    save: bool = False


class SoundBody(Body):
    """A face's sound devices, synthesiser and voice for its YAML; null ones stay unchanged."""

    output: Annotated[str, Field(max_length=200)] | None = None
    input: Annotated[str, Field(max_length=200)] | None = None
    synthesizer: _Name | None = None
    voice: Annotated[str, Field(max_length=1000)] | None = None
    language: Annotated[str, Field(max_length=40)] | None = None
    volume: Annotated[float, Field(ge=0.0, le=1.0)] | None = None


class LookBody(Body):
    """Gaze in degrees, yaw to the face's own left, pitch upwards; yaw null: at no target."""

    yaw_deg: Annotated[float, Field(ge=-60.0, le=60.0)] | None
    pitch_deg: Annotated[float, Field(ge=-40.0, le=40.0)] = 0.0


class AffectBody(Body):
    """A mood that fades with the time constant tau_s."""

    valence: Annotated[float, Field(ge=-1.0, le=1.0)]
    arousal: Annotated[float, Field(ge=-1.0, le=1.0)]
    tau_s: Annotated[float, Field(ge=0.1, le=600.0)] = 10.0


class ErrorAnswer(BaseModel):
    """The body of every answer that reports an error."""

    error: str


def add_error_answers(app: FastAPI) -> None:
    """Make an application answer every error with one line of JSON and a fitting HTTP status."""

    async def answer_face_error(_request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, FaceError)
        return _answer(status_of(error), str(error))

    async def answer_bad_body(_request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        if error.errors()[0]["type"] == "json_invalid":
            return _answer(400, "the body is not JSON")
        return _answer(422, first_error(error.errors()))

    async def answer_http_error(_request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)
        return _answer(error.status_code, str(error.detail), error.headers)

    async def answer_own_fault(_request: Request, error: Exception) -> JSONResponse:
        logging.getLogger("lipservo.dashboard").error("a fault of ours", exc_info=error)
        return _answer(500, f"a fault of the dashboard's: {type(error).__name__}")

    app.add_exception_handler(FaceError, answer_face_error)
    app.add_exception_handler(RequestValidationError, answer_bad_body)
    app.add_exception_handler(HTTPException, answer_http_error)
    app.add_exception_handler(Exception, answer_own_fault)


def status_of(error: FaceError) -> int:
    """Return the HTTP status for a FaceError's code; 503, busy, for a code not listed here."""
    return _STATUS_OF.get(error.code, _BUSY)


def first_error(errors: Sequence[Any]) -> str:
    """Return the first of pydantic's errors as one line: field of the body, and message."""
    field = ".".join(str(part) for part in errors[0]["loc"] if part != "body")
    return f"{field}: {errors[0]['msg']}" if field else str(errors[0]["msg"])


def _answer(status: int, text: str, headers: Any = None) -> JSONResponse:
    line = " ".join(text.split())[:_LONGEST]
    line = line.encode("utf-8", "replace").decode()
    return JSONResponse({"error": line}, status, headers)
