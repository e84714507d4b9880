"""A voice agent with an event loop: it speaks in chunks as they come, and a person breaks in.

Start:  python examples/voice_agent.py [URL]

URL is where a face takes speech, ws://127.0.0.1:8765 without one. A tone stands for the voice, half
a second of speech for the person. Printed is what the agent remembers to have said.
"""

import asyncio
import math
import struct
import sys
from collections.abc import AsyncIterator

from lipservo_client.protocol import FaceError

import lipservo

RATE_HZ = 24_000


async def voice() -> AsyncIterator[bytes]:
    """Ten seconds of a tone, in chunks of 0.1 s, faster than they are said."""
    for chunk in range(100):
        times = range(chunk * RATE_HZ // 10, (chunk + 1) * RATE_HZ // 10)
        yield b"".join(struct.pack("<h", int(8_000 * math.sin(0.05 * n))) for n in times)
        await asyncio.sleep(0.01)


async def main(url: str) -> None:
    """Speak until a person breaks in."""
    async with lipservo.connect_async(url) as face:

        async def person_breaks_in() -> None:
            async for event in face.events():
                if event["type"] == "position" and event["played_s"] > 0.5:
                    await face.interrupt()
                    return

        person = asyncio.create_task(person_breaks_in())
        async with face.stream(RATE_HZ) as speech:
            async for chunk in voice():
                if not await speech.write(chunk):
                    break
            played = await speech.wait()
        await person
    print(f"heard {played.played_s:.2f} s, {played.dropped_s:.2f} s were never heard")


if __name__ == "__main__":
    try:
        asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "ws://127.0.0.1:8765"))
    except FaceError as error:
        sys.exit(f"the face: {error}")
