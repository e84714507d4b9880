"""The entry point: light, so that Ctrl-C is understood while everything else is being loaded."""

import os
import signal
import sys
from types import FrameType

#: 128 + SIGINT, as shells count.
INTERRUPTED = 130


def main() -> None:
    """Load the program and run its command line."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # Nothing moves yet and nothing is open: leave at once, without a traceback of imports.
        signal.signal(signal.SIGINT, _leave)
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
