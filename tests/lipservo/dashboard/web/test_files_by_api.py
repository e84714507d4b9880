"""Sound lines and saved settings through real HTTP."""

import socket

import numpy as np
import pytest
import soundfile
from served_dashboard import served, wait_for

from lipservo.settings.edited_yaml import EditedYaml
from lipservo.settings.settings import load_face
from lipsync.output_file import OutputError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("own")
    (made / "sounds").mkdir()
    soundfile.write(made / "sound.wav", 0.1 * np.sin(np.arange(16_000)), 16_000)
    (made / "tom.yaml").write_text(
        "name: tom # a comment\nrate_hz: 100.0\nservos:\n  jaw: {id: 11, model: XL330-M288, "
        "positive: opens, min_deg: -2, max_deg: 25, max_speed_deg_s: 300}\n"
    )
    return made


@pytest.fixture(scope="module")
def dashboard(folder):
    status = {"sounds": str(folder / "sounds"), "config": str(folder / "tom.yaml")}
    with served(status) as made:
        yield made


@pytest.fixture
def client(dashboard):
    with dashboard.client() as made:
        yield made


def test_a_line_is_uploaded_listed_and_deleted(client, folder):
    sound = (folder / "sound.wav").read_bytes()
    answer = client.post("/api/lines", params={"name": "hello there.wav"}, content=sound)
    assert answer.status_code == 201
    assert (folder / "sounds" / "hello there.wav").read_bytes() == sound
    (line,) = client.get("/api/lines").json()["lines"]
    assert line["name"] == "hello there.wav"

    again = client.post("/api/lines", params={"name": "hello there.wav"}, content=sound)
    assert again.status_code == 409
    assert client.delete("/api/lines/hello there.wav").status_code == 200
    assert client.delete("/api/lines/hello there.wav").status_code == 404
    assert client.get("/api/lines").json() == {"lines": []}


@pytest.mark.parametrize(
    "name", ["../tom.yaml", "../a.wav", "/tmp/a.wav", "a\0.wav", ".a.wav", "a.py", "a" * 400]
)
def test_no_name_leads_out_of_the_folder(client, folder, name):
    before = sorted(folder.rglob("*"))
    sound = (folder / "sound.wav").read_bytes()
    answer = client.post("/api/lines", params={"name": name}, content=sound)
    assert answer.status_code == 422
    assert client.delete(f"/api/lines/{name}".replace("\0", "%00")).status_code in (404, 405, 422)
    assert client.post("/api/play", json={"file": name}).status_code == 422
    assert sorted(folder.rglob("*")) == before


def test_too_much_is_refused_before_it_comes_and_while_it_comes(client, folder):
    head = f"POST /api/lines?name=a.wav HTTP/1.1\r\nHost: {client.base_url.netloc.decode()}\r\n"
    host, port = client.base_url.host, client.base_url.port
    with socket.create_connection((host, port), timeout=20.0) as declared:
        declared.sendall(f"{head}Content-Length: 50000001\r\n\r\n".encode())
        assert declared.recv(4096).startswith(b"HTTP/1.1 413")

    def chunks():
        for _ in range(51):
            yield bytes(1_000_000)

    assert client.post("/api/lines", params={"name": "a.wav"}, content=chunks()).status_code == 413
    assert list((folder / "sounds").iterdir()) == []


def test_what_is_no_sound_is_not_kept(client, folder):
    answer = client.post("/api/lines", params={"name": "a.wav"}, content=b"text")
    assert answer.status_code == 415
    assert list((folder / "sounds").iterdir()) == []


def test_a_line_that_is_not_there_is_not_played(client):
    assert client.post("/api/play", json={"file": "gone.wav"}).status_code == 404


def test_a_setting_is_set_and_saved(client, dashboard, folder):
    body = {"values": {"strength": 0.5, "lookahead_ms": 150.0}, "save": True}
    told = client.patch("/api/settings", json=body).json()

    assert told == {"set": {"strength": 0.5}, "saved": True, "at_restart": ["lookahead_ms"]}
    assert dashboard.face.commands.values["strength"] == 0.5
    saved = load_face(folder / "tom.yaml").motion
    assert (saved.strength, saved.lookahead_ms) == (0.5, 150.0)
    assert "# a comment" in (folder / "tom.yaml").read_text()
    assert client.get("/api/settings").json()["saved"]["strength"] == 0.5


def test_how_lively_a_face_is_is_saved_in_its_own_place(client, dashboard, folder):
    body = {"values": {"expression": 0.6}, "save": True}
    told = client.patch("/api/settings", json=body).json()

    assert told == {"set": {"expression": 0.6}, "saved": True, "at_restart": []}
    assert dashboard.face.commands.values["expression"] == 0.6
    assert load_face(folder / "tom.yaml").expression.amount == 0.6
    assert client.get("/api/settings").json()["saved"]["expression"] == 0.6
    # The face is asked how it is twice a second.
    wait_for(lambda: client.get("/api/settings").json()["live"]["expression"] == 0.6)


def test_what_is_for_the_moment_is_not_saved(client, folder):
    text = (folder / "tom.yaml").read_text()
    body = {"values": {"look_yaw_deg": 10.0}, "save": True}
    assert client.patch("/api/settings", json=body).status_code == 422
    assert (folder / "tom.yaml").read_text() == text


def test_what_cannot_be_saved_is_not_set_either(client, dashboard, folder):
    text = (folder / "tom.yaml").read_text()
    before = dashboard.face.commands.values["strength"]
    body = {"values": {"strength": 1.0, "smoothness": 7.0}, "save": True}
    assert client.patch("/api/settings", json=body).status_code == 422
    assert dashboard.face.commands.values["strength"] == before
    assert (folder / "tom.yaml").read_text() == text


def test_what_the_face_refuses_is_not_saved_either(client, dashboard, folder):
    text = (folder / "tom.yaml").read_text()
    dashboard.face.answers = False
    answer = client.patch("/api/settings", json={"values": {"strength": 1.2}, "save": True})
    dashboard.face.answers = True
    assert answer.status_code == 503
    assert (folder / "tom.yaml").read_text() == text


def test_what_cannot_be_written_is_put_back_as_it_was(client, dashboard, monkeypatch):
    before = dashboard.face.commands.values["strength"]

    def fails(_self):
        assert dashboard.face.commands.values["strength"] == 1.4
        raise OutputError("the disk is full")

    monkeypatch.setattr(EditedYaml, "write", fails)
    body = {"values": {"strength": 1.4}, "save": True}
    answer = client.patch("/api/settings", json=body)
    assert (answer.status_code, answer.json()) == (409, {"error": "the disk is full"})
    assert dashboard.face.commands.values["strength"] == before


def test_an_upload_that_breaks_off_leaves_no_file_and_no_line_in_the_log(
    dashboard, folder, caplog, capfd
):
    """The client goes in the middle of its body."""
    before = sorted((folder / "sounds").iterdir())
    host, port = dashboard.address.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as going:
        going.sendall(
            b"POST /api/lines?name=half.wav HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            b"Content-Length: 1000000\r\n\r\n" + 100_000 * b"a"
        )
        wait_for(lambda: sorted((folder / "sounds").iterdir()) != before)
    wait_for(lambda: sorted((folder / "sounds").iterdir()) == before)
    with dashboard.client() as client:
        assert client.get("/api/health").status_code == 200
    assert caplog.records == []
    assert "Traceback" not in capfd.readouterr().err
