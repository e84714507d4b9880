"""`lipservo new-face --page` as a person starts it, and its API as a page uses it."""

import contextlib
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
from places import ROOT, short_folder

from firmware_bridge.process.port_holders import with_children

PATIENCE_S = 120.0


class Server:
    """address: with the token, as a terminal shows it. process: the server's."""

    def __init__(self, address, process):
        self.address, self.process = address, process
        base = address.split("/first-hour")[0]
        self.client = httpx.Client(base_url=base, timeout=60.0, trust_env=False)
        self.client.get(address.removeprefix(base))  # the token becomes a cookie

    def state(self):
        return self.client.get("/api/first-hour").json()

    def step_pid(self):
        """The process of the step that runs, which is the server's only child of that name."""
        pids = with_children([self.process.pid])
        commands = {pid: Path(f"/proc/{pid}/cmdline").read_bytes() for pid in pids}
        (pid,) = (pid for pid, command in commands.items() if b"builder-process" in command)
        return pid

    def post(self, path, **body):
        return self.client.post(f"/api/first-hour/{path}", json=body)

    def until(self, is_so):
        """The first state of which that is so."""
        give_up_s = time.monotonic() + PATIENCE_S
        while True:
            state = self.state()
            if is_so(state):
                return state
            assert time.monotonic() < give_up_s, state
            time.sleep(0.2)


@contextlib.contextmanager
def served(path, *options):
    """Yield the `Server` of `lipservo new-face --page` for the YAML at `path`; end it then."""
    command = [sys.executable, "-m", "lipservo", "new-face", "--page", "-o", str(path), *options]
    folder = short_folder()
    environment = {
        **os.environ,
        "LIPSERVO_RUNTIME": str(folder),
        "LIPSERVO_STATE": str(folder / "state"),
        "XDG_DATA_HOME": str(folder / "data"),
    }
    with subprocess.Popen(
        command, cwd=ROOT, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            address = next(
                found[1]
                for line in process.stderr
                if (found := re.search(r"dashboard: (http\S+)", line))
            )
            # Nobody reads the rest, and a pipe that is full would hold the server up.
            threading.Thread(target=process.stderr.read, daemon=True).start()
            token = (folder / "token").read_text().strip()
            server = Server(f"{address}?token={token}", process)
            with contextlib.closing(server.client):
                yield server
        finally:
            process.terminate()
            try:
                process.wait(30.0)
            except subprocess.TimeoutExpired:
                process.kill()
