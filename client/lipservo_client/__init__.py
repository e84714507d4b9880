"""The client through which a program speaks with a face: `connect` and `connect_async`.

A client needs websockets alone, and numpy only where it sends arrays. The protocol is
docs/agents.md.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lipservo_client.async_face import AsyncFace
    from lipservo_client.blocking_face import Face

_URL = "ws://127.0.0.1:8765"


def connect(url: str = _URL, token: str | None = None) -> "Face":
    """Return a blocking client of a face: `with lipservo.connect() as face:`; docs/agents.md.

    Entering the client connects, or raises `lipservo_client.protocol.FaceError` if no face answers
    at `url` or accepts the client. token: that the face requires; None: that in its runtime folder,
    for a face of this computer, else none.
    """
    from lipservo_client.blocking_face import Face

    return Face(url, token)


def connect_async(url: str = _URL, token: str | None = None) -> "AsyncFace":
    """Return an asyncio client of a face: `async with lipservo.connect_async() as face:`.

    Arguments and errors: as of `connect`.
    """
    from lipservo_client.async_face import AsyncFace

    return AsyncFace(url, token)
