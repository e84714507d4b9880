"""The twin on a page: the route that serves its head, and the NiceGUI element that draws it."""

import gzip
import hashlib
import threading
from collections.abc import Callable
from concurrent.futures import Future
from importlib import resources

import nicegui.elements.scene  # noqa: F401  registers three.js for the page, which twin.js loads
from fastapi import FastAPI, Request
from fastapi.responses import Response
from nicegui.element import Element

from lipsync.errors import check_extra
from lipsync.face.model import FaceModel

HEAD_PATH = "/twin/head.bin"
#: A browser keeps the head, but asks each time by its ETag whether it has changed.
_CACHE = "no-cache"


class PackedHead:
    """A face model's head for drawing, as bytes that `make` returns, called once in a thread."""

    def __init__(self, make: Callable[[], bytes]) -> None:
        self._result: Future[tuple[bytes, str]] = Future()
        threading.Thread(target=self._make, args=(make,), name="twin's head", daemon=True).start()

    def get(self) -> tuple[bytes, str]:
        """Return the bytes, compressed with gzip, and their ETag; waits until they are made."""
        return self._result.result()

    def _make(self, make: Callable[[], bytes]) -> None:
        """Call `make`; store its bytes, compressed, and their ETag, or its error, for `get`."""
        try:
            packed = make()
            tag = f'"{hashlib.sha256(packed).hexdigest()[:16]}"'
            self._result.set_result((gzip.compress(packed, compresslevel=4, mtime=0), tag))
        except Exception as error:  # whoever asks for the head is told
            self._result.set_exception(error)


def twin_routes(app: FastAPI, face: FaceModel) -> None:
    """Add the route HEAD_PATH, which serves a face model's head, and start making that head."""
    head = PackedHead(lambda: _packed_head(face))

    # Not async: FastAPI runs it in a thread of its own, so that other answers do not wait.
    @app.get(HEAD_PATH, include_in_schema=False)
    def serve(request: Request) -> Response:
        """Return the head's bytes, gzipped where the browser accepts that; 304 if it has them.

        Blocks until the head is made.
        """
        packed, tag = head.get()
        headers = {"ETag": tag, "Cache-Control": _CACHE, "Vary": "Accept-Encoding"}
        if tag in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        if "gzip" in request.headers.get("accept-encoding", ""):
            headers["Content-Encoding"] = "gzip"
        else:
            packed = gzip.decompress(packed)
        return Response(packed, media_type="application/octet-stream", headers=headers)


def _packed_head(face: FaceModel) -> bytes:
    """Return the bytes of the head that ships for a face model, else make one, which is slow.

    Raises MissingExtraError if scipy (the extra `fit`), needed to make one, is not installed.
    """
    shipped = resources.files("lipsync.models") / f"head-{face.checksum}.bin.gz"
    if shipped.is_file():
        return gzip.decompress(shipped.read_bytes())
    check_extra("scipy", "the head of a model of your own")
    from lipsync.twin.packed import pack
    from lipsync.twin.twin import make_twin

    return pack(make_twin(face))


class Twin(Element, component="twin.js", esm={"lipservo-twin": "picture"}):
    """A NiceGUI element: a head that shows frames. The layout sets its size: give it a height.

    In the page, `window.twin.apply(frame)` shows a frame of static/frame.js, the newest at the next
    redraw; `window.twin` also reports what is shown (picture/index.js). One twin a page.
    """

    def __init__(self, source: str = HEAD_PATH) -> None:
        super().__init__()
        self._props["source"] = source
        self.style("width: 100%; min-height: 240px")
