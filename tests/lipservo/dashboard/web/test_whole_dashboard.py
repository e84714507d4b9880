"""The dashboard as users start it: a process of its own beside a face with simulated servos."""

import asyncio
import json
import os
import re
import signal
import struct

import httpx
import pytest
from running_daemon import all_driven, log, own_folder, running, wait_for
from websockets.asyncio.client import connect

from firmware_bridge.process.control_client import ask
from lipservo.runtime.servos.sim_process import simulated_port


@pytest.fixture
def daemon(tmp_path, monkeypatch):
    own_folder(monkeypatch)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    page = ["--dashboard", "--dashboard-listen", "127.0.0.1:0", "--listen", "127.0.0.1:0"]
    with (
        simulated_port(["--config", "face_sim", "--on-time"]) as port,
        running(port, tmp_path, *page) as process,
    ):
        yield process


def frames(address, n, headers):
    """The hello and n frames of the twin."""

    async def read():
        url = f"{address.replace('http', 'ws', 1)}/api/twin"
        async with connect(url, proxy=None, additional_headers=headers) as stream:
            return [await stream.recv() for _ in range(n + 1)]

    return asyncio.run(read())


@pytest.mark.slow
def test_a_face_is_seen_stopped_and_goes_on_without_its_page(daemon):
    wait_for(lambda: "dashboard: http://" in log(daemon))
    address = re.search(r"dashboard: (http://\S+)", log(daemon))[1]
    token = (daemon.control.parent / "token").read_text().strip()
    bearer = {"authorization": f"Bearer {token}"}
    with httpx.Client(base_url=address, headers=bearer, timeout=60.0, trust_env=False) as client:
        assert httpx.get(f"{address}/api/health", timeout=60.0, trust_env=False).status_code == 401
        with httpx.Client(follow_redirects=True, timeout=60.0, trust_env=False) as browser:
            assert browser.get(f"{address}/?token={token}").status_code == 200
            assert "token" not in str(browser.get(address).url)
        wait_for(lambda: client.get("/api/health").json()["up"])
        wait_for(lambda: all_driven(daemon))

        told = client.get("/api/status").json()
        assert told["name"] == "simulated mouth"
        hello, *found = frames(address, 40, bearer)
        assert len(json.loads(hello)["servos"]) == len(told["servos"])
        numbers = [struct.unpack_from("<I", frame)[0] for frame in found]
        assert numbers == sorted(set(numbers))
        assert client.get("/api/calibration").json()["fits_the_face"]
        assert "lipservo_up 1.0" in client.get("/metrics").text

        page = client.get("/")
        assert page.status_code == 200
        assert not re.search(r"""(?:src|href)=["'](?:https?:)?//""", page.text)
        assert httpx.get(address, headers={"host": "evil.example"}, timeout=60.0).status_code == 401
        foreign = {"origin": "http://evil.example"}
        socket_io = "/_nicegui_ws/socket.io/?EIO=4&transport=polling"
        assert client.get(socket_io, headers=foreign).status_code == 403
        assert client.get(socket_io).status_code == 200

        frozen = client.post("/api/stop", json={"level": "freeze"}).json()
        assert frozen["accepted"] == "freeze"
        wait_for(lambda: client.get("/api/status").json()["state"] == "frozen")

    (dashboard,) = children(daemon.pid, b"dashboard")
    os.kill(dashboard, signal.SIGKILL)
    wait_for(lambda: "it is started again" in log(daemon))
    told = ask(daemon.control, "status")
    assert told["state"] == "frozen"
    assert told["torque_on"]
    daemon.terminate()
    daemon.wait(60.0)
    assert children(daemon.pid, b"dashboard") == []
    assert token not in log(daemon)


def children(parent, word):
    """The processes that a process has started with that word on their command line."""
    found = []
    for folder in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{folder}/stat") as file:
                its_parent = int(file.read().rpartition(")")[2].split()[1])
            with open(f"/proc/{folder}/cmdline", "rb") as file:
                words = file.read().split(b"\0")
        except OSError:
            continue
        if its_parent == parent and word in words:
            found.append(int(folder))
    return found


def is_running(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
