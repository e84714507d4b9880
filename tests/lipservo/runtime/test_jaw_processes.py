"""A jaw on a Maestro, a PCA9685 and a Feetech, driven by real processes that end in every way.

What its servo was sent is as the printed table says. Judged by the simulator's own log of pulses,
or of torque and goals, which no process of the face writes.
"""

import contextlib
import json
import os
import signal
import subprocess
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest
from places import ROOT
from running_daemon import (
    LIPSERVO,
    PATIENCE_S,
    all_driven,
    child,
    log,
    own_folder,
    run,
    running,
    wait_for,
)

from lipservo.runtime.servos.sim_process import simulated_port

# Real processes in real time.
pytestmark = pytest.mark.slow
CLIP = str(ROOT / "lipservo" / "clips" / "welcome.flac")
PULSES_OFF = "pulses off; a digital servo may hold"
#: What each face says of a servo that was let go, and never says.
WORDS = {
    "maestro": (f"stop --limp: {PULSES_OFF}, which no servo confirms", "confirmed by"),
    "pca9685": (PULSES_OFF, "confirmed by"),
    "feetech": ("1 servo", PULSES_OFF),
}
#: What the servo is sent last before it is let go, and how exactly: us; of a Feetech in its steps.
NEUTRAL = {"maestro": (1500.0, 3.0), "pca9685": (1400.0, 6.0), "feetech": (2048.0, 3.0)}


@dataclass
class Jaw:
    """A jaw behind a link."""

    bus: str
    port: str
    log: Path
    folder: Path

    @property
    def face(self):
        return f"face_jaw_{self.bus}"

    def rows(self):
        """A board's log has every pulse, the others what changes."""
        text = self.log.read_text() if self.log.exists() else ""
        return [json.loads(line) for line in text.splitlines()]

    def sent(self):
        """(whether it is driven, what it was sent) in each row."""
        if self.bus == "feetech":
            return [(torque == 1, goal) for _, _, torque, goal, _ in self.rows()]
        return [(row[2] > 0.0, row[2]) for row in self.rows()]

    def is_off(self):
        if self.bus == "pca9685":
            time.sleep(0.1)  # the last pulse is logged at the start of the next cycle, 20 ms later
            n_before = len(self.rows())
            time.sleep(0.3)
            return len(self.rows()) == n_before
        sent = self.sent()
        return not sent or not sent[-1][0]

    def was_off_since(self, n_before):
        if self.bus == "pca9685":
            return any(after[0] - one[0] > 0.1 for one, after in pairwise(self.rows()[n_before:]))
        return any(not is_driven for is_driven, _ in self.sent()[n_before:])

    @contextlib.contextmanager
    def driven(self):
        arguments = ["--config", self.face, "--wav", CLIP]
        with running(self.port, self.folder, *arguments) as daemon:
            wait_for(lambda: all_driven(daemon) and not self.is_off())
            yield daemon


@contextlib.contextmanager
def simulated(bus, folder, *options):
    path, link = folder / "log.jsonl", folder / "port"
    arguments = ["--config", f"face_jaw_{bus}", "--log", str(path), "--link", str(link)]
    with simulated_port([*arguments, "--on-time", *options]):
        yield Jaw(bus, str(link), path, folder)


@pytest.fixture(params=["maestro", "pca9685", "feetech"])
def bus(request, monkeypatch):
    own_folder(monkeypatch)
    return request.param


@pytest.fixture
def jaw(bus, tmp_path):
    with simulated(bus, tmp_path) as jaw:
        yield jaw
    if bus == "pca9685":  # of every pulse: within min_us .. max_us of the face
        assert all(1365.0 <= width_us <= 1695.0 for _, width_us in jaw.sent())


def shoot(pids):
    """All at once: none sees another end.

    The parent comes first and dies last: a stopped child whose parent has died is woken by the
    kernel with SIGHUP, and lets its servos go before it is shot.
    """
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    for pid in reversed(pids):
        os.kill(pid, signal.SIGKILL)


def children_of(pid):
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_a_second_program_at_one_maestro_is_refused_and_the_first_goes_on(tmp_path, monkeypatch):
    own_folder(monkeypatch)
    with simulated("maestro", tmp_path) as jaw:
        with jaw.driven() as daemon:
            for command in (("run", "--wav", CLIP), ("jog", "jaw", "2"), ("calibrate", "neutral")):
                done = run(*command, "--config", jaw.face, "--port", jaw.port)
                assert done.returncode == 1
                assert "another program" in done.stderr, done.stderr
                assert "Traceback" not in done.stderr
            wait_for(lambda: all_driven(daemon))  # a busy computer may have lost a tick just now
            assert not jaw.is_off()
        assert jaw.is_off()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_after_a_signal_it_has_eased_to_neutral_and_is_let_go(jaw, number):
    with jaw.driven() as daemon:
        daemon.send_signal(number)
        assert daemon.wait(PATIENCE_S) == 0
    says, never = WORDS[jaw.bus]
    neutral, tolerance = NEUTRAL[jaw.bus]

    assert jaw.is_off()
    assert says in log(daemon)
    assert never not in log(daemon)
    last = [value for is_driven, value in jaw.sent() if is_driven][-1]
    assert last == pytest.approx(neutral, abs=tolerance)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_the_bridge_ends_the_face(jaw, number):
    with jaw.driven() as daemon:
        os.kill(child(daemon, "bridge"), number)
        assert daemon.wait(PATIENCE_S) == 0
    assert jaw.is_off()


def test_a_bridge_that_is_shot_leaves_it_let_go_and_is_replaced(jaw):
    with jaw.driven() as daemon:
        n_before, first = len(jaw.rows()), child(daemon, "bridge")
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: child(daemon, "bridge") != first)
        wait_for(lambda: all_driven(daemon) and not jaw.is_off())
        assert jaw.was_off_since(n_before)
    assert jaw.is_off()


def test_speech_that_ends_by_any_signal_is_replaced(jaw):
    with jaw.driven() as daemon:
        for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP):
            speech = child(daemon, "speech")
            os.kill(speech, number)
            wait_for(lambda speech=speech: child(daemon, "speech") != speech)
        wait_for(lambda: all_driven(daemon) and not jaw.is_off())
    assert jaw.is_off()


def test_a_supervisor_that_is_shot_takes_the_face_with_it(jaw):
    with jaw.driven() as daemon:
        daemon.kill()
        wait_for(jaw.is_off)


def test_when_all_are_shot_its_guard_lets_it_go_and_says_so(jaw):
    with jaw.driven() as daemon:
        shoot([daemon.pid, child(daemon, "bridge"), child(daemon, "speech")])
        daemon.wait(PATIENCE_S)
    wait_for(jaw.is_off)
    wait_for(lambda: "its processes have died; its guard at" in log(daemon))

    said = "torque off confirmed by all 1 servos" if jaw.bus == "feetech" else PULSES_OFF
    assert said in log(daemon).splitlines()[-1]


def test_limp_without_a_face_lets_go_what_nobody_else_has(jaw):
    """Even the guard is dead."""
    with jaw.driven() as daemon:
        shoot([daemon.pid, *children_of(daemon.pid)])
        daemon.wait(PATIENCE_S)
    assert not jaw.is_off()

    done = run("limp", "--port", jaw.port)

    assert done.returncode == 0, done.stderr
    assert (PULSES_OFF in done.stdout + done.stderr) == (jaw.bus != "feetech")
    assert jaw.is_off()


def test_a_face_that_hangs_is_ended_by_a_stop(jaw):
    with jaw.driven() as daemon:
        for pid in (daemon.pid, child(daemon, "bridge")):
            os.kill(pid, signal.SIGSTOP)
        done = run("stop", "--limp")

        assert done.returncode == 0, done.stdout + done.stderr
        assert (PULSES_OFF in done.stdout + done.stderr) == (jaw.bus != "feetech")
        assert jaw.is_off()


def test_a_frozen_face_holds_where_it_was_sent(jaw):
    with jaw.driven() as daemon:
        assert run("stop", "--freeze").returncode == 0
        time.sleep(0.3)
        before = jaw.sent()[-1]
        time.sleep(0.3)
        assert jaw.sent()[-1] == before
        assert not jaw.is_off()
    assert jaw.is_off()
    assert daemon.returncode == 0


def test_a_plug_that_was_out_brings_it_back(bus, tmp_path):
    with contextlib.ExitStack() as plugged:
        jaw = plugged.enter_context(simulated(bus, tmp_path))
        with jaw.driven() as daemon:
            plugged.close()
            wait_for(lambda: "port of the servos is gone" in log(daemon))
            jaw.log.unlink()
            plugged.enter_context(simulated(bus, tmp_path))
            wait_for(lambda: all_driven(daemon) and not jaw.is_off())
        assert jaw.is_off()


def test_run_at_a_terminal_ends_by_a_signal(jaw):
    said = jaw.folder / "said.txt"
    with (
        said.open("w") as errors,
        subprocess.Popen(
            [*LIPSERVO, "run", "--config", jaw.face, "--port", jaw.port, "--wav", CLIP],
            stderr=errors,
            stdout=subprocess.DEVNULL,
        ) as process,
    ):
        wait_for(lambda: process.poll() is not None or not jaw.is_off())
        process.terminate()
        assert process.wait(PATIENCE_S) == 128 + signal.SIGTERM, said.read_text()
    assert jaw.is_off()
