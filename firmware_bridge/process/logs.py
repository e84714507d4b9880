"""Set up where a process logs: as lines for people, as JSON for programs, or to journald.

Modules log by `logging.getLogger(__name__)`. docs/hardware.md, "What it logs", is for users,
docs/decisions/architecture.md says why it is so.
"""

import contextlib
import logging
import os
import sys
from collections.abc import Iterator
from typing import Final

from firmware_bridge.process.log_lines import LogLines, LogWriter, write_stderr

#: Set by options of the program or by a service; the processes of a face inherit them.
VERBOSE: Final = "LIPSERVO_VERBOSE"
LOG_JSON: Final = "LIPSERVO_LOG_JSON"
#: Others keep to warnings, whatever is set here.
_OURS: Final = ("calibration", "firmware_bridge", "lipservo", "lipservo_lab", "lipsync")
#: Processes of one face that share a terminal name themselves in each line.
_NAMED_SIDES: Final = ("bridge", "speech")


def set_up(level: int = logging.WARNING) -> None:
    """Log to stderr from `level` on, or from DEBUG; call it again when the environment has changed.

    $LIPSERVO_VERBOSE selects DEBUG, $LIPSERVO_LOG_JSON a JSON object a line.
    """
    _replace_handler(_writer("", ""))
    _show(level)


@contextlib.contextmanager
def face_logs(face: str, side: str = "", *, quiet: bool = False) -> Iterator[None]:
    """Log by a thread while inside, so that a hung terminal stops nothing; restore logging after.

    face: the name of the face. side: which of the face's processes this is; empty: the only one.
    quiet: log errors alone.
    """
    with LogLines(_writer(face, side)) as lines:
        before = _replace_handler(lines)
        _show(logging.ERROR if quiet else logging.INFO)
        try:
            yield
        finally:
            _replace_handler(*before)
            _show(logging.WARNING)


def _show(level: int) -> None:
    for name in _OURS:
        logging.getLogger(name).setLevel(logging.DEBUG if os.environ.get(VERBOSE) else level)


def _writer(face: str, side: str) -> LogWriter:
    """Return the handler that writes records of a face's process `side` as the environment says."""
    start = f"{side}: " if side in _NAMED_SIDES else ""
    start += "%(levelname)s %(name)s: " if os.environ.get(VERBOSE) else ""
    # A live view takes what is written to sys.stderr, and draws itself below. Of several processes
    # that share a terminal none draws on it.
    write = write_stderr if side else _print
    return LogWriter(face, side, start, write, as_json=bool(os.environ.get(LOG_JSON)))


def _print(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def _replace_handler(*handlers: logging.Handler) -> list[logging.Handler]:
    """Replace our handlers of the root logger by `handlers`; return the replaced ones.

    Handlers of other packages stay.
    """
    root = logging.getLogger()
    others = [each for each in root.handlers if not isinstance(each, (LogLines, LogWriter))]
    before = [each for each in root.handlers if each not in others]
    root.handlers[:] = [*others, *handlers]
    return before
