"""The audio events of OpenAI's Realtime API speak through a running face.

Start:  python examples/openai_realtime.py EVENTS [URL]

EVENTS is a file of server events, one JSON object a line, as they come over the wire; in an agent
they are the objects of the SDK (`async for event in connection`), which serve as they are. Printed
is what the agent sends back: after a barge-in, how much of each item was heard.
"""

import asyncio
import base64
import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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


@dataclass
class Item:
    """An item of the conversation that has sound, and its stream."""

    item_id: str
    content_index: int
    speech: AsyncSpeech


class RealtimeVoice:
    """Hands on the audio of one session: a stream for each item."""

    def __init__(self, face: AsyncFace) -> None:
        self._face = face
        self._items: list[Item] = []

    async def hear(self, event: Any) -> list[dict[str, Any]]:
        """Do what one server event asks for; the client events to answer with.

        event: an object of the SDK, or the mapping that came over the wire.
        """
        kind = field_of(event, "type")
        if kind in DELTAS:
            item = await self._item(event)
            await item.speech.write(base64.b64decode(field_of(event, "delta")))
        elif kind in DONES:
            for item in self._items:
                if item.item_id == field_of(event, "item_id"):
                    await item.speech.end()
        elif kind == "input_audio_buffer.speech_started":
            return await self._truncated()
        return []

    async def _item(self, event: Any) -> Item:
        item_id = field_of(event, "item_id")
        for item in self._items:
            if item.item_id == item_id:
                return item
        self._items = [item for item in self._items if not item.speech.was_heard]
        for item in self._items:
            await item.speech.end()
        speech = self._face.stream(RATE_HZ)
        self._items.append(Item(item_id, field_of(event, "content_index"), speech))
        await speech.__aenter__()
        return self._items[-1]

    async def _truncated(self) -> list[dict[str, Any]]:
        """Silence now. Each item that was not heard whole, the one that is queued too."""
        items, self._items = self._items, []
        await self._face.interrupt()
        return [
            {
                "type": "conversation.item.truncate",
                "item_id": item.item_id,
                "content_index": item.content_index,
                "audio_end_ms": 1_000 * item.speech.n_played // RATE_HZ,
            }
            for item in items
            if not item.speech.was_heard
        ]


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


if __name__ == "__main__":
    lines = Path(sys.argv[1]).read_text("utf-8").splitlines()
    address = sys.argv[2] if len(sys.argv) > 2 else "ws://127.0.0.1:8765"
    try:
        asyncio.run(main(map(json.loads, lines), address))
    except FaceError as error:
        sys.exit(f"the face: {error}")
