"""Ten faces that listen on few cores at once: those that go on have the network again."""

import os
import time
from contextlib import ExitStack

import pytest
from lipservo_lab.bench.hearing.ladder_figures import (
    RUN,
    first_tick_s,
    listening_face,
    repeated_speech,
    wait_until,
)
from places import short_folder

from firmware_bridge.process.control_client import ask

N_FACES, CROWDED_S = 10, 30.0
#: A face that goes on has the network back within this, or not at all: a try that fails is repeated
#: after 8 s at the latest (docs/recognition.md), and takes over within 8 s.
COMES_BACK_S = 120.0


def fallback_level(folder):
    """Return how many better recognisers than the one in use a face has; None: it does not answer.

    folder: that of the face's session, in which its socket lies.
    """
    for path in (folder / "session").glob("**/*.sock"):
        try:
            return int(ask(path, "status")["fallback_level"])
        except OSError:
            continue
    return None


def never():
    return False


@pytest.mark.campaign
def test_after_ten_faces_on_few_cores_those_that_go_on_have_the_network_again():
    """It was lost for the life of each process."""
    folder = short_folder()
    sound, _ = repeated_speech(folder / "speech.wav", CROWDED_S + 60.0 + COMES_BACK_S)
    with ExitStack() as stack:
        faces = []
        for n in range(N_FACES):
            own, alone = folder / str(n), stack.enter_context(ExitStack())
            (own / "session").mkdir(parents=True, mode=0o700)
            process = alone.enter_context(listening_face(RUN, own, sound, own / "trace.jsonl"))
            faces.append((own, process, alone))
        for own, process, _ in faces:
            first_tick_s(own, process, never, n_ticks=1)
        losers = set()
        until_s = time.monotonic() + CROWDED_S
        while time.monotonic() < until_s:
            wait_until(time.monotonic() + 1.0, faces[0][1], never)
            losers |= {n for n, face in enumerate(faces) if fallback_level(face[0])}
        # Those that lost it go on, as many as there are cores.
        faces = sorted(faces, key=lambda face: faces.index(face) not in losers)
        n_kept = min(N_FACES, os.cpu_count() or 1)
        for _, process, _ in faces[n_kept:]:
            process.terminate()
        for _, _, alone in faces[n_kept:]:
            alone.close()
        give_up_s, away = time.monotonic() + COMES_BACK_S, faces[:n_kept]
        while away and time.monotonic() < give_up_s:
            time.sleep(0.1)
            away = [face for face in away if fallback_level(face[0]) != 0]

    assert away == []
