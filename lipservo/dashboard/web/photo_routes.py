"""Routes that return a photograph's warp for landmarks from a browser, which keeps the picture.

As with a robot's own model, nothing of a person is stored or sent: the browser has the pixels, and
sends twenty points and a size (docs/decisions/page-and-kiosk.md).
"""

import gzip
import threading
from importlib import resources
from typing import TYPE_CHECKING, Final

import numpy as np
from fastapi import FastAPI
from fastapi.responses import FileResponse, JSONResponse, Response
from pydantic import BaseModel, Field

from lipsync.errors import MissingExtraError, UserError, check_extra
from lipsync.face.model import FaceModel

if TYPE_CHECKING:
    from lipservo.display.photo_file import Landmarks

PHOTO_PATH: Final = "/twin/photo"
#: A browser makes larger pictures smaller before it shows them.
_LONGEST_SIDE_PX: Final = 4096


class PhotoPoints(BaseModel):
    """A photograph's (width, height) and its face's named points, all in pixels."""

    size: tuple[int, int]
    points_px: dict[str, list[float]] = Field(max_length=500)


def photo_routes(app: FastAPI, face: FaceModel) -> None:
    """Add routes for the shipped picture, its points and warp, and the warp of posted points.

    A warp moves a photograph's pixels with the face model. Without scipy (the extra `fit`) all
    these routes answer 422 with one line.
    """
    try:
        check_extra("scipy", "a photograph that speaks")
    except MissingExtraError as error:
        answer = {"error": str(error)}

        @app.api_route(f"{PHOTO_PATH}.{{rest}}", methods=["GET", "POST"], include_in_schema=False)
        def answer_extra_missing(rest: str) -> Response:  # noqa: ARG001 - a path's part
            return JSONResponse(answer, 422)

        return
    from lipservo.display.photo_face import HAND_POINTS, photo_face
    from lipservo.display.photo_file import landmarks_of
    from lipservo.display.photo_packed import pack_photo
    from lipservo.display.shipped_faces import TWIN_SIZE, twin_landmarks

    one_at_a_time = threading.Lock()

    def warp(landmarks: "Landmarks", size: tuple[int, int]) -> Response:
        """Return the warp of a picture of `size` (width, height) with these landmarks, gzipped.

        Blocks while another warp is computed.
        """
        # The warp depends on the landmarks alone: a picture of zeros stands for the pixels.
        no_pixels = np.broadcast_to(np.uint8(0), (size[1], size[0], 3))
        with one_at_a_time:
            packed = pack_photo(photo_face(no_pixels, landmarks, face), face)
        headers = {"Content-Encoding": "gzip", "Cache-Control": "no-store"}
        return Response(
            gzip.compress(packed, compresslevel=4),
            media_type="application/octet-stream",
            headers=headers,
        )

    # Not async: FastAPI runs them in threads, so that other answers do not wait.
    @app.get(f"{PHOTO_PATH}.jpg", include_in_schema=False)
    def picture() -> Response:
        with resources.as_file(resources.files("lipservo.display") / "twin.jpg") as path:
            return FileResponse(path, headers={"Cache-Control": "no-cache"})

    @app.get(f"{PHOTO_PATH}.json", include_in_schema=False)
    def points() -> Response:
        landmarks = twin_landmarks()
        named_px = {name: np.round(landmarks[n][:2], 1).tolist() for name, n in HAND_POINTS.items()}
        return JSONResponse({"size": TWIN_SIZE, "points_px": named_px})

    @app.get(f"{PHOTO_PATH}.bin", include_in_schema=False)
    def shipped_warp() -> Response:
        return warp(twin_landmarks(), TWIN_SIZE)

    @app.post(f"{PHOTO_PATH}.bin", include_in_schema=False)
    def warp_of_points(given: PhotoPoints) -> Response:
        try:
            if not all(64 <= each <= _LONGEST_SIDE_PX for each in given.size):
                raise UserError(f"width and height must be 64 to {_LONGEST_SIDE_PX} pixels")
            return warp(landmarks_of(given.points_px), given.size)
        except UserError as error:
            return JSONResponse({"error": str(error)}, 422)
