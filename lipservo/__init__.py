"""The program: puts the street together, from sound to servos.

`connect` and `connect_async` speak through a face that runs, here or on another computer.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lipservo_client.async_face import AsyncFace
    from lipservo_client.blocking_face import Face

_URL = "ws://127.0.0.1:8765"


def connect(url: str = _URL, token: str | None = None) -> "Face":
    """A running face to speak through: `with lipservo.connect() as face:`; docs/agents.md.

    Entering it raises `lipservo_client.face_answers.FaceError` where none answers or lets us in.
    """
    from lipservo_client.blocking_face import Face

    return Face(url, token)


def connect_async(url: str = _URL, token: str | None = None) -> "AsyncFace":
    """The same for asyncio: `async with lipservo.connect_async() as face:`."""
    from lipservo_client.async_face import AsyncFace

    return AsyncFace(url, token)
