"""Write one clip as a Matroska file: pictures with their time stamps, and their sound."""

import queue
import threading
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.output_file import OutputError

Samples = NDArray[np.float32]

#: Matroska's time stamps are whole milliseconds; with the same clock nothing is rounded again.
_TICKS_HZ = 1000
#: Lips are measured in the pictures, so nothing may be smoothed away: x264 calls 17 visually
#: lossless. The fastest preset, as a camera does not wait for smaller files.
_X264 = {"crf": "17", "preset": "ultrafast"}
#: The codec that every build of FFmpeg has, at its best quality.
_MPEG4 = {"qmin": "2", "qmax": "3"}
#: Pictures that may wait for compression: two seconds, 80 MB at 1280 x 720.
_WAITING = 60


class ClipWriter:
    """Writes pictures as they come, and the sound at the end; the first picture is at time 0.

    Pictures are compressed in a thread of their own, as the recording thread must fetch sound.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        """Open the file, and start the thread that compresses pictures.

        rate_hz: nominal pictures a second.
        """
        import av

        self._av = av
        self._path = path
        self._container: Any = av.open(str(path), "w", format="matroska")
        self._rate = Fraction(rate_hz).limit_denominator(1001)
        self._stream: Any = None
        self._sound: Any = None
        self._last_tick = -1
        self._failure = ""
        self._waiting: queue.Queue[Any] = queue.Queue(_WAITING)
        self._thread = threading.Thread(target=self._compress, name="clip", daemon=True)
        self._thread.start()

    def add_frame(self, time_s: float, frame: Any) -> bool:
        """Queue the next picture (av.VideoFrame), time_s after the first one.

        Return False, without queueing, if it is not later than the last one, or if compression is
        two seconds behind.
        """
        tick = round(time_s * _TICKS_HZ)
        if tick <= self._last_tick:
            return False
        try:
            self._waiting.put_nowait((tick, frame))
        except queue.Full:
            return False
        self._last_tick = tick
        return True

    def finish(self, samples: Samples) -> None:
        """Write the sound (n,) at 16 kHz, which begins with the first picture, and close the file.

        Blocks until all pictures are compressed. There must have been a picture. Raises OutputError
        if the clip cannot be written.
        """
        self._end_thread()
        try:
            if not self._failure:
                self._write_sound(samples)
        except self._av.FFmpegError as error:
            self._failure = error.strerror or str(error)
        if self._failure:
            raise OutputError(f"{self._path}: cannot be written: {self._failure}")

    def close(self) -> None:
        """Close the file, whether it is complete or not."""
        self._end_thread()
        try:
            self._container.close()
        except self._av.FFmpegError:
            return  # the file is discarded

    def _write_sound(self, samples: Samples) -> None:
        """Write the last pictures, then the whole sound (n,) as 16-bit PCM, and close the file."""
        self._container.mux(self._stream.encode(None))
        pcm = np.rint(np.clip(samples, -1.0, 1.0) * 32767.0).astype(np.int16)[None]
        block = self._av.AudioFrame.from_ndarray(pcm, format="s16", layout="mono")
        block.sample_rate, block.pts = SAMPLE_RATE_HZ, 0
        block.time_base = Fraction(1, SAMPLE_RATE_HZ)
        self._container.mux(self._sound.encode(block))
        self._container.mux(self._sound.encode(None))
        self._container.close()

    def _end_thread(self) -> None:
        """Let the thread compress what is queued, and end it."""
        if self._thread.is_alive():
            self._waiting.put(None)
            self._thread.join()

    def _compress(self) -> None:
        """Compress queued pictures until None is queued; after a failure drop the rest.

        Runs in a thread of its own.
        """
        while (item := self._waiting.get()) is not None:
            if self._failure:
                continue  # the queue must not fill
            try:
                self._write_frame(*item)
            except self._av.FFmpegError as error:
                self._failure = error.strerror or str(error)

    def _write_frame(self, tick: int, frame: Any) -> None:
        """Encode one picture at a tick of the clip's clock; the first one sets size and streams."""
        if self._stream is None:
            self._make_streams(frame)
        picture = frame.reformat(self._stream.width, self._stream.height, format="yuv420p")
        picture.pts, picture.time_base = tick, Fraction(1, _TICKS_HZ)
        # Let the encoder choose key frames; the camera's choice does not apply.
        picture.pict_type = self._av.video.frame.PictureType.NONE
        self._container.mux(self._stream.encode(picture))

    def _make_streams(self, frame: Any) -> None:
        """Make the streams of pictures and sound, which a Matroska file lists at its beginning."""
        has_x264 = "libx264" in self._av.codecs_available
        name, options = ("libx264", _X264) if has_x264 else ("mpeg4", _MPEG4)
        stream = self._container.add_stream(name, rate=self._rate, options=options)
        # x264 wants even sizes.
        stream.width, stream.height = frame.width // 2 * 2, frame.height // 2 * 2
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, _TICKS_HZ)
        self._stream = stream
        self._sound = self._container.add_stream("pcm_s16le", rate=SAMPLE_RATE_HZ, layout="mono")
