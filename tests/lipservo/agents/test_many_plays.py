"""Five hundred sounds that are asked for at once: how many are taken, and what they cost.

The face is a daemon with servos in its memory: sound, recogniser and ticks share a process.
"""

import contextlib
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import soundfile
from lipservo_client.blocking_face import Face
from lipservo_client.protocol import FaceError

from firmware_bridge.process.control_client import ask

N_PLAYS = 500
#: Each has two of the eight connections that an agent server takes.
N_CLIENTS = 2
CLOSED = ("refused", "too_many_streams", "too_many_requests")
PATIENCE_S = 180.0


@contextlib.contextmanager
def speaking_face(folder):
    """A daemon that plays the sounds of a folder, once it answers: its process, its URL."""
    hum = 0.1 * np.sin(np.arange(60 * 48_000) / 50.0)
    soundfile.write(folder / "line.wav", hum, 48_000)
    control = folder / "face.sock"
    command = [sys.executable, "-P", "-m", "lipservo", "daemon", "--config", "face_sim", "--quiet"]
    command += ["--sounds", str(folder), "--listen", "127.0.0.1:0", "--control", str(control)]
    with subprocess.Popen(command) as process:
        try:
            url, give_up_s = None, time.monotonic() + PATIENCE_S
            while url is None:
                assert time.monotonic() < give_up_s, "the daemon did not start"
                with contextlib.suppress(OSError):
                    url = ask(control, "status", 30.0).get("listens_on")
                time.sleep(0.05)
            yield process.pid, url
        finally:
            process.terminate()
            process.wait(30.0)


def play(url, times):
    """How many of so many plays are accepted."""
    accepted = 0
    with Face(url, None) as face:
        for _ in range(times):
            try:
                face.play("line.wav")
                accepted += 1
            except FaceError as error:
                if error.code not in CLOSED:
                    raise
    return accepted


def n_threads(pid):
    return len(os.listdir(f"/proc/{pid}/task"))


@pytest.mark.slow
def test_five_hundred_plays_at_once_are_eight_and_cost_two_threads(tmp_path):
    with speaking_face(tmp_path) as (pid, url):
        time.sleep(3.0)
        with Face(url, None) as face, contextlib.suppress(FaceError):
            face.play("none.wav")  # threads that any client costs are no part of it
        before, most, over = n_threads(pid), [0], threading.Event()

        def watch():
            while not over.wait(0.05):
                most[0] = max(most[0], n_threads(pid))

        watching = threading.Thread(target=watch)
        watching.start()
        with ThreadPoolExecutor(N_CLIENTS) as clients:
            accepted = sum(clients.map(lambda _: play(url, N_PLAYS // N_CLIENTS), range(N_CLIENTS)))
        time.sleep(2.0)
        over.set()
        watching.join()

    assert accepted == 8
    assert most[0] - before <= 2
