"""A whole `lipservo run` with its live view in a terminal that stands still, as after Ctrl-S."""

import contextlib
import json
import os
import subprocess
import termios
import time

import numpy as np
import soundfile
from running_daemon import LIPSERVO, PATIENCE_S, own_folder, run


def test_a_terminal_that_takes_nothing_more_does_not_hold_up_the_end(tmp_path, monkeypatch):
    """Whoever stopped the face waited ten seconds for an answer, with the servos limp long ago."""
    own_folder(monkeypatch)
    sound = tmp_path / "silence.wav"
    soundfile.write(sound, np.zeros(60 * 16_000), 16_000)
    ours, terminal = os.openpty()
    termios.tcsetwinsize(terminal, (40, 120))
    command = [*LIPSERVO, "run", "--wav", str(sound)]
    environment = {**os.environ, "TERM": "xterm", "LIPSERVO_STATE": str(tmp_path)}
    with (
        subprocess.Popen(
            command, stdin=terminal, stdout=subprocess.DEVNULL, stderr=terminal, env=environment
        ) as process,
        contextlib.ExitStack() as whatever_fails,
    ):
        whatever_fails.callback(process.kill)  # a terminal that stands would be waited for
        seen = b""
        while b"lip gap" not in seen:  # its first picture
            seen += os.read(ours, 4096)
        termios.tcflow(terminal, termios.TCOOFF)
        done = run("stop", "--json")
        (stopped,) = json.loads(done.stdout)["faces"]
        termios.tcflow(terminal, termios.TCOON)
        os.set_blocking(ours, False)
        give_up_s = time.monotonic() + PATIENCE_S
        while process.poll() is None:
            assert time.monotonic() < give_up_s
            time.sleep(0.01)
            with contextlib.suppress(BlockingIOError):
                os.read(ours, 65536)
    os.close(ours)
    os.close(terminal)

    assert (done.returncode, stopped["problem"]) == (0, ""), done
    assert stopped["confirmed"]
    assert process.returncode == 0
