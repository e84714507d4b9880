"""The protocol of voice agents as an AsyncAPI document, for `GET /protocol.json`.

Clients' messages are described by the models of `messages.py`, which check them; the face's are
described here, and tests check every message that the server sends against this description.
AsyncAPI 3.0: https://www.asyncapi.com/docs.
"""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, TypeAdapter
from pydantic.json_schema import models_json_schema

from lipservo.agents.listener import CONTROL_PATH, STREAM_PATH
from lipservo.agents.messages import COMMANDS, PROTOCOL, STREAM_MESSAGES, Playback

Id = int | float | str | None


class _Sent(BaseModel):
    """A message from the face to a client. time_s: the face's clock, as in its `hello`."""

    model_config = ConfigDict(extra="forbid")


class Greeting(_Sent):
    """The answer to `hello`. delay_ms: from sound that is sent to the face that shows it."""

    type: Literal["hello"]
    protocol: int
    delay_ms: float
    time_s: float


class Ready(_Sent):
    """The stream may be sent."""

    type: Literal["ready"]
    stream: str
    delay_ms: float
    playback: Playback


class _OfStream(_Sent):
    stream: str
    played_s: float
    n_played: int
    time_s: float


class Progress(_OfStream):
    """What became of a stream; played_s and n_played count from its first sample."""

    type: Literal["started", "finished", "underrun", "paused", "resumed"]


class Reached(_OfStream):
    """All that was sent before the mark was heard."""

    type: Literal["mark"]
    name: str


class Place(_OfStream):
    """So much was heard; waiting_s was sent, and is not yet on its way."""

    type: Literal["position"]
    waiting_s: float


class Dropped(_OfStream):
    """What was not heard never will be."""

    type: Literal["interrupted", "cleared"]
    dropped_s: float
    n_dropped: int


class NothingInterrupted(_Sent):
    """An interruption while nothing was spoken."""

    type: Literal["interrupted"]
    stream: None
    played_s: float
    dropped_s: float


class Recognised(_Sent):
    """A phoneme (ARPAbet), heard_in_s before it is heard; start_s and end_s in the stream."""

    type: Literal["phoneme"]
    stream: str
    phoneme: str
    start_s: float
    end_s: float
    heard_in_s: float


class Failure(_Sent):
    """Nothing was changed. code: of the table in docs/agents.md."""

    type: Literal["error"]
    code: str
    message: str
    stream: str | None = None
    id: Id = None


class Result(_Sent):
    """What a command gave."""

    type: Literal["result"]
    id: Id
    result: dict[str, Any] | None


class OwnSpeech(_Sent):
    """What became of a text or file, by the id of its `say` or `play`.

    duration_s: of what was synthesised until then; at the end of the whole.
    """

    type: Literal["started", "finished", "dropped"]
    stream: str
    id: Id
    played_s: float
    duration_s: float
    time_s: float


STREAM_EVENTS = (
    Greeting | Ready | Progress | Reached | Place | Dropped | NothingInterrupted | Recognised
) | Failure
CONTROL_EVENTS = Result | Failure | OwnSpeech
#: By path: what the face may send there.
EVENTS: dict[str, TypeAdapter[Any]] = {
    STREAM_PATH: TypeAdapter(STREAM_EVENTS),
    CONTROL_PATH: TypeAdapter(CONTROL_EVENTS),
}
_CHANNELS: dict[str, tuple[tuple[type[BaseModel], ...], tuple[type[BaseModel], ...]]] = {
    STREAM_PATH: (tuple(STREAM_MESSAGES.values()), STREAM_EVENTS.__args__),
    CONTROL_PATH: (tuple(COMMANDS.values()), CONTROL_EVENTS.__args__),
}


def protocol_schema() -> dict[str, Any]:
    """Return the AsyncAPI document as a JSON object; binary samples are only in its description."""
    models = {model for both in _CHANNELS.values() for each in both for model in each}
    ordered = sorted(models, key=lambda model: model.__name__)
    _, defined = models_json_schema(
        [(model, "validation") for model in ordered],
        ref_template="#/components/schemas/{model}",
    )
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "lipservo: speech and commands to a running face",
            "version": str(PROTOCOL),
            "description": "Texts are JSON objects; binary messages at /stream are samples.",
        },
        "channels": {
            path.strip("/"): {
                "address": path,
                "messages": {each.__name__: _message(each) for each in (*sent, *received)},
            }
            for path, (sent, received) in _CHANNELS.items()
        },
        "operations": {
            f"{action}{path.replace('/', '_')}": {
                "action": action,
                "channel": {"$ref": f"#/channels/{path.strip('/')}"},
                "messages": [
                    {"$ref": f"#/channels/{path.strip('/')}/messages/{each.__name__}"}
                    for each in models_of
                ],
            }
            for path, both in _CHANNELS.items()
            # As AsyncAPI has it, from the face's side.
            for action, models_of in zip(("receive", "send"), both, strict=True)
        },
        "components": {"schemas": defined["$defs"]},
    }


def _message(model: type[BaseModel]) -> dict[str, Any]:
    return {"payload": {"$ref": f"#/components/schemas/{model.__name__}"}}
