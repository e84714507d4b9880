"""What a program needs to speak through a face: `connect` and `connect_async`.

A client needs websockets alone, and numpy only where it writes arrays. The protocol is
docs/agents.md.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lipservo_client.async_face import AsyncFace
    from lipservo_client.blocking_face import Face

_URL = "ws://127.0.0.1:8765"


def connect(url: str = _URL, token: str | None = None) -> "Face":
    """A running face to speak through: `with lipservo.connect() as face:`; docs/agents.md.

    Entering it raises `lipservo_client.protocol.FaceError` where none answers or lets us in.
    """
    from lipservo_client.blocking_face import Face

    return Face(url, token)


def connect_async(url: str = _URL, token: str | None = None) -> "AsyncFace":
    """Connect in asyncio: `async with lipservo.connect_async() as face:`."""
    from lipservo_client.async_face import AsyncFace

    return AsyncFace(url, token)
