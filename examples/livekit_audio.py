"""The audio frames of a LiveKit track speak through a running face.

Start:  python examples/livekit_audio.py [URL]

URL is where a face takes speech, ws://127.0.0.1:8765 without one. With livekit the frames are
`event.frame` of `async for event in rtc.AudioStream(track)`; here frames of the same fields carry
a tone in stereo. Printed is how much of it was heard.
"""

import asyncio
import sys
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from lipservo_client.async_face import AsyncFace
from lipservo_client.protocol import FaceError, Played

import lipservo


class AudioFrame(Protocol):
    """What is read of `livekit.rtc.AudioFrame`: int16, the channels of a sample side by side."""

    @property
    def data(self) -> memoryview:
        """Its samples."""

    @property
    def sample_rate(self) -> int:
        """Hz."""

    @property
    def num_channels(self) -> int:
        """1 or more."""


async def speak(face: AsyncFace, frames: AsyncIterator[AudioFrame]) -> Played:
    """Say the frames as one stream; channels are averaged."""
    first = await anext(frames)
    async with face.stream(first.sample_rate) as speech:
        await speech.write(mono(first))
        async for frame in frames:
            await speech.write(mono(frame))
        return await speech.wait()


def mono(frame: AudioFrame) -> bytes:
    """One channel of s16le."""
    samples = np.frombuffer(frame.data, dtype="<i2").reshape(-1, frame.num_channels)
    return bytes(np.rint(samples.mean(axis=1)).astype("<i2").tobytes())


@dataclass(frozen=True)
class ToneFrame:
    """10 ms of a tone in stereo, 48 kHz, as LiveKit sends them."""

    number: int
    sample_rate: int = 48_000
    num_channels: int = 2

    @property
    def data(self) -> memoryview:
        """(480 * 2,) int16."""
        time_s = (480 * self.number + np.arange(480)) / self.sample_rate
        tone = (8_000 * np.sin(2 * np.pi * 150 * time_s)).astype(np.int16)
        return memoryview(np.repeat(tone, 2).tobytes()).cast("h")


async def main(url: str) -> None:
    """Say half a second of a tone."""

    async def track() -> AsyncIterator[AudioFrame]:
        for number in range(50):
            yield ToneFrame(number)

    async with lipservo.connect_async(url) as face:
        played = await speak(face, track())
    print(f"heard {played.played_s:.2f} s, {'to the end' if played.finished else 'cut off'}")


if __name__ == "__main__":
    try:
        asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "ws://127.0.0.1:8765"))
    except FaceError as error:
        sys.exit(f"the face: {error}")
