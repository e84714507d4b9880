"""A sound device that is looked after: when it is lost it is opened again, by name.

All that takes long, opening and closing, is done by a thread of its own; whoever plays or listens
never waits.
"""

import contextlib
import threading
from collections.abc import Callable
from typing import Final

from lipsync.audio.devices import OpenStream, close_stream, list_anew, opening
from lipsync.audio.source import SoundError

#: A device that has not asked for sound, or brought any, for so long is lost.
SILENT_S: Final = 0.5
#: But not so soon after it was opened: a PulseAudio sink that slept took 1.1 s to begin.
SETTLING_S: Final = 3.0
#: It is tried so often, once it is lost.
RETRY_S: Final = 1.0
#: It is looked at so often.
LOOK_S: Final = 0.1


class DeviceWatch:
    """Keeps one stream open.

    `open_stream` finds the device by the names that there are now and starts a stream of it; it
    raises SoundError where that cannot be done. The stream's callback writes the
    monotonic time of each of its calls into `called_s`.
    """

    def __init__(self, open_stream: Callable[[], OpenStream], clock: Callable[[], float]) -> None:
        self._open_stream = open_stream
        self._clock = clock
        self._opened_s = self._tried_s = self.called_s = clock()
        self._stream: OpenStream | None = None
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._n_losses = 0

    @property
    def is_lost(self) -> bool:
        """No stream is open, or the one that is has stopped."""
        return self._stream is None

    @property
    def n_losses(self) -> int:
        """How often the device was lost so far."""
        return self._n_losses

    @property
    def stream(self) -> OpenStream | None:
        """The stream; None while the device is lost."""
        return self._stream

    def open(self) -> None:
        """Open the device for the first time, here and now. Raises SoundError."""
        with opening():
            self._start()

    def start(self) -> None:
        """Look after it from now on, in a thread of its own."""
        self._ending.clear()
        self._thread = threading.Thread(target=self._run, name="sound device", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop looking, and close what is open; waits for an opening that is under way."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._close()

    def look(self) -> None:
        """Notice a loss; open what is lost, when the last try is long enough ago."""
        now_s = self._clock()
        stream = self._stream
        if stream is not None and self._has_stopped(stream, now_s):
            self._n_losses += 1
            self._close()
        if self._stream is None and now_s - self._tried_s >= RETRY_S:
            with opening(), contextlib.suppress(SoundError):  # the next try may do better
                list_anew()
                self._start()

    def _has_stopped(self, stream: OpenStream, now_s: float) -> bool:
        is_settled = now_s - self._opened_s > SETTLING_S
        return not stream.active or (is_settled and now_s - self.called_s > SILENT_S)

    def _start(self) -> None:
        self._tried_s = self._clock()
        stream = self._open_stream()
        self._opened_s = self.called_s = self._clock()
        self._stream = stream

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            close_stream(stream)

    def _run(self) -> None:
        while not self._ending.wait(LOOK_S):
            self.look()
