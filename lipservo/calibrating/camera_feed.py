"""A thread that reads a camera; whoever records takes what has come."""

import threading
from collections import deque

from lipservo.calibrating.camera import Camera, CameraError, Frame

#: Pictures that wait to be taken, four seconds of them; the oldest are dropped.
_WAITING = 120


class CameraFeed:
    """The pictures of a camera as they come. Use it as a context manager."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self._waiting: deque[Frame] = deque(maxlen=_WAITING)
        self._stopping = threading.Event()
        self._failure: CameraError | None = None
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)

    def take_frames(self) -> list[Frame]:
        """What has come since the last call. Raises CameraError once the camera has failed."""
        frames: list[Frame] = []
        while self._waiting:
            frames.append(self._waiting.popleft())
        if not frames and self._failure is not None:
            raise self._failure
        return frames

    def __enter__(self) -> "CameraFeed":
        self.camera.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._stopping.set()
        # FFmpeg must not lose a device while it reads it; one that gives nothing is left behind.
        self._thread.join(timeout=1.0)
        if not self._thread.is_alive():
            self.camera.__exit__(*exc)

    def _read(self) -> None:
        try:
            for frame in self.camera.frames():
                if self._stopping.is_set():
                    return
                self._waiting.append(frame)
            self._failure = CameraError(f"camera {self.camera.name!r}: its pictures have ended")
        except CameraError as error:
            self._failure = error
