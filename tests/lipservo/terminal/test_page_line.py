"""The JSON lines between a step of the first hour and the page that leads it."""

import os
import subprocess
import sys
from pathlib import Path

_STEP = """
import sys
from lipservo.terminal.page_line import PageLine
page = PageLine()
for number in range(5000):
    page.tell("progress", number=number, filler="x" * 200)
page.tell("result", grade="good")
sys.stderr.write("sent"); sys.stderr.flush()
page.finish()
"""


def test_a_page_that_stood_still_reads_the_newest_event_not_the_oldest(tmp_path: Path) -> None:
    script = tmp_path / "step.py"
    script.write_text(_STEP)
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as step:
        assert step.stdout is not None
        assert step.stderr is not None
        # The pipe is full and nothing is read of it until all events were sent.
        assert os.read(step.stderr.fileno(), 4) == b"sent"
        lines = step.stdout.read().decode().splitlines()
        assert '"event": "result"' in lines[-1]
        assert len(lines) < 5000
