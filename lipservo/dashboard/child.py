"""The dashboard beside a face that starts it: its socket, URL, and process, restarted if it dies.

The face never waits for the dashboard: one thread restarts its process, and logs each end.
"""

import contextlib
import logging
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final
from urllib.parse import urlencode

from firmware_bridge.process.logs import LOG_JSON
from lipservo.agents.listener import bind_listener, url_of
from lipsync.errors import UserError

_LOG: Final = logging.getLogger(__name__)
HOST: Final = "127.0.0.1"
FIRST_PORT: Final = 8080
_N_PORTS_TRIED: Final = 20
#: Between two checks whether the face's control socket exists, or the dashboard still runs.
_POLL_S: Final = 0.2
#: A dashboard that has died is started again after 5 s, then after twice as long each time, 60 s at
#: most; after 5 s again if it had run for `_WELL_S`.
_RESTART_S: Final = 5.0
_LONGEST_RESTART_S: Final = 60.0
_WELL_S: Final = 60.0
_END_S: Final = 2.0


def bound_dashboard(listen: str | None, token: str | None) -> socket.socket:
    """Return a socket bound to `listen`, HOST:PORT; None: to loopback's port 8080 or the next free.

    Raises UserError for an unknown address, one in use, and one beyond loopback without token.
    """
    if listen is not None:
        return bind_listener(listen, token)
    for port in range(FIRST_PORT, FIRST_PORT + _N_PORTS_TRIED):
        try:
            return bind_listener(f"{HOST}:{port}", token)
        except UserError:
            continue
    return bind_listener(f"{HOST}:0", token)


def address_of(listener: socket.socket, token: str | None = None, page: str = "") -> str:
    """Return the URL of the dashboard, or of its `page`, with `token` as a query if given."""
    address = url_of(listener).replace("ws://", "http://", 1)
    if page:
        address = f"{address}/{page}"
    elif token is not None:
        address += "/"
    return address if token is None else f"{address}?{urlencode({'token': token})}"


def address_line(listener: socket.socket, token: str | None, page: str = "") -> str:
    """Return the line to print with the dashboard's URL, with its token only in a terminal.

    Where stderr is a log, which others may read, the line has no token.
    """
    if token is None or (sys.stderr.isatty() and not os.environ.get(LOG_JSON)):
        return f"dashboard: {address_of(listener, token, page)}"
    hint = "with its token, which is in no log: docs/hardware.md"
    return f"dashboard: {address_of(listener, None, page)} ({hint})"


@contextlib.contextmanager
def dashboard_child(
    control_path: Path,
    listener: socket.socket,
    token_file: str | None = None,
    *,
    model: Path | None = None,
    open_page: bool = False,
) -> Iterator[None]:
    """Serve the dashboard of the face at `control_path`, by a child process, until the block ends.

    listener: from `bound_dashboard`; must stay open until the block has ended. model: the file of
    the face's model; None: the shipped one. token_file: the file with the token that browsers must
    send; None: any local user may use the dashboard. open_page: open a browser, once.
    """
    arguments = ["--control", str(control_path), "--listener", str(listener.fileno()), "--quiet"]
    arguments += ["--parent", str(os.getpid())]
    if token_file is None:
        arguments += ["--open-to-this-computer"]
    else:
        arguments += ["--token-file", token_file]
    if model is not None:
        arguments += ["--model", str(model)]
    command = [sys.executable, "-P", "-m", "lipservo", "dashboard", *arguments]
    must_end = threading.Event()

    def keep_running() -> None:
        """Start the dashboard's process, and again whenever it ends. Runs in thread `dashboard`.

        A start waits for the face's control socket. Pauses between starts grow from 5 s to 60 s,
        and are 5 s again after a process that ran for a minute.
        """
        open_option = ["--open"] if open_page else []
        wait_s = _RESTART_S
        while not must_end.wait(_POLL_S):
            if not control_path.exists():
                continue
            try:
                # The thread lives as long as the process it starts: the kernel ends a child when
                # the thread that started it ends.
                process = subprocess.Popen(
                    [*command, *open_option],
                    pass_fds=[listener.fileno()],
                    stdin=subprocess.DEVNULL,
                    process_group=0,
                )
            except OSError as error:
                _LOG.warning("dashboard: cannot be started: %s", error.strerror)
                must_end.wait(wait_s)
                wait_s = min(2.0 * wait_s, _LONGEST_RESTART_S)
                continue
            began_s = time.monotonic()
            while process.poll() is None and not must_end.wait(_POLL_S):
                pass
            if must_end.is_set():
                _end_process(process)
                return
            open_option = []
            if time.monotonic() - began_s > _WELL_S:
                wait_s = _RESTART_S
            status = process.returncode
            _LOG.warning("dashboard: ended (%s); it is started again in %g s", status, wait_s)
            must_end.wait(wait_s)
            wait_s = min(2.0 * wait_s, _LONGEST_RESTART_S)

    thread = threading.Thread(target=keep_running, name="dashboard", daemon=True)
    thread.start()
    try:
        yield
    finally:
        must_end.set()
        thread.join(2.0 * _END_S)


def _end_process(process: "subprocess.Popen[bytes]") -> None:
    """Send a process SIGTERM, and SIGKILL if it still runs after 2 s; wait for its end."""
    process.terminate()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
