"""The trace of a face in three processes, written by the process that drives the servos.

Goals sent are known in it; the frame shown is read from the live board, where the speech process
writes it a hundred times a second.
"""

import logging
import threading
from collections.abc import Callable
from typing import Final, Self

import numpy as np

from firmware_bridge.loop.report import TickReport
from lipservo.runtime.requested_face import RequestedFace
from lipservo.runtime.status.live_board import LiveBoard
from lipservo.runtime.status.status_board import StatusBoard
from lipservo.runtime.status.street_tick import StreetTick
from lipservo.traces.trace_file import BackgroundTrace, TraceFile
from lipsync.errors import UserError
from lipsync.face.frame import Frame

_LOG: Final = logging.getLogger(__name__)
#: The thread that opens the file checks so often whether the speech process has written a status.
_POLL_S: Final = 0.05
_END_S: Final = 2.0


class SupervisedTrace:
    """A trace (record) of every bridge tick, from the speech side's first status on."""

    def __init__(
        self,
        requested: RequestedFace,
        notes: StatusBoard,
        live: LiveBoard,
        beat: Callable[[], None],
    ) -> None:
        """Prepare the trace that `requested` names; its file is opened by a thread, within `with`.

        notes: the board from which the speech process's status is read, for the trace's header.
        live: the board from which the frames of the face shown are read. beat: sends a heartbeat;
        called while a slow disk takes the end of the trace.
        """
        self._requested = requested
        self._notes = notes
        self._live = live
        self._beat = beat
        self._closed = threading.Event()
        self._trace: BackgroundTrace | None = None
        self._opener = threading.Thread(target=self._open, name="trace of a daemon", daemon=True)
        self._record_number = 0
        self._shown: tuple[float, float, str, Frame] | None = None

    def observe(self, report: TickReport) -> None:
        """Record one tick of the bridge with the newest frame that the speech process published.

        The frame's sound time is carried forward to the tick. Nothing is recorded before the trace
        is open and a first frame was published.
        """
        if self._trace is None:
            return
        for number, shown in self._live.speech_since(self._record_number)[-1:]:
            self._record_number = number
            phoneme = self._live.layout.phonemes[int(shown["phoneme"])]
            sound_s = float(shown["sound_s"])
            frame = Frame(sound_s, np.array(shown["coefficients"], dtype=np.float64))
            self._shown = float(shown["time_s"]), sound_s, phoneme, frame
        if self._shown is not None:
            shown_s, sound_s, phoneme, frame = self._shown
            tick_sound_s = sound_s + report.time_s - shown_s
            self._trace.observe(StreetTick(tick_sound_s, phoneme, frame, report))

    def __enter__(self) -> Self:
        self._opener.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._closed.set()
        for _ in range(round(_END_S / _POLL_S)):
            if self._opener.is_alive():
                self._beat()
                self._opener.join(_POLL_S)
        if self._trace is not None:
            self._trace.__exit__(*exc)

    def _open(self) -> None:
        """Open the trace once the speech process has written a status, which the header needs.

        Runs in a thread. A file that cannot be written is logged, and the face runs without trace.
        """
        while (speech := self._notes.speech()) is None:
            if self._closed.wait(_POLL_S):
                return
        path = self._requested.request.trace
        assert path is not None
        try:
            file = TraceFile(path, self._requested.trace_header(speech))
        except UserError as error:
            _LOG.error("%s", error)
            return
        self._trace = BackgroundTrace(file, self._beat)
