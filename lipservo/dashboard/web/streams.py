"""`/api/twin` and `/api/state`: WebSockets of a face's frames, 30 a second, to many clients.

Each frame is made once; a slow client misses some and delays no other.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Final

from fastapi import FastAPI, WebSocket, WebSocketDisconnect

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.live_frames import hello, state_hello, state_message
from lipservo.runtime.status.live_board import BoardLayout

MOST_CLIENTS: Final = 64
#: A client that does not take a frame for so long reads no more, and is disconnected.
_SEND_TIMEOUT_S: Final = 5.0
_TRY_AGAIN_LATER: Final = 1013
Message = str | bytes


class FrameHub:
    """One stream of frames to many WebSocket clients.

    layout: returns the face's present layout. hello: returns the first message to a client for a
    layout, sent again when the layout changes. message: returns the newest frame; called at most
    once a tick, and only while a client waits for a frame. n_dropped: clients that were too slow,
    and were disconnected.
    """

    def __init__(
        self,
        layout: Callable[[], BoardLayout],
        hello: Callable[[BoardLayout], str],
        message: Callable[[], Message],
    ) -> None:
        self._layout = layout
        self._hello = hello
        self._message = message
        self._next_frame: asyncio.Future[tuple[BoardLayout, Message]] | None = None
        self.n_clients = 0
        self.n_dropped = 0

    def tick(self) -> None:
        """Send the newest frame to every client that waits for one; call once per new frame."""
        waiting, self._next_frame = self._next_frame, None
        if waiting is not None:
            waiting.set_result((self._layout(), self._message()))

    async def serve(self, socket: WebSocket) -> None:
        """Send frames to one client until it disconnects or reads none for 5 s.

        While 64 clients are connected, a further client is refused.
        """
        if self.n_clients >= MOST_CLIENTS:
            await socket.close(_TRY_AGAIN_LATER, f"{MOST_CLIENTS} clients are connected already")
            return
        self.n_clients += 1
        sending: asyncio.Task[None] | None = None
        try:
            await socket.accept()
            sending = asyncio.create_task(self._send_all(socket))
            listening = asyncio.create_task(_until_gone(socket))
            await asyncio.wait({sending, listening}, return_when=asyncio.FIRST_COMPLETED)
            for task in (sending, listening):
                task.cancel()
            await asyncio.gather(sending, listening, return_exceptions=True)
        finally:
            self.n_clients -= 1

    async def _send_all(self, socket: WebSocket) -> None:
        """Send a client each newest frame until it disconnects; before the first, the layout.

        The layout is sent again when it changes.
        """
        sent_layout: BoardLayout | None = None
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                layout, message = await self._wait_for_frame()
                if layout is not sent_layout:
                    await self._send_in_time(socket.send_text(self._hello(layout)))
                    sent_layout = layout
                if isinstance(message, bytes):
                    await self._send_in_time(socket.send_bytes(message))
                else:
                    await self._send_in_time(socket.send_text(message))

    async def _send_in_time(self, sending: Awaitable[None]) -> None:
        """Await a send; raise WebSocketDisconnect, and count it, if it takes longer than 5 s."""
        try:
            async with asyncio.timeout(_SEND_TIMEOUT_S):
                await sending
        except TimeoutError:
            self.n_dropped += 1
            raise WebSocketDisconnect from None

    async def _wait_for_frame(self) -> tuple[BoardLayout, Message]:
        """Return (layout, frame) of the next tick; all clients await one future."""
        if self._next_frame is None:
            self._next_frame = asyncio.get_running_loop().create_future()
        return await asyncio.shield(self._next_frame)


async def _until_gone(socket: WebSocket) -> None:
    """Discard a client's messages until it disconnects."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


def add_streams(app: FastAPI, link: FaceLink) -> dict[str, FrameHub]:
    """Add the WebSockets of both streams to an application; return their hubs by name."""
    twin = FrameHub(lambda: link.layout, hello, lambda: link.frame)
    state = FrameHub(
        lambda: link.layout, state_hello, lambda: state_message(link.snapshot, link.layout)
    )
    link.on_snapshot.extend((twin.tick, state.tick))

    @app.websocket("/api/twin")
    async def serve_twin(socket: WebSocket) -> None:
        await twin.serve(socket)

    @app.websocket("/api/state")
    async def serve_state(socket: WebSocket) -> None:
        await state.serve(socket)

    return {"twin": twin, "state": state}
