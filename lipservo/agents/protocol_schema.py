"""The protocol of voice agents as an AsyncAPI document, for `GET /protocol.json`.

Clients' messages are described by the models of `messages.py`, which check them; the face's are
described here, and tests check every message that the server sends against this description.
AsyncAPI 3.0: https://www.asyncapi.com/docs.
"""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, TypeAdapter
from pydantic.json_schema import models_json_schema

from lipservo.agents.listener import CONTROL_PATH, STREAM_PATH
from lipservo.agents.messages import COMMANDS, OPEN, PROTOCOL, STREAM_MESSAGES, ErrorCode, Playback
from lipsync.audio.playout_stream import MoverReason as Reason
from lipsync.recognition.text_decoder import MovedBy as Mover

Id = int | float | str | None


class _Sent(BaseModel):
    """A message from the face to a client. time_s: seconds on the face's monotonic clock."""

    # Tests hold what the face sends against these fields and no others.
    model_config = ConfigDict(extra="forbid", json_schema_extra=OPEN)


class Greeting(_Sent):
    """The answer to `hello`. protocol: the face's version.

    delay_ms: from the arrival of sound to the motion that shows it. time_s: the present time on the
    face's clock, as in the events of streams.
    """

    type: Literal["hello"]
    protocol: int
    delay_ms: float
    time_s: float


class Ready(_Sent):
    """The answer to `start`: samples of the stream may be sent.

    delay_ms: from the arrival of sound to the motion that shows it; a client that plays the sound
    itself plays it so much later.
    """

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
    """The playing of a stream has started, finished, been paused or resumed.

    underrun: no samples are ready; the mouth closes and waits. played_s, n_played: seconds and
    samples played so far.
    """

    type: Literal["started", "finished", "underrun", "paused", "resumed"]


class Reached(_OfStream):
    """All samples sent before a `mark` have been played. name: the mark's."""

    type: Literal["mark"]
    name: str


class Place(_OfStream):
    """How much of a stream was played: played_s, n_played. Sent unrequested, too, as it plays.

    waiting_s: seconds that were received and are not yet on their way to the loudspeaker.
    """

    type: Literal["position"]
    waiting_s: float


class MovedBy(_OfStream):
    """Something else moves the mouth than before. moved_by: what; reason: why nothing better does.

    told: the sender sent it, and the sound agrees. not_told: nothing more precise is known of this
    sound. not_said: the units or the text that were sent are not what is heard. not_followed: a
    simpler recogniser has taken over, which follows no text.
    """

    type: Literal["moved_by"]
    moved_by: Mover
    reason: Reason


class UnitsShifted(_OfStream):
    """Units with times are heard so much later than sent, ms (negative: earlier), and shown then.

    Sent again where that changes by 30 ms.
    """

    type: Literal["units_shifted"]
    shifted_ms: float


class TextDropped(_OfStream):
    """The text that was sent is not what is heard: the mouth moves by the sound."""

    type: Literal["text_dropped"]


class Dropped(_OfStream):
    """A stream was cut off by `interrupt`, `clear` or the face.

    cleared: if it was playing, samples on their way are still played; then `finished` follows.
    dropped_s, n_dropped: seconds and samples that were received and are never played.
    """

    type: Literal["interrupted", "cleared"]
    dropped_s: float
    n_dropped: int


class NothingInterrupted(_Sent):
    """The answer to `interrupt` if this client has no stream; all values are null or 0."""

    type: Literal["interrupted"]
    stream: None
    played_s: float
    dropped_s: float


class Recognised(_Sent):
    """A phoneme of a stream, in ARPAbet. start_s, end_s: from the stream's first sample.

    heard_in_s: seconds from now until its start is played.
    """

    type: Literal["phoneme"]
    stream: str
    phoneme: str
    start_s: float
    end_s: float
    heard_in_s: float


class Failure(_Sent):
    """An error. code: of docs/agents.md, "Errors". stream, id: those it is about, if any.

    A refused message changes nothing, but a stream has ended after `stalled`, and after `bad_audio`
    in answer to `end`.
    """

    type: Literal["error"]
    code: ErrorCode
    message: str
    stream: str | None = None
    id: Id = None


class Result(_Sent):
    """The answer to an accepted command. id: the command's; result: as docs/agents.md lists."""

    type: Literal["result"]
    id: Id
    result: dict[str, Any] | None


class OwnSpeech(_Sent):
    """The playing of a `say` or `play` has started or finished, or its rest was dropped.

    id: the command's; stream: as in its result. played_s: seconds played. duration_s: of the part
    that is synthesised so far; if finished, of all.
    """

    type: Literal["started", "finished", "dropped"]
    stream: str
    id: Id
    played_s: float
    duration_s: float
    time_s: float


STREAM_EVENTS = (
    Greeting
    | Ready
    | Progress
    | Reached
    | Place
    | Dropped
    | NothingInterrupted
    | Recognised
    | MovedBy
    | UnitsShifted
    | TextDropped
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
