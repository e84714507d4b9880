"""Pictures of a camera, by PyAV, each with the monotonic time at which it was taken.

A time stamp of FFmpeg's v4l2 input is the kernel's own, on the monotonic clock. Time stamps of
other clocks are converted by the least delay of recent pictures. A file or FFmpeg's lavfi
generators may replace a camera; their pictures come at the pace of their time stamps. A thread
reads the camera and keeps the pictures until they are fetched.
"""

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lipsync.errors import UserError, check_extra

#: FFmpeg's picture (av.VideoFrame) and the monotonic time at which it was taken.
Frame = tuple[float, Any]

GENERATED = "lavfi:"
#: A time stamp that is older than this when its picture arrives is of another clock.
_OLDEST_S = 2.0
#: The least delay of so many frames tells where another clock's zero lies: five seconds.
_N_DELAYS = 150
#: A camera that has given nothing for so long has failed, in microseconds for FFmpeg.
_PATIENCE_S = 5.0


class CameraError(UserError):
    """A camera that cannot be opened or has failed; one line: which one, why, and the remedy."""


@dataclass(frozen=True, slots=True)
class CameraMode:
    """The requested picture format. width, height: pixels; rate_hz: pictures per second."""

    width: int = 1280
    height: int = 720
    rate_hz: float = 30.0


class AvCamera:
    """A camera, or a video file or generator in its place, read by PyAV.

    wanted: number or path of a device; `lavfi:GRAPH` or a video file replaces a camera. mode:
    picture format to request; None: the default. Raises UserError without the extra
    `video`, and CameraError from `__enter__` if it cannot be opened.
    """

    def __init__(
        self,
        wanted: str,
        mode: CameraMode | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Store what to open; nothing is opened yet. Raises UserError without the extra `video`.

        wanted: number or path of a device, `lavfi:GRAPH` or a video file; mode: picture format,
        None: the default; clock, sleep: of the monotonic time, in seconds.
        """
        check_extra("ai_edge_litert", "recording a camera")
        self._wanted, self._mode = wanted, mode or CameraMode()
        self._clock, self._sleep = clock, sleep
        self._replaces_camera = wanted.startswith(GENERATED) or Path(wanted).is_file()

    @property
    def name(self) -> str:
        """The name of the camera as the user gave it."""
        return self._wanted

    @property
    def rate_hz(self) -> float:
        """Pictures per second as the opened stream reports them, else as requested."""
        return float(self._stream.average_rate or self._mode.rate_hz)

    def __enter__(self) -> "AvCamera":
        """Open the camera in the first picture format that works, or raise CameraError."""
        import av

        reason = ""
        for source, settings in self._sources_to_try():
            try:
                self._container = av.open(source, timeout=_PATIENCE_S, **settings)
                self._stream = self._container.streams.video[0]
            except (av.FFmpegError, ValueError, IndexError) as error:
                reason = reason or getattr(error, "strerror", None) or str(error)
            else:
                return self
        raise CameraError(
            f"camera {self.name!r} cannot be opened ({reason}); close other programs that use it, "
            "or choose another with --camera"
        )

    def __exit__(self, *exc: object) -> None:
        self._container.close()

    def frames(self) -> Iterator[Frame]:
        """Yield (monotonic s, picture) until a file ends; raise CameraError if the camera fails."""
        import av

        picture_time_s = self._wait_until_due if self._replaces_camera else StampClock().time_s
        try:
            for frame in self._container.decode(self._stream):
                if frame.time is not None:
                    yield picture_time_s(float(frame.time), self._clock()), frame
        except av.FFmpegError as error:
            raise CameraError(
                f"camera {self.name!r} has failed ({error.strerror}); plug it in again"
            ) from error

    def _wait_until_due(self, stamp_s: float, now_s: float) -> float:
        """Wait until the picture of a file at `stamp_s` is due; return that monotonic time.

        The first picture is due at once.
        """
        self._begun_s = getattr(self, "_begun_s", now_s - stamp_s)
        due_s = self._begun_s + stamp_s
        self._sleep(max(0.0, due_s - now_s))
        return due_s

    def _sources_to_try(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the sources and options of `av.open` to try in order, the best first."""
        if self._wanted.startswith(GENERATED):
            yield self._wanted.removeprefix(GENERATED), {"format": "lavfi"}
            return
        if self._replaces_camera:
            yield self._wanted, {}
            return
        size = {"video_size": f"{self._mode.width}x{self._mode.height}"}
        rate = {"framerate": f"{self._mode.rate_hz:g}"}
        if sys.platform == "darwin":
            yield self._wanted, {"format": "avfoundation", "options": size | rate}
            return
        device = f"/dev/video{self._wanted}" if self._wanted.isdecimal() else self._wanted
        # Uncompressed pictures of this size are too much for USB 2 at 30 a second.
        for options in ({"input_format": "mjpeg"} | size | rate, size | rate, {}):
            yield device, {"format": "v4l2", "options": options}


class StampClock:
    """A converter of a camera's time stamps to the monotonic clock."""

    def __init__(self) -> None:
        self._delays_s: deque[float] = deque(maxlen=_N_DELAYS)

    def time_s(self, stamp_s: float, now_s: float) -> float:
        """Return the monotonic time at which a picture was taken.

        stamp_s: its time stamp, which is used as it is if it lies up to two seconds before `now_s`;
        else it is of another clock, and shifted by the least delay of recent pictures. now_s: the
        monotonic time of the picture's arrival.
        """
        if 0.0 <= now_s - stamp_s < _OLDEST_S:
            return stamp_s
        self._delays_s.append(now_s - stamp_s)
        return stamp_s + min(self._delays_s, default=math.nan)


#: Pictures that wait to be taken, four seconds of them; the oldest are dropped.
_MOST_WAITING = 120


class CameraFeed:
    """The newest 120 pictures of a camera, read by a thread inside a `with` block."""

    def __init__(self, camera: AvCamera) -> None:
        self.camera = camera
        self._waiting: deque[Frame] = deque(maxlen=_MOST_WAITING)
        self._stopping = threading.Event()
        self._failure: CameraError | None = None
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)

    def take_frames(self) -> list[Frame]:
        """Remove and return the pictures since the last call; empty: none has come.

        Raises CameraError if there are none and the camera has failed or ended.
        """
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
        """Store the camera's pictures until the `with` block ends or the camera fails.

        Runs in thread `camera`. The failure, or the end of a file, is stored for `take_frames` to
        raise.
        """
        try:
            for frame in self.camera.frames():
                if self._stopping.is_set():
                    return
                self._waiting.append(frame)
            self._failure = CameraError(f"camera {self.camera.name!r} stopped sending pictures")
        except CameraError as error:
            self._failure = error
