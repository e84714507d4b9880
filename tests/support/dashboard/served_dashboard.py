"""The dashboard's API behind its policy, served over real sockets to a face that is watched."""

import contextlib
import threading
import time

import httpx
from places import short_folder
from watched_face import WatchedFace

from lipservo.agents.listener import bind_listener
from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.web.api import make_api
from lipservo.dashboard.web.serving import server_of, with_access


class Dashboard:
    """address: of its HTTP; link: its hold on the face; face: the face itself."""

    def __init__(self, address, link, face):
        self.address = address
        self.link = link
        self.face = face
        self.streams = address.replace("http://", "ws://")

    def client(self, **options):
        return httpx.Client(base_url=self.address, timeout=20.0, trust_env=False, **options)


@contextlib.contextmanager
def served(status=None, *, token=None, ping_s=4.0, code=None):
    """A dashboard whose face has answered."""
    path = short_folder() / "tom.sock"
    with (
        WatchedFace(path, status) as face,
        served_for(lambda: path, token, ping_s, code) as dashboard,
    ):
        dashboard.face = face
        while dashboard.link.snapshot.servos_gone or not dashboard.link.answers:
            time.sleep(0.02)
        yield dashboard


@contextlib.contextmanager
def served_for(find, token=None, ping_s=4.0, code=None):
    """A dashboard of whatever face is found, or of none."""
    link = FaceLink(find, token)
    api = make_api(link)

    @contextlib.asynccontextmanager
    async def running(_app):
        async with link.running():
            yield

    api.router.lifespan_context = running
    listener = bind_listener("127.0.0.1:0", None)
    ready = threading.Event()
    server = server_of(with_access(api, link, token, code), ready.set, ping_s)
    thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
    thread.start()
    try:
        assert ready.wait(30.0)
        yield Dashboard(f"http://127.0.0.1:{listener.getsockname()[1]}", link, None)
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


def wait_for(condition):
    give_up_s = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < give_up_s, "nothing happened"
        time.sleep(0.02)
