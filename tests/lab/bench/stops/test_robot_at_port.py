"""The robot of the campaigns: what it starts, what it sees, and what it leaves behind."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from lipservo_lab.bench.stops.robot_at_port import Look, robot_at_port

KILLED = """
import os, signal
from lipservo_lab.bench.stops.robot_at_port import robot_at_port
with robot_at_port() as robot:
    process = robot.start_python("-c", "import time; time.sleep(600)")
    print(process.pid, robot.folder, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_campaign_that_is_killed_leaves_no_process_behind():
    killed = subprocess.run([sys.executable, "-c", KILLED], capture_output=True, text=True)
    pid, folder = killed.stdout.split()

    give_up_s = time.monotonic() + 20.0
    while is_running(int(pid)) and time.monotonic() < give_up_s:
        time.sleep(0.01)

    assert not is_running(int(pid))
    subprocess.run(["rm", "-r", folder], check=True)


def test_its_processes_find_no_place_of_this_user_or_of_another_job(monkeypatch):
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/elsewhere")
    names = [f"{name}_HOME" for name in ("XDG_STATE", "XDG_DATA")]
    names += ["XDG_RUNTIME_DIR", "LIPSERVO_RUNTIME", "LIPSERVO_STATE", "TMPDIR"]
    places = f"[os.environ[each] for each in {names}]"
    code = f"import os; print({places}, 'RUNTIME_DIRECTORY' in os.environ)"
    with robot_at_port() as robot, robot_at_port(session=robot.session) as beside:
        assert robot.start_python("-c", code).wait() == 0
        places, has_other = robot.output.rsplit(maxsplit=1)
        assert all(str(robot.folder) in each for each in places.split(","))
        assert has_other == "False"
        assert beside.runtime == robot.runtime
        assert beside.folder != robot.folder


def test_torque_that_comes_on_after_a_moment_is_counted_by_servo():
    with robot_at_port() as robot:
        n_servos = len(robot.servos)
        for time_s, n_on in ((0.0, 4), (1.0, 0), (2.0, 0), (3.0, 3), (4.0, 4)):
            torque = np.arange(n_servos) < n_on
            robot.seen.append(Look(time_s, torque, np.zeros(n_servos)))

        assert robot.switched_on(0.5) == 4
        assert robot.switched_on(2.5) == 1
        assert robot.stiff_until_s(3.5) == 0.5


def test_where_the_shafts_are_is_watched_while_something_is_awaited():
    with robot_at_port() as robot:
        assert robot.look_until(lambda: len(robot.seen) > 2, 10.0)
        assert not robot.torque.any()
        assert os.path.exists(robot.port)
