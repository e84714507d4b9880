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
from collections.abc import Mapping
from typing import Annotated, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

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

#: The version of docs/agents.md that this face speaks; a client of another is told so.
PROTOCOL: Final = 2
#: Where a stream's samples are played: by the face's own loudspeaker, or by who sends them.
Playback = Literal["server", "client"]
Name = Annotated[str, Field(min_length=1, max_length=128)]
#: As long as somebody wants to hear, and far below a message's bound.
_LONGEST_TEXT: Final = 20_000
#: Positions are within a stream: three hours of one are more than any has.
_LONGEST_S: Final = 10_000.0
#: A face is at rest and limp within seconds; after a pulled plug within half a minute.
LONGEST_WAIT_S: Final = 30.0
Samples = NDArray[np.float32]

_LONGEST_TYPE: Final = 40
_WIDTH: Final = {"s16le": 2, "f32le": 4}
_FULL_SCALE: Final = 32_768.0
_MOST_WAITING: Final = 256
#: Of which the next makes up for a lost one: these make room.
_REPLACEABLE: Final = frozenset({"position", "phoneme"})

Event = Mapping[str, object]


class MessageError(ValueError):
    """A client's mistake, which is sent to it: a code of docs/agents.md and a one-line message."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class _Message(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="ignore", allow_inf_nan=False)


_Kind = TypeVar("_Kind", bound=_Message)


class Hello(_Message):
    """I am here, and may be silent for long. protocol: the client's version; None: not given."""

    type: Literal["hello"]
    protocol: int | None = None


class Start(_Message):
    """A stream of speech begins. sample_rate: Hz; stream: its id, ours where it gives none."""

    type: Literal["start"]
    stream: Name | None = None
    sample_rate: Annotated[int, Field(ge=LOWEST_RATE_HZ, le=HIGHEST_RATE_HZ)]
    format: Literal["s16le", "f32le"] = "s16le"
    channels: Literal[1] = 1
    playback: Playback = "server"


class Audio(_Message):
    """Samples as text. data: base64 of what a binary message holds."""

    type: Literal["audio"]
    data: str


class End(_Message):
    """The stream is complete; it is spoken to its end."""

    type: Literal["end"]


class Interrupt(_Message):
    """Barge-in: silence now."""

    type: Literal["interrupt"]


class Clear(_Message):
    """What is not on its way to the loudspeaker yet is dropped."""

    type: Literal["clear"]


class Pause(_Message):
    """Silence now; what was not heard is kept until `resume`."""

    type: Literal["pause"]


class Resume(_Message):
    """Speech goes on where it was paused."""

    type: Literal["resume"]


class Mark(_Message):
    """Tell when all that was sent until now has been heard, whether more comes or not."""

    type: Literal["mark"]
    name: Name


class Position(_Message):
    """How much of a stream was heard.

    With `played_s`: so much has left the client's own loudspeaker now. Without: a question.
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
    """A word, phoneme or viseme, by samples of the stream; without an end: until the next one."""

    label: Annotated[str, Field(min_length=1, max_length=LONGEST_LABEL)]
    start_sample: Sample | None = None
    end_sample: Sample | None = None


Units = Annotated[list[Unit], Field(min_length=1, max_length=_MOST_UNITS)]


class _SpeechMessage(_Message):
    """A message about the stream of id `stream`; None: the client's open stream."""

    stream: Name | None = None


class Text(_SpeechMessage):
    """The words of a stream, as they are written: before its sound, with it or after it.

    More, or corrected.

    With `start_sample` it replaces all text from there on.
    """

    type: Literal["text"]
    text: Annotated[str, Field(min_length=1, max_length=LONGEST_TEXT)]
    start_sample: Sample | None = None
    language: Language = DEFAULT_LANGUAGE


class Words(_SpeechMessage):
    """Words that are spoken, with times or without."""

    type: Literal["words"]
    units: Units
    language: Language = DEFAULT_LANGUAGE


class Phonemes(_SpeechMessage):
    """Phonemes that are spoken; without times they are looked for in the sound."""

    type: Literal["phonemes"]
    units: Units
    alphabet: Name = ARPABET


class Visemes(_SpeechMessage):
    """Shapes of the mouth, with the times when they begin."""

    type: Literal["visemes"]
    units: Units
    alphabet: Name = ARPABET


class _Command(_Message):
    id: int | float | str | None = None


class AskStatus(_Command):
    """How the face is."""

    type: Literal["status"]


class Stop(_Command):
    """The face stops: to rest and limp, frozen, or limp at once.

    wait_s: so long for the report of the end. end: a daemon ends, and waits for no start.
    """

    type: Literal["stop"]
    level: Literal["soft", "freeze", "limp"] = "soft"
    wait_s: Annotated[float, Field(ge=0.0, le=LONGEST_WAIT_S)] = 0.0
    end: bool = False


class StartFace(_Command):
    """A stopped face is driven again."""

    type: Literal["start"]


class Set(_Command):
    """Another value of a setting."""

    type: Literal["set"]
    name: Name
    value: float


class Say(_Command):
    """Speak a text."""

    type: Literal["say"]
    text: Annotated[str, Field(min_length=1, max_length=_LONGEST_TEXT)]


class Play(_Command):
    """A sound file or a performance is to be played."""

    type: Literal["play"]
    file: Annotated[str, Field(min_length=1, max_length=1024)]


SpeechUnits = Text | Words | Phonemes | Visemes
StreamMessage = (
    Hello | Start | Audio | End | Interrupt | Clear | Pause | Resume | Mark | Position | SpeechUnits
)
Command = AskStatus | Stop | StartFace | Set | Say | Play

STREAM_MESSAGES: Final[dict[str, type[StreamMessage]]] = {
    "hello": Hello,
    "start": Start,
    "audio": Audio,
    "end": End,
    "interrupt": Interrupt,
    "clear": Clear,
    "pause": Pause,
    "resume": Resume,
    "mark": Mark,
    "position": Position,
    "text": Text,
    "words": Words,
    "phonemes": Phonemes,
    "visemes": Visemes,
}
COMMANDS: Final[dict[str, type[Command]]] = {
    "status": AskStatus,
    "stop": Stop,
    "start": StartFace,
    "set": Set,
    "say": Say,
    "play": Play,
}


def stream_message(text: str) -> StreamMessage | None:
    """Parse a text from `/stream`; None for an unknown type without `id`. Raises MessageError."""
    return _parsed(text, STREAM_MESSAGES)


def command(text: str) -> Command | None:
    """Parse a text from `/control`; None for an unknown type without `id`. Raises MessageError."""
    return _parsed(text, COMMANDS)


def _parsed(text: str, known: Mapping[str, type[_Kind]]) -> _Kind | None:
    fields = _object(text)
    kind = known.get(str(fields["type"]))
    if kind is not None:
        return _checked(kind, fields)
    if fields.get("id") is None:
        return None
    unknown = f"{str(fields['type'])[:_LONGEST_TYPE]!r} is not known by protocol {PROTOCOL}"
    raise MessageError("unknown_type", f"{unknown}, which this face speaks")


def id_of(text: str) -> int | float | str | None:
    """Return the `id` of a refused message, for its error event; None if none can be read."""
    try:
        given = _object(text).get("id")
    except MessageError:
        return None
    return given if isinstance(given, (int, float, str)) else None


def _object(text: str) -> dict[str, object]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        raise MessageError("bad_json", "the text is not JSON; audio is sent as binary") from None
    if not isinstance(value, dict) or not isinstance(value.get("type"), str):
        raise MessageError("bad_json", 'the text is no JSON object with a "type"')
    return value


def _checked(kind: type[_Kind], fields: dict[str, object]) -> _Kind:
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = str(first["loc"][0]) if first["loc"] else "message"
        reason = f"{where}: {first['msg']}"
        raise MessageError("bad_message", f"{fields['type']}: {reason}") from None


def spoken_text_of(message: SpeechUnits, sample_rate_hz: int) -> SpokenText:
    """Convert a message about a stream to a `SpokenText` in the inventory's phonemes or visemes.

    Raises AlphabetError, and SpokenTextError, as for visemes without times.
    """
    if isinstance(message, Text):
        return SpokenText("text", (SpokenUnit(message.text, message.start_sample),), sample_rate_hz)
    units = tuple(
        SpokenUnit(each.label, each.start_sample, each.end_sample) for each in message.units
    )
    if isinstance(message, Words):
        return SpokenText("word", units, sample_rate_hz)
    kind: UnitKind = "phoneme" if isinstance(message, Phonemes) else "viseme"
    spoken = in_inventory(kind, units, message.alphabet, sample_rate_hz)
    if kind == "viseme" and not spoken.is_timed:
        raise SpokenTextError("visemes without a start_sample move no mouth")
    return spoken


class PcmDecoder:
    """A decoder of little-endian mono PCM that keeps an incomplete last sample for later."""

    def __init__(self, sample_format: Literal["s16le", "f32le"]) -> None:
        self._format = sample_format
        self._width = _WIDTH[sample_format]
        self._rest = b""

    @property
    def n_left_bytes(self) -> int:
        """Number of bytes kept of a sample that is incomplete so far."""
        return len(self._rest)

    def n_samples(self, data: bytes) -> int:
        """Return how many samples `decode(data)` would return, without decoding."""
        return (len(self._rest) + len(data)) // self._width

    def decode(self, data: bytes) -> Samples:
        """Return whole samples, (n,) float32 in [-1, 1]; NaN becomes 0, and excess is clipped."""
        data = self._rest + data
        n_bytes = len(data) // self._width * self._width
        data, self._rest = data[:n_bytes], data[n_bytes:]
        if self._format == "s16le":
            return np.frombuffer(data, dtype="<i2").astype(np.float32) / np.float32(_FULL_SCALE)
        given = np.frombuffer(data, dtype="<f4").astype(np.float32)
        return np.clip(np.nan_to_num(given, nan=0.0, posinf=1.0, neginf=-1.0), -1.0, 1.0)


def decode_base64(text: str) -> bytes:
    """Return the bytes that a base64 text encodes; raise ValueError if it is not base64."""
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError("data: not base64") from error


class Outbox:
    """A bounded first-in first-out queue of events for one client, for use in one event loop."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque()
        self._filled = asyncio.Event()
        #: Set when an event had to be lost that may not be: the client does not read.
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

    def error(self, code: str, message: str, **about: object) -> None:
        """Queue an error event: a code of docs/agents.md, a message and fields (`about`)."""
        self.put({"type": "error", "code": code, "message": message, **about})

    def close(self) -> None:
        """Drop all waiting and future events, as the client has disconnected."""
        self._is_closed = True
        self._events.clear()

    async def take(self) -> str:
        """Wait until an event is queued, remove the oldest and return it as JSON."""
        while not self._events:
            self._filled.clear()
            await self._filled.wait()
        return json.dumps(self._events.popleft(), default=str)

    def _make_room(self) -> bool:
        for n, event in enumerate(self._events):
            if event["type"] in _REPLACEABLE:
                del self._events[n]
                return True
        return False
