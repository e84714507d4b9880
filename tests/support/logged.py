"""What is logged while a block runs."""

import logging
from contextlib import contextmanager


class _Lines(logging.Handler):
    def __init__(self, on_line):
        super().__init__()
        self.on_line = on_line

    def emit(self, record):
        self.on_line(record.getMessage())


@contextmanager
def logged(name, on_line=None):
    """The lines of a logger and of all below it. on_line: gets each of them at once, too."""
    lines = []

    def note(line):
        lines.append(line)
        if on_line is not None:
            on_line(line)

    logger, handler = logging.getLogger(name), _Lines(note)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield lines
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
