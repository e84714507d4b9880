"""What a tick passes, and what the first one costs, seen from inside a process; run as a script.

`python traced_ticks.py ROOT OUTPUT ticks|first_tick ARGUMENT...` runs `lipservo ARGUMENT...` in a
process of its own. A tick is what its main thread does from the end of a clock's `sleep_until` to
the next call of one: bridge and speech side in a `run` or `replay`. Waiting threads are left out.
"""

import contextlib
import json
import os
import resource
import statistics
import sys
from pathlib import Path
from types import FrameType
from typing import Any, Final

_PACKAGES: Final = ("calibration", "firmware_bridge", "lipservo", "lipservo_client", "lipsync")
_CLOCK, _WAIT = "clock.py", "sleep_until"


class TickTracer:
    """Counts files and hops of every tick of this thread, by `sys.setprofile`.

    n_files: of each tick, how many of our files it enters. n_hops: how many calls go from one of
    our files to another.
    """

    def __init__(self, root: str) -> None:
        folders = [os.path.join(root, each) for each in _PACKAGES]
        self._prefixes = tuple(each + os.sep for each in folders)
        self._files: set[str] = set()
        self._hops = 0
        self._is_in_tick = False
        self.n_files: list[int] = []
        self.n_hops: list[int] = []

    def profile(self, frame: FrameType, event: str, _arg: Any) -> None:
        """Count a call of a function of ours, a generator's resumption included.

        Calls and returns of a clock's `sleep_until` end and begin a tick.
        """
        if event not in ("call", "return"):
            return
        file = frame.f_code.co_filename
        if not file.startswith(self._prefixes):
            return
        if frame.f_code.co_name == _WAIT and file.endswith(_CLOCK):
            self._begin_or_end_tick(is_over=event == "call")
        elif event == "call" and self._is_in_tick:
            self._files.add(file)
            caller = frame.f_back.f_code.co_filename if frame.f_back else ""
            self._hops += caller != file and caller.startswith(self._prefixes)

    def _begin_or_end_tick(self, *, is_over: bool) -> None:
        if is_over and self._is_in_tick:
            self.n_files.append(len(self._files))
            self.n_hops.append(self._hops)
        self._is_in_tick = not is_over
        self._files, self._hops = set(), 0


def traced_ticks(root: str) -> dict[str, Any]:
    """Run the command line of this process; return medians of files and hops over its ticks.

    root: the folder of our packages.
    """
    from lipservo.__main__ import main

    tracer = TickTracer(root)
    sys.setprofile(tracer.profile)
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
    finally:
        sys.setprofile(None)
    return {
        "files": round(statistics.median(tracer.n_files)),
        "hops": round(statistics.median(tracer.n_hops)),
        "ticks": len(tracer.n_files),
    }


class _FirstTick(BaseException):
    """Unwinds a command at its first tick."""


def first_tick_s() -> float:
    """Run the command line of this process to its first tick; return its processor time, s."""
    from firmware_bridge import clock
    from lipservo.__main__ import main

    def stop_at_first_tick(_clock: clock.MonotonicClock, time_s: float) -> None:  # noqa: ARG001
        raise _FirstTick

    clock.MonotonicClock.sleep_until = stop_at_first_tick  # type: ignore[method-assign, assignment]
    with contextlib.suppress(_FirstTick):
        main()
    used = resource.getrusage(resource.RUSAGE_SELF)
    return round(used.ru_utime + used.ru_stime, 3)


if __name__ == "__main__":
    _root, _output, _what, *_arguments = sys.argv[1:]
    sys.path[0] = _root
    sys.argv[1:] = _arguments
    _found = traced_ticks(_root) if _what == "ticks" else first_tick_s()
    Path(_output).write_text(json.dumps(_found), "utf-8")
