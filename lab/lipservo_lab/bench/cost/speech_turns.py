"""The speech process of a checkout on a virtual clock, in turns; started as a script.

`python speech_turns.py ROOT OUTPUT FACE SOUND CLIP N_CYCLES` runs `run_speech_process` of the
checkout ROOT: the whole loop, with lifeline, status and live board. For each line on standard input
it runs one turn and prints what it cost as JSON. In a cycle of two turns the face first speaks,
then gets silence. OUTPUT gets the targets in the end. The processes of two checkouts can so be run
in turns.
"""

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, Final

SPEECH_S: Final = 3.0
REST_S: Final = 8.0
#: Nothing is counted for so long after speech begins: the delay from sound to face; and after it
#: ends: the way to rest, and the arousal that fades.
_BEGINS_AFTER_S: Final = 1.0
_RESTS_AFTER_S: Final = 5.0
CYCLE_S: Final = SPEECH_S + REST_S
_BEGINS_S: Final = 1000.0
_RATE_HZ: Final = 16_000


class CallCounter:
    """A counter of calls, of Python and of C functions, for `sys.setprofile`."""

    def __init__(self) -> None:
        self.python = self.c = 0

    def profile(self, _frame: FrameType, event: str, _arg: Any) -> None:
        """Count one event of the interpreter."""
        if event == "call":
            self.python += 1
        elif event == "c_call":
            self.c += 1


class _NoMoreTurns(BaseException):
    """Ends the process's loop: there is no further turn."""


class VirtualTime:
    """The monotonic clock of the process: it jumps to the time that the loop waits for.

    At the borders of turns it waits for a line on standard input. `sentences`: each puts the next
    sentence in the playout, once it is due; [] where the sound is a file.
    """

    def __init__(self) -> None:
        self.now_s = _BEGINS_S
        self.started_s = 0.0
        self.sentences: list[Callable[[], None]] = []
        self._borders: list[tuple[float, str]] = []
        self._n_cycles = 0
        self._counter: CallCounter | None = None
        self._began = (0.0, 0.0)

    def now(self) -> float:
        """Return the virtual time, s."""
        return self.now_s

    def sleep_until(self, time_s: float) -> None:
        """Jump to `time_s`; begin and end the turns on the way, which may block for input."""
        if not self.started_s:
            self.started_s = self.now_s
        while not self._borders or time_s >= self._borders[0][0]:
            if not self._borders:
                self._plan_cycle()
                continue
            border_s, event = self._borders.pop(0)
            self.now_s = max(self.now_s, border_s)
            self._begin_or_end_turn(event)
        self.now_s = max(self.now_s, time_s)

    def sleep(self, seconds: float) -> None:
        """Jump on by `seconds`."""
        self.sleep_until(self.now_s + seconds)

    def _plan_cycle(self) -> None:
        """Set when the next cycle speaks, and when its two measured turns begin and end."""
        begin_s = self.started_s + self._n_cycles * CYCLE_S
        self._n_cycles += 1
        silent_s, end_s = begin_s + SPEECH_S, begin_s + CYCLE_S
        self._borders = [
            (begin_s, "say"), (begin_s + _BEGINS_AFTER_S, "begin"), (silent_s, "end"),
            (silent_s + _RESTS_AFTER_S, "begin"), (end_s, "end"),
        ]  # fmt: skip

    def _begin_or_end_turn(self, event: str) -> None:
        """Do what is due at a border: "say" queues speech, "begin" and "end" bound a measured turn.

        "begin" blocks for a line on standard input ("count...": calls are counted as well) and
        raises `_NoMoreTurns` at the end of input; "end" prints virtual seconds, processor seconds
        and calls as JSON.
        """
        if event == "say":
            for say in self.sentences:
                say()
        elif event == "begin":
            line = sys.stdin.readline()
            if not line:
                raise _NoMoreTurns
            if line.startswith("count"):
                self._counter = CallCounter()
                sys.setprofile(self._counter.profile)
            self._began = self.now_s, time.process_time()
        else:
            spent_s = time.process_time() - self._began[1]
            sys.setprofile(None)
            costs: dict[str, float] = {"seconds": self.now_s - self._began[0], "spent_s": spent_s}
            if self._counter is not None:
                costs |= {"python_calls": self._counter.python, "c_calls": self._counter.c}
                self._counter = None
            sys.stdout.write(json.dumps(costs) + "\n")
            sys.stdout.flush()


def _one_cycle(samples: Any) -> Any:
    """Return the sound of one cycle, (n,): speech from `samples`, then digital silence."""
    import numpy as np

    speech = np.resize(samples, round((SPEECH_S - 0.5) * _RATE_HZ)).astype(np.float32)
    return np.concatenate([speech, np.zeros(round(CYCLE_S * _RATE_HZ) - len(speech), np.float32)])


def main(output: str, face: str, sound: str, clip: str, n_cycles: int) -> None:
    """Run the speech process of `face` in turns until standard input ends, then write its targets.

    output: .npz file of the targets. sound: "voice": the face speaks and has no microphone; "file":
    it listens to a recording with digital silence in it. clip: file of the speech. n_cycles: length
    of that recording in cycles. Never returns: the process exits.
    """
    clock = VirtualTime()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as `lipservo.__main__` does
    time.monotonic = time.perf_counter = clock.now  # a busy computer takes no recogniser away
    import socket

    import numpy as np
    import soundfile

    from firmware_bridge import clock as clocks
    from firmware_bridge.loop import targets
    from firmware_bridge.process.lifeline import Lifeline, lifeline_pair
    from lipservo.runtime import face_speech, processes
    from lipservo.runtime.requested_face import RequestedFace
    from lipservo.runtime.run_request import SILENCE, RunRequest, Sound, VoiceOptions
    from lipservo.runtime.status.status_board import StatusBoard
    from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream

    # What the loop uses is put in the place of clock, channel and speech.
    modules: dict[str, Any] = {"clocks": clocks, "targets": targets, "speech": face_speech}
    modules["clocks"].MonotonicClock = lambda: clock
    samples, _ = soundfile.read(clip, dtype="float32")  # the bundled clip, at 16 kHz
    speech = _one_cycle(samples)
    published: list[tuple[float, float, Any]] = []

    class Recording(targets.SocketTargetChannel):
        def publish(self, targets: Any) -> None:
            published.append((clock.now_s, targets.time_s, targets.positions_deg.copy()))

    modules["targets"].SocketTargetChannel = Recording
    # The class itself: `with_words` takes its place.
    made = face_speech.FaceSpeech

    def with_words(*arguments: Any, **options: Any) -> Any:
        """Make a FaceSpeech; with sound "voice", let each cycle put speech in its playout."""
        face_speech_object: Any = made(*arguments, **options)
        source = face_speech_object.source
        if sound == "voice":

            def say() -> None:
                stream = PlayoutStream("speech", _RATE_HZ, source.output_rate_hz)
                stream.push(speech[: round((SPEECH_S - 0.5) * _RATE_HZ)])
                stream.end()
                source.requests.append(PlayoutRequest("say", stream))

            clock.sentences.append(say)
        return face_speech_object

    modules["speech"].FaceSpeech = with_words
    folder = Path(output).parent
    if sound == "voice":
        request = RunRequest(face, SILENCE, voice=VoiceOptions("silent"), quiet=True)
    else:
        recording = folder / f"{Path(output).stem}.wav"
        soundfile.write(recording, np.tile(speech, n_cycles), _RATE_HZ, subtype="FLOAT")
        request = RunRequest(face, Sound("file", str(recording)), quiet=True)
    requested = RequestedFace(request)
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    child, watch = lifeline_pair()
    board, live = StatusBoard.create(), requested.live_board()
    handed = processes.Handed(
        ends[0].detach(), board.fileno(), live.fileno(), Lifeline(child.detach())
    )
    with contextlib.suppress(_NoMoreTurns):
        processes.run_speech_process(request, handed, None, None)
    times, goals = [each[:2] for each in published], [each[2] for each in published]
    np.savez(output, times_s=np.array(times), goals_deg=np.array(goals))
    watch.close()
    os._exit(0)


if __name__ == "__main__":
    sys.path[0] = sys.argv[1]
    _output, _face, _sound, _clip, _n_cycles = sys.argv[2:]
    main(_output, _face, _sound, _clip, int(_n_cycles))
