"""What the user asked for: run this face, with this sound, this motion, these outputs.

Made once, from a command's options. The processes of a supervised face receive it whole, as one
argument of JSON: an option cannot fall out on the way.

It is read by hand, not by pydantic, which would fill in a field that is missing.
"""

import json
import types
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from lipservo.street.avatar_targets import AvatarTargets
from lipservo.street.motion_options import MotionOptions
from lipservo.street.sources import Sound
from lipservo.street.voice_options import VoiceOptions
from lipsync.errors import UserError, shown


@dataclass(frozen=True, slots=True)
class RunRequest:
    """A run of one face, whole.

    config: the face, by the name of a shipped one or the path of its YAML. model: the face model's
    file; None: the shipped one. port: of the servos; None: where the face's YAML says. rate_hz:
    ticks a second; None: the face's. trace: the file that every tick is written to. control: where
    the control socket is made; None: in the runtime folder. as_json: results are printed as JSON.
    quiet: nothing is printed for people. dry_run: servos are read and never moved. voice: of a
    robot that speaks; None: it only listens. avatars: to whom the face is sent besides.
    """

    config: str
    sound: Sound
    motion: MotionOptions = field(default_factory=MotionOptions)
    model: Path | None = None
    port: str | None = None
    rate_hz: float | None = None
    trace: Path | None = None
    control: Path | None = None
    as_json: bool = False
    quiet: bool = False
    dry_run: bool = False
    voice: VoiceOptions | None = None
    avatars: AvatarTargets = field(default_factory=AvatarTargets)


def about_run(request: RunRequest) -> dict[str, object]:
    """What a face says of its request in every answer."""
    sounds = None if request.voice is None else request.voice.sounds
    return {"config": request.config, "sounds": sounds}


class RequestError(UserError):
    """A text that is no whole request: one line, where and what is wrong."""


def request_json(request: RunRequest) -> str:
    """The request on one line."""
    return json.dumps(asdict(request), default=str)


def request_of_json(text: str) -> RunRequest:
    """What `request_json` wrote. Raises RequestError for anything else, and for a missing field."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"request: not JSON: {error}") from error
    request = _decoded(RunRequest, value, "request")
    assert isinstance(request, RunRequest)
    return request


_PLAIN: Final[dict[object, tuple[tuple[type, ...], str]]] = {
    str: ((str,), "text"),
    bool: ((bool,), "true or false"),
    float: ((int, float), "a number"),
    Path: ((str,), "a path"),
}


def _decoded(kind: Any, value: object, where: str) -> object:
    """The value of that type that the JSON value stands for. Raises RequestError."""
    if get_origin(kind) in (Union, types.UnionType):
        if value is None:
            return None
        (kind,) = (each for each in get_args(kind) if each is not type(None))
    if is_dataclass(kind):
        return _dataclass(kind, value, where)
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            raise RequestError(f"{where}: {shown(value)}, not one of {', '.join(get_args(kind))}")
        return value
    accepted, wanted = _PLAIN[kind]
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        raise RequestError(f"{where}: {shown(value)} is not {wanted}")
    return kind(value)


def _dataclass(kind: Any, value: object, where: str) -> object:
    names = [each.name for each in fields(kind)]
    if not isinstance(value, dict):
        raise RequestError(f"{where}: {shown(value)} has no fields; needs {', '.join(names)}")
    unknown, missing = sorted(set(value) - set(names)), sorted(set(names) - set(value))
    if unknown:
        raise RequestError(f"{where}: unknown field {shown(unknown[0])}")
    if missing:
        raise RequestError(f"{where}.{missing[0]}: is missing")
    hints = get_type_hints(kind)
    return kind(**{name: _decoded(hints[name], value[name], f"{where}.{name}") for name in names})
