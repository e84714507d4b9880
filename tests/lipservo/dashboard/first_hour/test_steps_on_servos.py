"""Steps of the first hour on simulated servos behind a port: whatever happens, they are limp."""

import os
import signal

import pytest
from first_hour_server import served
from running_daemon import torque, wait_for

from firmware_bridge.bus_kinds import bus_kind
from lipservo.runtime.servos.new_face import FoundJoint, face_yaml
from lipservo.runtime.servos.sim_process import simulated_port, simulated_servos

#: Whole processes, and half a minute each.
pytestmark = pytest.mark.slow
IDS = (11, 12)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "tom.yaml"
    joints = [
        FoundJoint("jaw", 11, "XL330-M288", "opens", 1),
        FoundJoint("corner_left_out", 12, "XL330-M288", "widens", 1),
    ]
    path.write_text(face_yaml("tom", bus_kind("dynamixel"), "/dev/none", 1_000_000, joints))
    return path


@pytest.fixture
def servos(path):
    with simulated_servos(["--config", str(path)]) as made:
        yield made


@pytest.fixture
def server(path, servos):
    with served(path, "--port", servos.port) as made:
        yield made


def held(server):
    """By eye, until the servos are held and the first shape is shown."""
    assert server.post("start", step="by_eye").status_code == 200
    return server.until(lambda state: "eye" in (state["step"]["events"] or {}))


def test_a_server_that_is_killed_leaves_its_servos_limp(server, servos):
    held(server)

    os.kill(server.process.pid, signal.SIGKILL)

    wait_for(lambda: torque(servos.port, IDS) == [0, 0])


def test_a_page_that_is_closed_lets_the_servos_go_and_keeps_the_poses(server, servos, path):
    held(server)
    server.post("order", move={"jaw": 4.0, "corner_left_out": 500.0})
    server.post("order", key="\r")
    made = server.until(lambda state: state["step"]["events"]["eye"]["made"] == ["closed"])
    assert made["step"]["events"]["eye"]["goals_deg"] == {"jaw": 4.0, "corner_left_out": 10.0}

    wait_for(lambda: torque(servos.port, IDS) == [0, 0])  # nobody asks for the state meanwhile

    state = server.until(lambda state: state["works"] is None)
    assert "no browser had this page open" in state["note"]
    assert state["keeps"] is True
    assert not path.with_suffix(".calibration.yaml").exists()


def test_a_stop_lets_go_at_once_and_is_no_error_of_the_step(server, servos):
    held(server)
    refused = server.post("start", step="limits")  # as a second browser would
    assert refused.status_code == 409
    assert "step 'by eye' uses the servos" in refused.json()["error"]

    stopped = server.client.post("/api/stop", json={"level": "soft", "wait_s": 20})

    assert stopped.json()["report"]["confirmed"] == ["jaw", "corner_left_out"]
    state = server.until(lambda state: state["works"] is None)
    assert state["step"]["error"] is None
    assert torque(servos.port, IDS) == [0, 0]


def test_a_port_that_goes_away_ends_the_step_in_one_line_and_writes_nothing(server, servos, path):
    before = path.read_bytes()
    server.post("start", step="limits")
    server.until(lambda state: "turned" in (state["step"]["events"] or {}))
    servos.turn(0, 8.0)
    server.until(lambda state: state["step"]["events"]["turned"]["deg"]["jaw"] == 8.0)

    servos.process.terminate()

    state = server.until(lambda state: state["works"] is None)
    assert state["step"]["error"]
    assert "Traceback" not in " ".join(state["step"]["notes"])
    assert path.read_bytes() == before


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_stop_lets_go_of_the_servos_of_a_step_that_is_dead_or_hangs(server, servos, how):
    held(server)
    os.kill(server.step_pid(), how)
    if how is signal.SIGKILL:
        server.until(lambda state: state["works"] is None)

    stopped = server.client.post("/api/stop", json={"level": "soft", "wait_s": 15}).json()

    assert torque(servos.port, IDS) == [0, 0]
    assert (stopped["accepted"], stopped["is_limp"]) == (None, True)
    assert "limp, confirmed by all 2 servos" in stopped["nothing_driven"]
    error = server.until(lambda state: state["works"] is None)["step"]["error"]
    assert "signal 9" in error if how is signal.SIGKILL else "limp, confirmed by all 2" in error
    assert server.post("start", step="limits").status_code == 200


def test_a_stop_that_finds_no_servo_to_let_go_of_says_what_is_wrong(server, servos):
    held(server)
    servos.process.send_signal(signal.SIGSTOP)  # first: a guard lets go for a step that is dead
    os.kill(server.step_pid(), signal.SIGKILL)
    servos.process.kill()
    servos.process.wait()

    stopped = server.client.post("/api/stop", json={"level": "limp", "wait_s": 0}).json()

    assert stopped["is_limp"] is False
    assert servos.port in stopped["nothing_driven"]
    assert "switch their supply off" in stopped["nothing_driven"]


def test_servos_of_the_kind_that_is_given_are_searched_for_at_the_port_that_is_given(tmp_path):
    with (
        simulated_port(["--kind", "feetech", "--servos", "1", "--model", "STS3215"]) as port,
        served(tmp_path / "new.yaml", "--bus", "feetech", "--port", port) as server,
    ):
        state = server.until(lambda state: state["works"] is None)

    assert (state["kind"], state["port"]) == ("feetech", port)
    assert state["found"]["servos"] == {"1": "STS3215"}, state["step"]
