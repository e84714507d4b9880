"""A `lipservo daemon` at simulated servos, and what a test asks of it."""

import contextlib
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

from places import short_folder

from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.errors import PortError
from firmware_bridge.process.control_client import ask
from firmware_bridge.serial_servos.serial_transport import open_port

BAUD_RATE = 1_000_000
IDS = range(11, 21)
#: Far more than anything here takes, even on a busy machine.
PATIENCE_S = 120.0
LIPSERVO = [sys.executable, "-m", "lipservo"]


def own_folder(monkeypatch):
    """Faces of this test only."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(short_folder()))


@contextlib.contextmanager
def running(port, folder, *arguments, errors=None):
    """A `lipservo daemon` whose servos are driven; port None: they are in its memory.

    `systemd`: where it tells a service manager how it is.
    """
    notify, said = folder / "notify.sock", folder / "said.txt"
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd,
        said.open("w") as log,
        (folder / "out.txt").open("w") as out,
    ):
        systemd.bind(str(notify))
        systemd.settimeout(PATIENCE_S)
        with subprocess.Popen(
            [*LIPSERVO, "daemon", *(() if port is None else ("--port", port)), *arguments],
            stdout=out,
            stderr=log if errors is None else errors,
            env={
                **os.environ,
                "NOTIFY_SOCKET": str(notify),
                "LIPSERVO_STATE": str(folder / "state"),
            },
        ) as process:
            process.said, process.out, process.systemd = said, folder / "out.txt", systemd
            try:
                try:
                    assert systemd.recv(100) == b"READY=1"
                except TimeoutError:
                    raise AssertionError(f"it never said READY: {said.read_text()}") from None
                (process.control,) = Path(os.environ["XDG_RUNTIME_DIR"], "lipservo").glob("*.sock")
                yield process
            finally:
                process.terminate()
                try:
                    process.wait(PATIENCE_S)
                except subprocess.TimeoutExpired:
                    process.kill()


def wait_for(condition):
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "nothing happened"
        time.sleep(0.05)


def run(*arguments):
    return subprocess.run(
        [*LIPSERVO, *arguments], timeout=PATIENCE_S, check=False, capture_output=True, text=True
    )


def log(process):
    return process.said.read_text()


def child(process, name):
    """The number of the newest process of that name, from the log."""
    lines = [line for line in log(process).splitlines() if line.startswith(f"{name} runs")]
    return int(lines[-1].split()[-1])


def torque(port, ids=IDS, baud_rate=BAUD_RATE):
    """torque_enable of every servo, read by a second program once the first is gone.

    On a busy computer the first may hold the port a moment longer, and an answer may come too late.
    """
    give_up_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            with contextlib.closing(open_port(port, baud_rate)) as transport:
                line = Line(transport)
                answers = [line.read(each, 64, 1) for each in ids]
        except PortError:
            answers = [None]
        if None not in answers:
            return [answer.data[0] for answer in answers]
        assert time.monotonic() < give_up_s, "no servo answers"
        time.sleep(0.05)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def all_driven(process):
    try:
        states = ask(process.control, "status", PATIENCE_S)["servos"]
    except OSError:
        return False
    return set(states.values()) == {"driven"}
