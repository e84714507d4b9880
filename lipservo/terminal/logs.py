"""Where log lines go: to people, to programs or to journald, by options of the whole program.

Modules log by `logging.getLogger(__name__)`. docs/hardware.md, "What it logs", is for users,
docs/decisions/0048-logging.md says why it is so.
"""

import contextlib
import logging
import os
from collections.abc import Iterator
from functools import partial
from typing import Final

from firmware_bridge.process.log_lines import LogLines, LogWriter, write_stderr
from lipservo.terminal.output import LOG_JSON, MESSAGE_LOGGER, MESSAGES

#: As `LOG_JSON`: set by an option or by a service, and inherited by the processes of a face.
VERBOSE: Final = "LIPSERVO_VERBOSE"
#: Others keep to warnings, whatever is set here.
_OURS: Final = ("calibration", "firmware_bridge", "lipservo", "lipservo_lab", "lipsync")
#: Processes of one face that share a terminal name themselves in each line.
_NAMED_SIDES: Final = ("bridge", "speech")


def set_up() -> None:
    """Log warnings to stderr, as the environment says; may be called again when it has changed."""
    _replace_handler(_writer("", ""))
    _show(logging.WARNING)
    logging.getLogger(MESSAGE_LOGGER).setLevel(logging.INFO)


@contextlib.contextmanager
def face_logs(face: str, side: str = "", *, quiet: bool = False) -> Iterator[None]:
    """Log the life of a face, by a thread, so that a terminal that stands still stops nothing.

    side: which of a face's processes this is; empty: there is one. quiet: log errors alone.
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
    start = f"{side}: " if side in _NAMED_SIDES else ""
    start += "%(levelname)s %(name)s: " if os.environ.get(VERBOSE) else ""
    # Of several processes that share a terminal none draws on it.
    write = write_stderr if side else partial(MESSAGES.print, soft_wrap=True)
    return LogWriter(face, side, start, write, as_json=bool(os.environ.get(LOG_JSON)))


def _replace_handler(*handlers: logging.Handler) -> list[logging.Handler]:
    """Log to these in place of those of ours that were there; those of others stay."""
    root = logging.getLogger()
    others = [each for each in root.handlers if not isinstance(each, (LogLines, LogWriter))]
    before = [each for each in root.handlers if each not in others]
    root.handlers[:] = [*others, *handlers]
    return before
