"""The audio events of OpenAI's Realtime API speak through a running face.

Start:  python examples/openai_realtime.py EVENTS [URL]

EVENTS is a file of server events, one JSON object a line, as they come over the wire; in an agent
they come from its own connection. URL is where a face takes speech, ws://127.0.0.1:8765 without
one. Printed is what the agent sends back: after a barge-in, how much of the item was heard.
"""

import asyncio
import base64
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lipservo_client.async_face import AsyncFace, AsyncSpeech

import lipservo

#: The API's `pcm16` is 24 kHz, mono, s16le, as base64.
RATE_HZ = 24_000
#: The name of today, and that of the beta.
DELTAS = {"response.output_audio.delta", "response.audio.delta"}
DONES = {"response.output_audio.done", "response.audio.done"}


class RealtimeVoice:
    """Hands on the audio of one session, item by item."""

    def __init__(self, face: AsyncFace) -> None:
        self._face = face
        self._speech: AsyncSpeech | None = None
        self._item: dict[str, Any] = {}

    async def hear(self, event: dict[str, Any]) -> dict[str, Any] | None:
        """Do what one server event asks for; the client event to answer with, if any."""
        if event["type"] in DELTAS:
            if self._speech is None:
                self._item = event
                self._speech = self._face.stream(RATE_HZ)
                await self._speech.__aenter__()
            await self._speech.write(base64.b64decode(event["delta"]))
        elif event["type"] in DONES and self._speech is not None:
            await self._speech.end()
            self._speech = None
        elif event["type"] == "input_audio_buffer.speech_started":
            self._speech = None
            played = await self._face.interrupt()
            if played is not None and not played.finished:
                return {
                    "type": "conversation.item.truncate",
                    "item_id": self._item["item_id"],
                    "content_index": self._item["content_index"],
                    "audio_end_ms": round(1e3 * played.played_s),
                }
        return None


async def main(events: Iterable[dict[str, Any]], url: str) -> None:
    """Say what the events carry."""
    async with lipservo.connect_async(url) as face:
        voice = RealtimeVoice(face)
        for event in events:
            answer = await voice.hear(event)
            if answer is not None:
                print(json.dumps(answer))


if __name__ == "__main__":
    lines = Path(sys.argv[1]).read_text("utf-8").splitlines()
    address = sys.argv[2] if len(sys.argv) > 2 else "ws://127.0.0.1:8765"
    asyncio.run(main(map(json.loads, lines), address))
