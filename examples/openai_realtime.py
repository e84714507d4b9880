"""The audio events of OpenAI's Realtime API speak through a running face.

Start:  python examples/openai_realtime.py EVENTS [URL]

EVENTS is a file of server events, one JSON object a line, as they come over the wire; in an agent
they are the objects of the SDK (`async for event in connection`), which serve as they are. Printed
is what the agent sends back: of each item that was not heard whole, how much of it was heard.
"""

import asyncio
import base64
import json
import sys
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lipservo_client.async_face import AsyncFace, AsyncSpeech
from lipservo_client.protocol import FaceError

import lipservo

#: The API's `pcm16` is 24 kHz, mono, s16le, as base64.
RATE_HZ = 24_000
#: The name of today, and that of the beta.
DELTAS = {"response.output_audio.delta", "response.audio.delta"}
DONES = {"response.output_audio.done", "response.audio.done"}
TRANSCRIPTS = {"response.output_audio_transcript.delta", "response.audio_transcript.delta"}
TRANSCRIBED = {"response.output_audio_transcript.done", "response.audio_transcript.done"}


#: A face takes eight streams at a time.
MOST_STREAMS = 4


@dataclass
class Item:
    """An item of the conversation. sound: what the face has not taken; None is its end.

    texts: of its transcript, what its stream was not told; rest: the word that may go on with the
    next delta. has_sound, is_complete: whether some of its sound, and all, came. is_lost: what was
    not heard of it will not be.
    """

    item_id: str
    content_index: int
    sound: asyncio.Queue[bytes | None] = field(default_factory=asyncio.Queue)
    texts: list[str] = field(default_factory=list)
    rest: str = ""
    has_sound: bool = False
    is_complete: bool = False
    is_lost: bool = False
    speech: AsyncSpeech | None = None

    @property
    def was_heard(self) -> bool:
        """Whether people heard it to its end."""
        return self.speech is not None and self.speech.was_heard

    def correction(self) -> dict[str, Any]:
        """The client event after which the conversation holds no more than was heard."""
        if not self.has_sound:  # of what has no sound, there is none to truncate
            return {"type": "conversation.item.delete", "item_id": self.item_id}
        n_played = 0 if self.speech is None else self.speech.n_played
        return {
            "type": "conversation.item.truncate",
            "item_id": self.item_id,
            "content_index": self.content_index,
            "audio_end_ms": 1_000 * n_played // RATE_HZ,
        }


class RealtimeVoice:
    """Hands on the audio of one session: a stream for each item, in the order of the items."""

    def __init__(self, face: AsyncFace) -> None:
        self._face = face
        self._items: list[Item] = []
        self._unsaid: deque[Item] = deque()
        self._speaking: asyncio.Task[None] | None = None
        #: Items of which nothing more is wanted; what still comes of them is ignored.
        self._over: deque[str] = deque(maxlen=256)

    async def hear(self, event: Any) -> list[dict[str, Any]]:
        """Do what one server event asks for; the client events to answer with.

        event: an object of the SDK, or the mapping that came over the wire. The face's errors are
        no errors of the session: what the face does not say was not heard.
        """
        kind = field_of(event, "type")
        if kind == "input_audio_buffer.speech_started":
            return await self._interrupted()
        if kind in DELTAS | TRANSCRIPTS and (item := self._item(event)) is not None:
            if kind in DELTAS:
                item.has_sound = True
                item.sound.put_nowait(base64.b64decode(field_of(event, "delta")))
            else:
                await self._tell(item, field_of(event, "delta"))
        elif kind in DONES | TRANSCRIBED:
            for each in [e for e in self._items if e.item_id == field_of(event, "item_id")]:
                if kind in DONES:
                    each.is_complete = True
                    each.sound.put_nowait(None)
                else:
                    await self._tell(each, " ")
        return self._corrections()

    async def finish(self) -> list[dict[str, Any]]:
        """Wait until what came was heard, or cannot be, as no more comes; as `hear`."""
        for item in self._items:
            item.is_complete = True
            item.sound.put_nowait(None)
        if self._speaking is not None:
            await self._speaking
        for item in self._items:
            await _over(item.speech)
        return self._corrections()

    def _item(self, event: Any) -> Item | None:
        """The item of an event; None if nothing more of it is wanted."""
        item_id = field_of(event, "item_id")
        self._over += [each.item_id for each in self._items if each.was_heard]
        self._items = [each for each in self._items if not each.was_heard]
        if item_id in self._over:
            return None
        for item in self._items:
            if item.item_id == item_id:
                return item
        item = Item(item_id, field_of(event, "content_index"))
        self._items.append(item)
        self._unsaid.append(item)
        if self._speaking is None or self._speaking.done():
            self._speaking = asyncio.create_task(self._speak())
        return item

    async def _tell(self, item: Item, text: str) -> None:
        """What an item says, in whole words."""
        words, space, item.rest = (item.rest + text).rpartition(" ")
        if item.speech is None:
            item.texts.append(words + space)
        else:
            with suppress(FaceError):
                await item.speech.tell(words + space)

    async def _speak(self) -> None:
        """Say one item after the other, beside `hear`, which a full face would hold up."""
        streams: deque[AsyncSpeech] = deque(maxlen=MOST_STREAMS)
        while self._unsaid:
            item = self._unsaid.popleft()
            first = await item.sound.get()
            if len(streams) == MOST_STREAMS:
                await _over(streams[0])
            if first is None or item not in self._items:
                continue
            try:
                await self._face.try_now()
                speech = self._face.stream(RATE_HZ)
                streams.append(speech)
                await speech.__aenter__()
                while item.texts:
                    await speech.tell(item.texts.pop(0))
                item.speech = speech
                piece: bytes | None = first
                while piece is not None and await speech.write(piece):
                    piece = await item.sound.get()
                await speech.end()
                item.is_lost = piece is not None
            except FaceError as error:
                print(f"not said: {error}", file=sys.stderr)
                item.is_lost = True

    async def _interrupted(self) -> list[dict[str, Any]]:
        """Silence now. Each item that was not heard whole, the one that is queued too."""
        items, self._items = self._items, []
        self._over += [item.item_id for item in items]
        for item in items:
            item.sound.put_nowait(None)
        with suppress(FaceError):
            await self._face.interrupt()
        return [item.correction() for item in items if not item.was_heard]

    def _corrections(self) -> list[dict[str, Any]]:
        """The answers for items whose sound has all come, and which were cut off or refused."""
        for item in self._items:
            is_cut = item.speech is not None and item.speech.is_over and not item.was_heard
            item.is_lost = item.is_lost or is_cut
        lost = [item for item in self._items if item.is_lost and item.is_complete]
        self._over += [item.item_id for item in lost]
        self._items = [item for item in self._items if item not in lost]
        return [item.correction() for item in lost]


async def _over(speech: AsyncSpeech | None) -> None:
    """Wait until a stream was played or cut off."""
    with suppress(FaceError):
        if speech is not None:
            await speech.heard()


def field_of(event: Any, name: str) -> Any:
    """A field of an SDK object, or of a mapping."""
    return event[name] if isinstance(event, Mapping) else getattr(event, name)


async def main(events: Iterable[Any], url: str) -> None:
    """Say what the events carry."""
    async with lipservo.connect_async(url) as face:
        voice = RealtimeVoice(face)
        for event in events:
            for answer in await voice.hear(event):
                print(json.dumps(answer))
        for answer in await voice.finish():
            print(json.dumps(answer))


if __name__ == "__main__":
    lines = Path(sys.argv[1]).read_text("utf-8").splitlines()
    address = sys.argv[2] if len(sys.argv) > 2 else "ws://127.0.0.1:8765"
    try:
        asyncio.run(main(map(json.loads, lines), address))
    except FaceError as error:
        sys.exit(f"the face: {error}")
