"""`status --on` and `stop --on`: faces of other computers, good ones and all that can be wrong."""

import contextlib
import http.server
import json
import shutil
import socket
import ssl
import subprocess
import threading
from importlib.metadata import version

import pytest
from served_dashboard import served
from typer.testing import CliRunner

from lipservo.access import kiosks as asking
from lipservo.cli import app
from lipservo.commands.run import kiosks as commands
from lipsync.errors import UserError

HERE = version("lipservo")
REPORT = {"confirmed": ["jaw"], "unconfirmed": {}, "waits": True}


def invoke(*arguments):
    return CliRunner().invoke(app, [str(each) for each in arguments])


def listed(folder, end="...\n", **faces):
    """A YAML of faces by name: (url, token) or (url, token, certificate)."""
    lines = ["kiosks:"]
    for name, (url, token, *certificate) in faces.items():
        (folder / f"{name}.token").write_text(f"{token}\n")
        trust = f", certificate: {certificate[0]}" if certificate else ""
        lines.append(f'  {name}: {{url: "{url}", token_file: {name}.token{trust}}}')
    path = folder / "kiosks.yaml"
    path.write_text("\n".join(lines) + f"\n{end}")
    return path


def by_name(done):
    return {each["name"]: each for each in json.loads(done.stdout)["faces"]}


@contextlib.contextmanager
def dead():
    """An address where nothing listens."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield f"http://127.0.0.1:{taken.getsockname()[1]}"


@contextlib.contextmanager
def hung():
    """An address where connections are accepted and nothing is ever said."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        yield f"http://127.0.0.1:{silent.getsockname()[1]}"


@contextlib.contextmanager
def answering(answer, certificate=None):
    """A server that answers everything with this JSON; it yields its URL and what it was asked."""
    asked = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append((self.path, self.headers["Authorization"]))
            body = json.dumps(answer).encode()
            self.send_response(200)
            self.send_header("content-length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        do_POST = do_GET  # noqa: N815 (the library's name)

        def log_message(self, *_args):
            pass

    class Server(http.server.ThreadingHTTPServer):
        def handle_error(self, *_args):  # a client that does not like the certificate
            pass

    with Server(("127.0.0.1", 0), Handler) as server:
        scheme = "http"
        if certificate is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(*certificate)
            server.socket = context.wrap_socket(server.socket, server_side=True)
            scheme = "https"
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"{scheme}://127.0.0.1:{server.server_port}", asked
        finally:
            server.shutdown()


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """A certificate for 127.0.0.1, signed by itself, and its key."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl, which makes the certificate, is not installed")
    folder = tmp_path_factory.mktemp("tls")
    made, key = folder / "made.pem", folder / "key.pem"
    subject = ["-subj", "/CN=kiosk", "-addext", "subjectAltName=IP:127.0.0.1"]
    curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2"]
    subprocess.run(
        ["openssl", "req", "-x509", *curve, *subject, "-keyout", key, "-out", made],
        check=True,
        capture_output=True,
    )
    return made, key


@pytest.fixture
def impatient(monkeypatch):
    """Faces that hang are given up soon."""
    monkeypatch.setattr(commands, "_STATUS_S", 1.0)
    monkeypatch.setattr(commands, "_END_S", 1.0)
    monkeypatch.setattr(asking, "_SOON_S", 0.5)


@pytest.mark.usefixtures("impatient")
def test_all_good_faces_are_stopped_beside_dead_and_hung_ones(tmp_path):
    with (
        served(token="first") as hall,
        served(token="second") as door,
        dead() as nowhere,
        hung() as silent,
    ):
        hall.face.report = door.face.report = REPORT
        on = listed(
            tmp_path,
            stuck=(silent, "x"),
            hall=(hall.address, "first"),
            gone=(nowhere, "x"),
            door=(door.address, "second"),
        )
        done = invoke("stop", "--limp", "--on", on, "--json")

        assert done.exit_code == 1
        assert (hall.face.said, door.face.said) == (["limp"], ["limp"])
    faces = by_name(done)
    assert [faces[name]["confirmed"] for name in ("hall", "door")] == [["jaw"], ["jaw"]]
    assert not any(faces[name]["problem"] for name in ("hall", "door"))
    assert "no server answers at 127.0.0.1" in faces["gone"]["error"]
    assert "hangs: no answer" in faces["stuck"]["error"]
    # As each answers: who hangs is told last, and named while it is waited for.
    assert list(faces)[-1] == "stuck"
    assert "no answer yet: stuck\n" in done.stderr
    assert "hall: limp, confirmed by all 1 servos; it waits: `lipservo start`" in done.stderr


def test_a_face_that_refuses_the_token_is_named(tmp_path):
    with served(token="t") as hall, served(token="t") as shy:
        on = listed(tmp_path, hall=(hall.address, "t"), shy=(shy.address, "another"))
        done = invoke("status", "--on", on)

    assert done.exit_code == 1
    refused = f"shy: its server refuses the token in {tmp_path}/shy.token; copy the face's"
    assert refused in done.stdout
    assert "hall  simulated servos  driven" in done.stdout


def test_a_stop_that_all_confirm_is_exit_status_0_and_one_that_is_not_confirmed_is_not(tmp_path):
    with served(token="t") as hall:
        on = listed(tmp_path, hall=(hall.address, "t"))
        hall.face.report = {**REPORT, "at_rest": True}
        done = invoke("stop", "--on", on)
        told = "hall: at rest and limp, confirmed by all 1 servos; it waits: `lipservo start`\n"
        assert (done.exit_code, done.stdout) == (0, told)
        hall.face.report = {"confirmed": [], "unconfirmed": {"jaw": "does not answer"}}
        done = invoke("stop", "--on", on)
        assert done.exit_code == 1
        assert "NOT by jaw" in done.stdout


def test_a_freeze_tells_what_holds(tmp_path):
    held = {"accepted": "freeze", "holds": ["jaw"], "limp": ["left"], "unknown": []}
    with answering(held) as (url, asked):
        done = invoke("stop", "--freeze", "--on", listed(tmp_path, hall=(url, "t")))
    told = "hall: held where it is: 1 servo holds; left limp\n"
    assert (done.exit_code, done.stdout) == (0, told)
    assert asked == [("/api/stop", "Bearer t")]


def test_the_status_of_a_face_is_as_on_its_own_computer(tmp_path):
    with served(token="t") as hall:
        on = listed(tmp_path, hall=(hall.address, "t"))
        done = invoke("status", "--on", on)
        told = by_name(invoke("status", "--on", on, "--json"))["hall"]
    assert (done.exit_code, done.stdout) == (0, "hall  simulated servos  driven\n")
    assert (told["state"], told["version"], told["url"]) == ("driven", HERE, hall.address)


@pytest.mark.parametrize(
    ("answer", "line"),
    [
        ({"state": "driven", "face_answers": True, "version": "0.1"}, "its version is 0.1, here"),
        ({"state": "driven"}, "its version is an older one, here is"),
        ({"mood": 1, "face_answers": True, "version": "9.9"}, "runs lipservo 9.9"),
        ({"version": HERE, "face_answers": False, "trouble": "the face hangs"}, "the face hangs"),
        ([1], "nothing that a face says"),
    ],
)
def test_a_status_of_another_version_or_none_is_told(tmp_path, answer, line):
    with answering(answer) as (url, _):
        done = invoke("status", "--on", listed(tmp_path, hall=(url, "t")))
    assert done.exit_code == 1
    assert line in done.stdout


def test_a_stop_that_another_version_answers_is_not_taken_for_confirmed(tmp_path):
    with answering({"ok": True}) as (url, _):
        done = invoke("stop", "--on", listed(tmp_path, hall=(url, "t")))
    assert done.exit_code == 1
    assert f"answers as no face of version {HERE} does" in done.stdout


def test_a_certificate_is_trusted_where_it_is_named_alone(tmp_path, certificate):
    held = {"accepted": "freeze", "holds": ["jaw"], "limp": [], "unknown": []}
    with answering(held, certificate) as (url, asked):
        unnamed = invoke("stop", "--freeze", "--on", listed(tmp_path, hall=(url, "t")))
        assert asked == []  # the token was not sent
        named = listed(tmp_path, hall=(url, "t", certificate[0]))
        done = invoke("stop", "--freeze", "--on", named)
        other = url.replace("127.0.0.1", "localhost")
        named = listed(tmp_path, hall=(other, "t", certificate[0]))
        elsewhere = invoke("stop", "--freeze", "--on", named)
    for each in (unnamed, elsewhere):
        assert each.exit_code == 1
        assert "hall: its server's certificate is not trusted" in each.stdout
    assert (done.exit_code, asked) == (0, [("/api/stop", "Bearer t")])


def test_a_bad_file_of_one_face_keeps_no_other_from_being_stopped(tmp_path):
    (tmp_path / "text.pem").write_text("no certificate")
    with served(token="t") as hall:
        hall.face.report = REPORT
        on = listed(
            tmp_path,
            blank=("https://127.0.0.1:1", ""),
            odd=("https://127.0.0.1:2", "t", "text.pem"),
            hall=(hall.address, "t"),
        )
        done = invoke("stop", "--on", on, "--json")
        assert hall.face.said == ["soft"]
    faces = by_name(done)
    assert done.exit_code == 1
    assert faces["hall"]["confirmed"] == ["jaw"]
    assert "its first line is empty" in faces["blank"]["error"]
    assert "text.pem: cannot be read as PEM certificates" in faces["odd"]["error"]


FACE = '  a: {url: "https://a.example", token_file: a}\n'


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("kiosks:\n" + FACE, "its last line must be `...`"),
        ("kiosks:\n" + FACE + '  b: {url: "htt', "not YAML at line 3"),
        ("<<<<<<< HEAD\nkiosks:\n" + FACE + "...\n", "not YAML at line 2"),
        ("kiosks:\n" + FACE + FACE + "...\n", "given twice, on lines 2 and 3"),
        ("kiosks:\n" + FACE + FACE.replace("a:", "b:") + "...\n", "a and b have the same url"),
        ("kiosks: {}\n...\n", "kiosks"),
        ("kiosks:\n" + FACE.replace("https", "http") + "...\n", "would cross the network"),
        ("kiosks:\n" + FACE.replace("https", "ws") + "...\n", "write https://HOST:PORT"),
        ("kiosks:\n" + FACE.replace("a.example", "me:pw@a.example") + "...\n", "write https://"),
        ("kiosks:\n" + FACE.replace("token_file", "token") + "...\n", "did you mean token_file"),
    ],
)
def test_a_list_that_is_half_or_wrong_is_refused_before_any_face_is_asked(tmp_path, text, line):
    on = tmp_path / "kiosks.yaml"
    on.write_text(text)
    done = invoke("stop", "--on", on)
    assert isinstance(done.exception, UserError)
    assert line in str(done.exception)
    assert "kiosks.yaml" in str(done.exception)
    assert done.stdout == ""


def test_faces_here_and_elsewhere_are_not_mixed(tmp_path):
    done = invoke("status", "--on", tmp_path / "none.yaml", "--face", "tom")
    assert "--on, --face, --control: give one of them" in str(done.exception)
    done = invoke("status", "--on", tmp_path / "none.yaml")
    assert "none.yaml: cannot be read" in str(done.exception)
