"""The messages, audio samples and events of a voice agent's connection.

Texts are JSON objects with a `type`, checked field by field. Unknown fields are ignored, and
unknown types are answered only if the message has an `id`, since clients are older or newer.
Samples are bytes of PCM, and a message may be cut at any byte. The queue of events to send is
bounded, so that a slow reader harms only itself.
"""

import asyncio
import base64
import binascii
import json
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Final, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from lipsync.alphabets import ARPABET, in_inventory
from lipsync.audio.playout_stream import HIGHEST_RATE_HZ, LOWEST_RATE_HZ
from lipsync.spoken_text import (
    LONGEST_LABEL,
    LONGEST_TEXT,
    SpokenText,
    SpokenTextError,
    SpokenUnit,
    UnitKind,
)
from lipsync.text_to_speech.pronunciation import DEFAULT_LANGUAGE
from lipsync.text_to_speech.spoken_form import spoken_form
from lipsync.text_to_speech.synthesis import FASTEST_WPM, HIGHEST_PITCH, SLOWEST_WPM

#: The version of docs/agents.md that this face speaks; a client of another is told so.
PROTOCOL: Final = 2
#: Where a stream's samples are played: by the face's own loudspeaker, or by who sends them.
Playback = Literal["server", "client"]
Name = Annotated[str, Field(min_length=1, max_length=128)]
#: Positions are within a stream: three hours of one are more than any has.
_LONGEST_S: Final = 10_000.0
#: A face is at rest and limp within seconds; after a pulled plug within half a minute.
LONGEST_WAIT_S: Final = 30.0
Samples = NDArray[np.float32]

_LONGEST_TYPE: Final = 40
_WIDTH: Final = {"s16le": 2, "f32le": 4}
_FULL_SCALE: Final = 32_768.0
_MOST_WAITING: Final = 256
#: Events of which the next replaces a lost one: in a full queue these are dropped.
_REPLACEABLE: Final = frozenset({"position", "phoneme"})

Event = Mapping[str, object]


#: What an error event may say, and what happened: docs/agents.md, "Errors".
_OfMessages = Literal["bad_json", "unknown_type", "bad_message", "bad_protocol", "bad_audio"]
_OfStreams = Literal["no_stream", "stream_open", "bad_text", "busy", "no_loudspeaker", "stalled"]
_OfBounds = Literal["too_many_streams", "too_many_marks", "too_many_requests", "buffer_full"]
_OfControl = Literal["refused", "unauthorized", "not_answering", "unexpected_binary"]
ErrorCode = Literal[_OfMessages, _OfStreams, _OfBounds, _OfControl, "not_available", "internal"]


class MessageError(ValueError):
    """A client's mistake, which is sent to it: a code of docs/agents.md and a one-line message."""

    def __init__(self, code: ErrorCode, message: str) -> None:
        super().__init__(message)
        self.code: ErrorCode = code


#: For every message's schema: fields that a reader does not know are allowed, and ignored.
OPEN: Final[dict[str, JsonValue]] = {"additionalProperties": True}


class _Message(BaseModel):
    model_config = ConfigDict(
        strict=True, frozen=True, extra="ignore", allow_inf_nan=False, json_schema_extra=OPEN
    )


_Kind = TypeVar("_Kind", bound=_Message)


class Hello(_Message):
    """Keep the connection open, even without a stream; answered by `hello`.

    protocol: the client's version; if it is not the face's, an error follows. Absent: not checked.
    """

    type: Literal["hello"]
    protocol: int | None = None


class Start(_Message):
    """Open a stream of speech; answered by `ready`. sample_rate: Hz.

    stream: its id; absent: the face chooses one. format: little-endian, signed 16 bit or float.
    playback: the face (`server`) or the client itself plays the sound.
    """

    type: Literal["start"]
    stream: Name | None = None
    sample_rate: Annotated[int, Field(ge=LOWEST_RATE_HZ, le=HIGHEST_RATE_HZ)]
    format: Literal["s16le", "f32le"] = "s16le"
    channels: Literal[1] = 1
    playback: Playback = "server"


class Audio(_Message):
    """Samples of the open stream. data: base64 of the bytes that a binary message would have."""

    type: Literal["audio"]
    data: str


class End(_Message):
    """End the open stream: no more samples follow, and those sent are played to the last."""

    type: Literal["end"]


class Interrupt(_Message):
    """Barge-in: silence the face at once; end all streams of this client (`interrupted`).

    Speech by `say` and `play` ends, too, unless another client speaks.
    """

    type: Literal["interrupt"]


class Clear(_Message):
    """End all streams of this client: samples on their way to the loudspeaker are still played.

    All others are dropped (`cleared`).
    """

    type: Literal["clear"]


class Pause(_Message):
    """Silence the face at once; keep what was not played until `resume`, at most a minute."""

    type: Literal["pause"]


class Resume(_Message):
    """Continue speech that this client has paused; up to 10 ms of it are lost."""

    type: Literal["resume"]


class Mark(_Message):
    """Request a `mark` event for when all samples sent so far have been played. name: of both."""

    type: Literal["mark"]
    name: Name


class Position(_Message):
    """Without `played_s`: request the `position` of each stream of this client.

    With it: report how many s of a stream the client's own loudspeaker has played by now.
    stream: its id; absent: the one that is played.
    """

    type: Literal["position"]
    stream: Name | None = None
    played_s: Annotated[float, Field(ge=0.0, le=_LONGEST_S)] | None = None


#: What is said beside its sound, in pieces of so many units, and up to an hour at 192 kHz.
_MOST_UNITS: Final = 2_000
_MOST_SAMPLES: Final = 2**31
Language = Annotated[str, Field(pattern=r"^[A-Za-z]{2,3}(-[A-Za-z0-9]{1,8}){0,3}$")]
Sample = Annotated[int, Field(ge=0, le=_MOST_SAMPLES)]


class Unit(_Message):
    """A word, phoneme or viseme and its place, in samples counted from the stream's first.

    No start_sample: unknown. No end_sample: where the next unit starts; the last after 0.3 s.
    """

    label: Annotated[str, Field(min_length=1, max_length=LONGEST_LABEL)]
    start_sample: Sample | None = None
    end_sample: Sample | None = None


Units = Annotated[list[Unit], Field(min_length=1, max_length=_MOST_UNITS)]


class _SpeechMessage(_Message):
    """A message about the stream with the id `stream`; None: the client's open stream."""

    stream: Name | None = None


class Text(_SpeechMessage):
    """The written text of a stream, sent before its sound, with it or after it.

    It is appended to earlier text; with `start_sample`, the sample at which it starts, it replaces
    earlier text from there on. language: of the text, as `en-us`.
    """

    type: Literal["text"]
    text: Annotated[str, Field(min_length=1, max_length=LONGEST_TEXT)]
    start_sample: Sample | None = None
    language: Language = DEFAULT_LANGUAGE


class Words(_SpeechMessage):
    """The words of a stream in order, with times or without; appended to earlier words.

    If the first has a `start_sample`, they replace earlier words from there on.
    """

    type: Literal["words"]
    units: Units
    language: Language = DEFAULT_LANGUAGE


class Phonemes(_SpeechMessage):
    """The phonemes of a stream, appended or replacing as `words`. alphabet: of the labels.

    With times they move the mouth; without, the face finds their times in the sound.
    """

    type: Literal["phonemes"]
    units: Units
    alphabet: Name = ARPABET


class Visemes(_SpeechMessage):
    """Mouth shapes that move the mouth, appended or replacing as `words`. alphabet: of the labels.

    Each unit needs its `start_sample`.
    """

    type: Literal["visemes"]
    units: Units
    alphabet: Name = ARPABET


class _Command(_Message):
    id: int | float | str | None = None


class AskStatus(_Command):
    """Request the face's status: the fields of docs/architecture.md, "Status"."""

    type: Literal["status"]


class Stop(_Command):
    """Stop the face: soft (to rest, then limp), freeze (hold the position), or limp at once.

    wait_s: longest wait for what the servos confirmed, `report` of the result; 0: no report. end: a
    daemon exits; otherwise it waits, limp, for `start`.
    """

    type: Literal["stop"]
    level: Literal["soft", "freeze", "limp"] = "soft"
    wait_s: Annotated[float, Field(ge=0.0, le=LONGEST_WAIT_S)] = 0.0
    end: bool = False


class StartFace(_Command):
    """Start a stopped face again: it moves. Whether it runs is in `status`."""

    type: Literal["start"]


class Set(_Command):
    """Change a setting of the running face. name: as `strength`; value: the new one."""

    type: Literal["set"]
    name: Name
    value: float


class Say(_Command):
    """Speak a text with the face's own voice; `started`, then `finished` or `dropped` follow.

    language, voice: of the synthesiser's; rate_wpm: words a minute; pitch: 50 as the voice was
    made. What is left out is as in the face's YAML.
    """

    type: Literal["say"]
    text: Annotated[str, Field(min_length=1, max_length=LONGEST_TEXT)]
    language: Language | None = None
    voice: Annotated[str, Field(max_length=200)] | None = None
    rate_wpm: Annotated[int, Field(ge=SLOWEST_WPM, le=FASTEST_WPM)] | None = None
    pitch: Annotated[int, Field(ge=0, le=HIGHEST_PITCH)] | None = None


class Play(_Command):
    """Play a sound file or performance of the face's folder of sounds; events as for `say`."""

    type: Literal["play"]
    file: Annotated[str, Field(min_length=1, max_length=1024)]


SpeechUnits = Text | Words | Phonemes | Visemes
StreamMessage = (
    Hello | Start | Audio | End | Interrupt | Clear | Pause | Resume | Mark | Position | SpeechUnits
)
Command = AskStatus | Stop | StartFace | Set | Say | Play


def _by_type(kinds: Sequence[type[_Kind]]) -> dict[str, type[_Kind]]:
    """Return message classes by their `type`, the one value that this field of each may have."""
    return {get_args(kind.model_fields["type"].annotation)[0]: kind for kind in kinds}


STREAM_MESSAGES: Final[dict[str, type[StreamMessage]]] = _by_type(get_args(StreamMessage))
COMMANDS: Final[dict[str, type[Command]]] = _by_type(get_args(Command))


def stream_message(text: str) -> StreamMessage | None:
    """Parse a text from `/stream`; None for an unknown type without `id`. Raises MessageError."""
    return _parsed(text, STREAM_MESSAGES)


def command(text: str) -> Command | None:
    """Return the message in a text from `/control`; None for an unknown type without `id`.

    Raises MessageError for a malformed text, and for an unknown type with an `id`.
    """
    return _parsed(text, COMMANDS)


def _parsed(text: str, known: Mapping[str, type[_Kind]]) -> _Kind | None:
    """Parse a text as a message of one of the types in `known`, by type name.

    None: a message of unknown type without an `id`, which is ignored. Raises MessageError for an
    unknown type with an `id`, and for a malformed text.
    """
    fields = _parse_object(text)
    kind = known.get(str(fields["type"]))
    if kind is not None:
        return _validated(kind, fields)
    if fields.get("id") is None:
        return None
    unknown = f"{str(fields['type'])[:_LONGEST_TYPE]!r} is not known by protocol {PROTOCOL}"
    raise MessageError("unknown_type", f"{unknown}, which this face speaks")


def id_of(text: str) -> int | float | str | None:
    """Return the `id` in a refused JSON message, for its error event; None if it has none."""
    try:
        given = _parse_object(text).get("id")
    except MessageError:
        return None
    return given if isinstance(given, (int, float, str)) else None


def _parse_object(text: str) -> dict[str, object]:
    """Parse a text as a JSON object with a string `type`, or raise MessageError `bad_json`."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        raise MessageError("bad_json", "this message is not JSON; send audio as binary") from None
    if not isinstance(value, dict) or not isinstance(value.get("type"), str):
        raise MessageError("bad_json", 'this message is not a JSON object with a "type"')
    return value


def _validated(kind: type[_Kind], fields: dict[str, object]) -> _Kind:
    """Return a message of class `kind`, made of the fields of a JSON object.

    Raises MessageError `bad_message`, which names the first field that is missing or invalid.
    """
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = str(first["loc"][0]) if first["loc"] else "message"
        reason = f"{where}: {first['msg']}"
        raise MessageError("bad_message", f"{fields['type']}: {reason}") from None


def spoken_text_of(message: SpeechUnits, sample_rate_hz: int) -> SpokenText:
    """Convert a message to a `SpokenText`; phonemes and visemes become units of ARPAbet phones.

    sample_rate_hz: of the message's stream. Raises AlphabetError, and SpokenTextError, for example
    for visemes without times.
    """
    if isinstance(message, Text):
        return SpokenText("text", (SpokenUnit(message.text, message.start_sample),), sample_rate_hz)
    units = tuple(
        SpokenUnit(each.label, each.start_sample, each.end_sample) for each in message.units
    )
    if isinstance(message, Words):
        return SpokenText("word", _spoken_words(units, message.language), sample_rate_hz)
    kind: UnitKind = "phoneme" if isinstance(message, Phonemes) else "viseme"
    spoken = in_inventory(kind, units, message.alphabet, sample_rate_hz)
    if kind == "viseme" and not spoken.is_timed:
        raise SpokenTextError("visemes need a start_sample to move the mouth")
    return spoken


def _spoken_words(units: Sequence[SpokenUnit], language: str) -> tuple[SpokenUnit, ...]:
    """Return words as they are spoken, without marks; a smiley that has a time is no word.

    Words without times are looked up together, since a mark may begin in one and end in another.
    """
    if not all(each.start_sample is not None for each in units):
        return tuple(units)
    labels = (spoken_form(each.label, language)[:LONGEST_LABEL] for each in units)
    return tuple(
        replace(unit, label=label) for unit, label in zip(units, labels, strict=True) if label
    )


class PcmDecoder:
    """A decoder of little-endian mono PCM that keeps an incomplete last sample for later."""

    def __init__(self, sample_format: Literal["s16le", "f32le"]) -> None:
        self._format = sample_format
        self._width = _WIDTH[sample_format]
        #: The bytes kept of a sample that is incomplete so far.
        self.partial_sample = b""

    def n_samples(self, data: bytes) -> int:
        """Return how many samples `decode(data)` would return; change nothing."""
        return (len(self.partial_sample) + len(data)) // self._width

    def decode(self, data: bytes) -> Samples:
        """Return the whole samples in `data`, after any bytes kept before: (n,) float32 in [-1, 1].

        NaN becomes 0, and values outside the range are clipped.
        """
        data = self.partial_sample + data
        n_bytes = len(data) // self._width * self._width
        data, self.partial_sample = data[:n_bytes], data[n_bytes:]
        if self._format == "s16le":
            return np.frombuffer(data, dtype="<i2").astype(np.float32) / np.float32(_FULL_SCALE)
        given = np.frombuffer(data, dtype="<f4").astype(np.float32)
        return np.clip(np.nan_to_num(given, nan=0.0, posinf=1.0, neginf=-1.0), -1.0, 1.0)


def decode_base64(text: str) -> bytes:
    """Return the bytes that a base64 text encodes; raise MessageError if it is not base64."""
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise MessageError("bad_audio", "data is not base64") from error


class Outbox:
    """A bounded first-in first-out queue of events for one client, for use in one event loop."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque()
        self._filled = asyncio.Event()
        #: Set when an event that may not be lost was dropped: the client does not read.
        self.overflowed = asyncio.Event()
        self._is_closed = False

    def put(self, event: Event) -> None:
        """Queue an event for the client; ignore it after `close`.

        If the queue is full, its oldest position or phoneme is dropped. Without one the event
        itself is dropped, and `overflowed` is set unless it is a position or phoneme.
        """
        if self._is_closed:
            return
        if len(self._events) >= _MOST_WAITING and not self._make_room():
            if event["type"] not in _REPLACEABLE:
                self.overflowed.set()
            return
        self._events.append(event)
        self._filled.set()

    def error(self, code: ErrorCode, message: str, **about: object) -> None:
        """Queue an error event: a code of docs/agents.md, a message and further fields `about`."""
        self.put({"type": "error", "code": code, "message": message, **about})

    def close(self) -> None:
        """Drop all queued and future events; called when the client has disconnected."""
        self._is_closed = True
        self._events.clear()

    async def take(self) -> str:
        """Wait until an event is queued, remove the oldest and return it as JSON."""
        while not self._events:
            self._filled.clear()
            await self._filled.wait()
        return json.dumps(self._events.popleft(), default=str)

    def _make_room(self) -> bool:
        """Drop the oldest position or phoneme; return False if there is none."""
        for n, event in enumerate(self._events):
            if event["type"] in _REPLACEABLE:
                del self._events[n]
                return True
        return False
