"""A head that runs with its page, as a user starts it."""

import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

_PATIENCE_S: Final = 180.0
_LOOK_S: Final = 0.2
_END_S: Final = 30.0
_SETTLE_S: Final = 3.0


@contextmanager
def served_head() -> Iterator[str]:
    """`face_head` with a dashboard that has settled; the address.

    Raises TimeoutError where none comes.
    """
    with tempfile.TemporaryDirectory() as folder, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        listen = f"127.0.0.1:{probe.getsockname()[1]}"
        probe.close()
        command = [sys.executable, "-m", "lipservo", "daemon", "--config", "face_head", "--quiet"]
        command += ["--dashboard", "--dashboard-listen", listen]
        command += ["--open-to-this-computer", "--sounds", folder, "--listen", "127.0.0.1:0"]
        with subprocess.Popen([*command, "--control", str(Path(folder) / "head.sock")]) as process:
            try:
                _wait_for(f"http://{listen}/api/health")
                _wait_for(f"http://{listen}/twin/head.bin")  # is made while the rest starts
                time.sleep(_SETTLE_S)
                yield f"http://{listen}"
            finally:
                process.terminate()
                process.wait(_END_S)


def _wait_for(url: str) -> None:
    give_up_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < give_up_s:
        try:
            with urllib.request.urlopen(url, timeout=5.0):
                return
        except OSError:
            time.sleep(_LOOK_S)
    raise TimeoutError(f"no dashboard answers at {url}")
