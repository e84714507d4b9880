"""A whole daemon with its dashboard, and a program of another user of this computer."""

import json
import os
import re
import shutil
import subprocess
import sys

import httpx
import pytest
from lipservo_client.protocol import FaceError
from places import short_folder
from running_daemon import LIPSERVO, PATIENCE_S, wait_for
from websockets.sync.client import connect

import lipservo
from firmware_bridge.process.control_client import ask

OTHER = 65534

#: With the standard library alone, for the system's own Python. Arguments: agents' port, page's
#: port, what to do; prints JSON.
PROGRAM = r"""
import base64, http.client, json, os, socket, sys

agents, page, what = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]

def status(port, method, path, body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, given)
    answer = connection.getresponse()
    answer.read()
    return answer.status

def opened(port, path):
    key = base64.b64encode(os.urandom(16)).decode()
    raw = socket.create_connection(("127.0.0.1", port), 30)
    raw.sendall((f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
                 f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\n"
                 "Sec-WebSocket-Version: 13\r\n\r\n").encode())
    head = b""
    while b"\r\n\r\n" not in head:
        head += raw.recv(1)
    return raw, int(head.split()[1])

def answer_to(raw, **message):
    data = json.dumps(message).encode()
    raw.sendall(bytes([0x81, 0x80 | len(data)]) + bytes(4) + data)
    first, length = raw.recv(1), raw.recv(1)[0]
    if length == 126:
        length = int.from_bytes(raw.recv(2), "big")
    answer = b""
    while len(answer) < length:
        answer += raw.recv(length - len(answer))
    return json.loads(answer)

found = {"uid": os.getuid()}
if what == "everything":
    requests = [("GET", path) for path in ("/", "/servos", "/api/status", "/api/health", "/metrics",
        "/docs", "/openapi.json", "/static/stop.js", "/api/lines", "/api/settings", "/api/servos",
        "/api/history", "/api/faults", "/api/calibration", "/twin/head.bin",
        "/_nicegui_ws/socket.io/?EIO=4&transport=polling")]
    requests += [("POST", path) for path in ("/api/start", "/api/say", "/api/play", "/api/jog",
        "/api/servos/jaw", "/api/interrupt", "/api/look-at", "/api/affect", "/api/lines?name=a.wav",
        "/_nicegui_ws/socket.io/?EIO=4&transport=polling")]
    requests += [("PATCH", "/api/settings"), ("DELETE", "/api/lines/a.wav")]
    found["page"] = {f"{m} {p}": status(page, m, p, "{}" if m != "GET" else None,
        Content_Type="application/json") for m, p in requests}
    found["page"]["POST stop end"] = status(page, "POST", "/api/stop", '{"end": true}')
    for path in ("/api/twin", "/api/state", "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"):
        found["page"][f"socket {path}"] = opened(page, path)[1]
    found["agents"] = {path: status(agents, "GET", path) for path in ("/", "/status")}
    found["agents"]["/stream"] = opened(agents, "/stream")[1]
    raw, _ = opened(agents, "/control")
    commands = [{"type": "status"}, {"type": "set", "name": "strength", "value": 0.5},
        {"type": "say", "text": "hello"}, {"type": "play", "file": "a.wav"}, {"type": "start"},
        {"type": "stop", "level": "limp", "end": True}]
    for each in commands:
        answer = answer_to(raw, id=1, **each)
        found["agents"][str(each)] = 401 if answer.get("code") == "unauthorized" else answer
    found["token"] = []
    for folder, _, names in os.walk(sys.argv[4]):
        found["token"] += [os.path.join(folder, name) for name in names]
elif what == "page stop":
    body = json.dumps({"level": "freeze", "wait_s": 0})
    found["status"] = status(page, "POST", "/api/stop", body, Content_Type="application/json")
elif what == "control stop":
    found["answer"] = answer_to(opened(agents, "/control")[0], type="stop", id=1, level="freeze")
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    """A face in one process and its page, as `lipservo daemon --dashboard` starts them."""
    folder, session = tmp_path_factory.mktemp("face"), short_folder()
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(session), "XDG_DATA_HOME": str(folder)}
    environment["LIPSERVO_STATE"] = str(folder / "state")
    environment.pop("LIPSERVO_RUNTIME", None)
    options = ["--listen", "127.0.0.1:0", "--dashboard", "--dashboard-listen", "127.0.0.1:0"]
    printed = folder / "printed.txt"
    with printed.open("w") as log:
        process = subprocess.Popen(
            [*LIPSERVO, "daemon", *options], stdout=log, stderr=log, env=environment
        )
        try:
            wait_for(lambda: list((session / "lipservo").glob("*.sock")))
            (process.control,) = (session / "lipservo").glob("*.sock")
            wait_for(lambda: "dashboard: http" in printed.read_text())
            address = re.search(r"dashboard: (http\S+)", printed.read_text())[1]
            token = (session / "lipservo" / "token").read_text().strip()
            process.page = f"{address}/?token={token}"
            process.agents = ask(process.control, "status", PATIENCE_S)["listens_on"]
            process.session = session
            wait_for(lambda: is_up(process.page))
            yield process
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


def is_up(page):
    with httpx.Client(follow_redirects=True, trust_env=False, timeout=30.0) as browser:
        try:
            browser.get(page)
            address = page.partition("/?")[0]
            return browser.get(f"{address}/api/health").json().get("up")
        except httpx.HTTPError:
            return False


def port_of(url):
    return re.match(r"\w+://127\.0\.0\.1:(\d+)", url)[1]


def as_other(daemon, what):
    """The program's answer, run by another user."""
    setpriv, python = shutil.which("setpriv"), "/usr/bin/python3"
    if os.geteuid() != 0 or setpriv is None or not os.access(python, os.X_OK):
        pytest.skip("needs root, setpriv and /usr/bin/python3 to be another user")
    done = subprocess.run(
        [setpriv, f"--reuid={OTHER}", f"--regid={OTHER}", "--clear-groups", python, "-c", PROGRAM,
         port_of(daemon.agents), port_of(daemon.page), what, str(daemon.session)],
        cwd="/", timeout=PATIENCE_S, check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["uid"] == OTHER
    return found


def test_no_tcp_port_of_a_face_opens_to_another_user_without_the_token(daemon):
    found = as_other(daemon, "everything")

    assert {name: got for name, got in found["page"].items() if got != 401} == {}
    assert {name: got for name, got in found["agents"].items() if got != 401} == {}
    assert len(found["page"]) + len(found["agents"]) >= 40
    assert found["token"] == []  # the folder is closed to others


@pytest.mark.parametrize("way", ["page stop", "control stop"])
def test_another_user_of_this_computer_may_stop_the_face(daemon, way):
    found = as_other(daemon, way)
    if way == "page stop":
        assert found["status"] == 200
    else:
        assert found["answer"]["result"]["accepted"] == "freeze"
    wait_for(lambda: ask(daemon.control, "status", PATIENCE_S)["state"] == "frozen")


@pytest.mark.parametrize("origin", ["http://localhost:3000", "http://127.0.0.1:9999", "null"])
def test_pages_of_other_ports_are_refused_by_both_servers_whatever_they_know(daemon, origin):
    address, token = daemon.page.split("/?token=")
    headers = {"origin": origin, "authorization": f"Bearer {token}"}
    for path in ("/stream", "/control"):
        with (
            pytest.raises(Exception, match="403"),
            connect(daemon.agents + path, additional_headers=headers, proxy=None),
        ):
            pass
    for method, path in (("GET", "/"), ("GET", "/api/status"), ("POST", "/api/stop")):
        answer = httpx.request(method, address + path, headers=headers, trust_env=False)
        assert answer.status_code == 403


def test_our_own_clients_find_the_token_by_themselves(daemon, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(daemon.session))
    with lipservo.connect(daemon.agents) as face:
        assert face.set("strength", 0.75)["value"] == 0.75
    done = subprocess.run(
        [sys.executable, "-m", "lipservo", "say", "hello", "--through", daemon.agents],
        timeout=PATIENCE_S, check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert "token" not in done.stderr

    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for token in (None, "wrong"):
        with pytest.raises(FaceError, match="needs the token") as refused:
            lipservo.connect(daemon.agents, token=token).__enter__()
        assert refused.value.code == "unauthorized"
