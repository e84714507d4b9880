"""The folder of a small study whose clips are a third of a second long, and its server."""

import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import soundfile
from lipservo_lab.study.rehearsal import trial_study
from lipservo_lab.study.sheets import CLIPS, Key, Size, Study, write_study

from lipservo.agents.listener import bind_listener
from lipservo.dashboard.web.access_layer import App
from lipservo.dashboard.web.serving import server_of

METHODS = ("recorded", "ears", "rhubarb", "still")
#: 40 clips a rater: 24 rated, 4 pairs, 8 read; with a sound check and two checks 39 items.
FORTY = Size(ratings=24, pairs=4, readings=8, sentences=8, checks=2, sheets=8)
_CLIP_S = 0.32
_SERVE = "from lipservo_lab.commands.groups import study; study()"


def write_clip(path: Path, sound: Path) -> None:
    """A grey square with a dark mouth that opens, and a tone."""
    from lipservo.display.film import write_film

    time_s = np.arange(round(_CLIP_S * 16_000)) / 16_000
    soundfile.write(sound, 0.1 * np.sin(2 * np.pi * 220 * time_s), 16_000)
    pictures = np.full((8, 96, 128, 3), 190, dtype=np.uint8)
    for n, picture in enumerate(pictures):
        picture[60 : 64 + n, 50:78] = 60
    write_film(iter(pictures), (128, 96), sound, path)


def write_small_study(folder: Path, size: Size = FORTY, *, films: bool = True) -> tuple[Study, Key]:
    """films: without them every clip is a file of one byte, which no browser shows."""
    study, key = trial_study(METHODS, size)
    study = type(study)(
        study.identity, study.title, study.consent, study.vocabulary,
        dict.fromkeys(study.duration_s, _CLIP_S), study.sheets,
    )  # fmt: skip
    write_study(folder, study, key)
    first = folder / "clip.mp4"
    if films:
        write_clip(first, folder / "tone.wav")
    else:
        first.write_bytes(b"0")
    for name in study.duration_s:
        shutil.copy(first, folder / CLIPS / f"{name}.mp4")
    return study, key


@contextmanager
def served_study(
    folder: Path, listen: str = "127.0.0.1:0"
) -> Iterator[tuple[str, subprocess.Popen]]:
    """`study serve` in a process of its own: the address with its token, and the process."""
    command = [sys.executable, "-c", _SERVE, "serve", str(folder), "--listen", listen]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            said = ""
            for line in process.stderr:
                said += line
                if found := re.search(r"study: (http\S+)", line):
                    break
            else:
                raise AssertionError(f"the study was not served: {said}")
            yield found[1], process
        finally:
            process.terminate()


@contextmanager
def served_app(app: App) -> Iterator[str]:
    """An application on a real socket, in a thread: its address."""
    listener = bind_listener("127.0.0.1:0", "secret")
    ready = threading.Event()
    server = server_of(app, ready.set)
    thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
    thread.start()
    try:
        assert ready.wait(30.0)
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join()
        listener.close()
