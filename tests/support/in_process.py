"""The command line in this process: what a new one gives, without a second of starting it."""

import contextlib
import io
import subprocess
import sys

from lipservo import command_line


def lipservo(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Status, standard output and errors of `lipservo` with these arguments."""
    stdout, stderr, status = io.StringIO(), io.StringIO(), 0
    before, sys.argv = sys.argv, ["lipservo", *map(str, arguments)]
    try:
        with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
            command_line.main()
    except SystemExit as end:
        status = int(end.code or 0)
    finally:
        sys.argv = before
    return subprocess.CompletedProcess(sys.argv, status, stdout.getvalue(), stderr.getvalue())


def refused(*arguments: object, notes: bool = False) -> str:
    """The one line of a command that fails; notes: others may come before it."""
    done = lipservo(*arguments)
    assert done.returncode in (1, 2), done.stderr
    *before, line = done.stderr.splitlines()
    assert notes or not before, before
    return line
