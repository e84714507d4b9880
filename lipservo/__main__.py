"""The entry point, which imports little, so that Ctrl-C works while the rest is being loaded."""

import os
import signal
import sys
from types import FrameType

#: 128 + SIGINT, as shells count.
INTERRUPTED = 130
#: Commands that must keep up with sound. Their matrix products are small: divided among threads, as
#: BLAS does by default, they take 56 ms in place of 0.1 on a busy computer, waiting for each other.
_KEEP_UP = ("run", "daemon", "replay", "bridge-process", "speech-process")
_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def main() -> None:
    """Load the program and run its command line; exit with status 130 on Ctrl-C."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # While modules are imported nothing moves and nothing is open: exit without a traceback.
        signal.signal(signal.SIGINT, _leave)
    words = [each for each in sys.argv[1:] if not each.startswith("-")]
    if words[:1] and (words[0] in _KEEP_UP or words[:2] == ["lines", "recognize"]):
        for name in _BLAS_THREADS:  # read when NumPy is loaded
            os.environ.setdefault(name, "1")
    from lipservo import command_line

    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        command_line.main()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _leave(_number: int, _frame: FrameType | None) -> None:
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
