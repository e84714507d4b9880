"""`/api/twin` and `/api/state`: what the face does, thirty times a second."""

from fastapi import FastAPI, WebSocket

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.state_frame import state_hello, state_message
from lipservo.dashboard.twin_frame import hello
from lipservo.dashboard.web.frame_hub import FrameHub


def add_streams(app: FastAPI, link: FaceLink) -> dict[str, FrameHub]:
    """Add both to an application; the hubs, by name."""
    twin = FrameHub(lambda: link.layout, hello, lambda: link.frame)
    state = FrameHub(
        lambda: link.layout, state_hello, lambda: state_message(link.moment, link.layout)
    )
    link.on_moment += [twin.tick, state.tick]

    @app.websocket("/api/twin")
    async def serve_twin(socket: WebSocket) -> None:
        await twin.serve(socket)

    @app.websocket("/api/state")
    async def serve_state(socket: WebSocket) -> None:
        await state.serve(socket)

    return {"twin": twin, "state": state}
