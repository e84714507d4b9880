"""How soon all of many faces tell their status, and confirm a stop, beside dead and hung ones.

Real daemons with their dashboards, on simulated servos; and endpoints that answer over TLS what one
of these daemons answered, after as long. The requests are sent by the command that a person types.
"""

import contextlib
import http.server
import json
import os
import re
import socket
import ssl
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from lipservo.access.kiosks import Kiosk, KioskError, KioskRequest, ask_kiosks
from lipservo.terminal.output import Advance
from lipservo_lab.own_processes import started
from lipsync.errors import UserError

N_DEAD: Final = 3
N_HUNG: Final = 2
_LIPSERVO: Final = (sys.executable, "-P", "-m", "lipservo")
_PAGE: Final = re.compile(r"dashboard: (http://[\d.]+:\d+)")
#: A dozen daemons start together on two cores, beside whatever else runs there.
_START_S: Final = 1200.0
_LOOK_S: Final = 0.2
_COMMAND_S: Final = 120.0


@dataclass(frozen=True, slots=True)
class _Answers:
    """A face's recorded answers. of: request path -> (JSON answer, seconds until it came)."""

    of: dict[str, tuple[dict[str, Any], float]]


def fleet_figures(n_daemons: int, n_endpoints: int, advance: Advance) -> dict[str, Any]:
    """Run `lipservo status` and `lipservo stop` on many faces at once; return the figures.

    Faces: `n_daemons` real daemons and `n_endpoints` servers of recorded answers, which are good;
    `N_DEAD` closed ports and `N_HUNG` ports that accept but never answer.
    status_s, stop_s: from the start of the command until the last good face is printed.
    confirmed: share of good faces whose servos all confirmed the stop. named: how many of the dead
    and hung faces are reported as such. Raises UserError where a daemon does not start.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="lipservo-fleet-")))
        daemon_urls = _start_daemons(n_daemons + 1, folder, stack)
        advance("fleet", 1, 4)
        # One more daemon is stopped first, and says what the endpoints answer.
        certificate = _make_certificate(folder)
        recorded = _record_answers(daemon_urls.pop(), folder)
        endpoint_urls = [_serve_answers(recorded, certificate, stack) for _ in range(n_endpoints)]
        dead_urls = [_closed_port() for _ in range(N_DEAD)]
        hung_urls = [_open_silent_port(stack) for _ in range(N_HUNG)]
        kiosks_yaml = folder / "kiosks.yaml"
        good = {
            **{f"daemon-{n}": f'"{url}"' for n, url in enumerate(daemon_urls)},
            **{
                f"endpoint-{n}": f'"{url}", certificate: "{certificate[0]}"'
                for n, url in enumerate(endpoint_urls)
            },
        }
        bad = {f"dead-{n}": f'"{url}"' for n, url in enumerate(dead_urls)}
        bad |= {f"hung-{n}": f'"{url}"' for n, url in enumerate(hung_urls)}
        kiosks_yaml.write_text(_kiosks_yaml({**bad, **good}), "utf-8")
        advance("fleet", 2, 4)
        status_s, _, status_named = _run_on_all("status", kiosks_yaml, good)
        advance("fleet", 3, 4)
        stop_s, face_of, stop_named = _run_on_all("stop", kiosks_yaml, good)
        advance("fleet", 4, 4)
    confirmed = [
        name in good and not (face.get("error") or face["problem"] or face["unconfirmed"])
        for name, face in face_of.items()
    ]
    return {
        "faces": len(good),
        "daemons": n_daemons,
        "status_s": round(status_s, 3),
        "stop_s": round(stop_s, 3),
        "confirmed": sum(confirmed) / len(good),
        "named": min(status_named, stop_named),
        "dead_and_hung": len(bad),
    }


def _start_daemons(n: int, folder: Path, stack: ExitStack) -> list[str]:
    """Start n daemons that end with `stack`; return their dashboards' URLs once all drive servos.

    Raises UserError if that takes longer than `_START_S`.
    """
    environment = {
        **os.environ,
        "LIPSERVO_RUNTIME": str(folder / "runtime"),
        "LIPSERVO_STATE": str(folder / "state"),
    }
    (folder / "runtime").mkdir(mode=0o700)
    options = ["--listen", "none", "--dashboard", "--dashboard-listen", "127.0.0.1:0"]
    logs = [folder / f"daemon-{n}.log" for n in range(n)]
    for log in logs:
        output = {"stdout": stack.enter_context(log.open("wb")), "stderr": subprocess.STDOUT}
        daemon = started([*_LIPSERVO, "daemon", *options], env=environment, **output)
        stack.enter_context(daemon)
    give_up_s = time.monotonic() + _START_S
    while not all(_PAGE.search(log.read_text(errors="replace")) for log in logs):
        if time.monotonic() > give_up_s:
            raise UserError(f"a daemon did not start within {_START_S:g} s: {logs[0].read_text()}")
        time.sleep(_LOOK_S)
    found = [_PAGE.search(log.read_text(errors="replace")) for log in logs]
    urls = [match[1] for match in found if match is not None]
    token_file = str(folder / "runtime" / "token")
    while time.monotonic() < give_up_s:
        kiosks = {url: Kiosk(url=url, token_file=token_file) for url in urls}
        statuses = ask_kiosks(kiosks, KioskRequest("GET", "/api/status", 5.0))
        if all(isinstance(a, dict) and a.get("state") == "driven" for _, a, _ in statuses):
            return urls
        time.sleep(_LOOK_S)
    raise UserError(f"not all daemons were driven within {_START_S:g} s")


def _record_answers(url: str, folder: Path) -> _Answers:
    """Request a real face's status and a stop; return its answers, with seconds until each."""
    kiosk = {"it": Kiosk(url=url, token_file=str(folder / "runtime" / "token"))}
    stop = {"level": "soft", "wait_s": 10.0, "end": False}
    requests = (
        KioskRequest("GET", "/api/status", 5.0),
        KioskRequest("POST", "/api/stop", 15.0, stop),
    )
    answer_of_path = {}
    for request in requests:
        ((_, answer, seconds),) = ask_kiosks(kiosk, request)
        if isinstance(answer, KioskError):
            raise answer
        answer_of_path[request.path] = answer, seconds
    return _Answers(answer_of_path)


def _serve_answers(answers: _Answers, certificate: tuple[Path, Path], stack: ExitStack) -> str:
    """Serve recorded answers over TLS, each after its recorded delay, until `stack` is closed.

    certificate: PEM files of certificate and key. Returns the server's URL.
    """

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            """Answer with the recorded JSON of this path, after the real daemon's delay."""
            answer, seconds = answers.of[self.path]
            time.sleep(seconds)
            body = json.dumps(answer).encode()
            self.send_response(200)
            self.send_header("content-length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def do_POST(self) -> None:
            self.do_GET()

        def log_message(self, *_args: Any) -> None:
            pass

    class Server(http.server.ThreadingHTTPServer):
        def handle_error(self, *_args: Any) -> None:
            pass  # a client that hung up is counted by the caller

    server = stack.enter_context(Server(("127.0.0.1", 0), Handler))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*certificate)
    server.socket = context.wrap_socket(
        server.socket, server_side=True, do_handshake_on_connect=False
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    stack.callback(server.shutdown)
    return f"https://127.0.0.1:{server.server_port}"


def _make_certificate(folder: Path) -> tuple[Path, Path]:
    """Make a self-signed certificate for 127.0.0.1 with the program openssl.

    Returns the PEM files of the certificate and of its key. Raises UserError if openssl fails.
    """
    certificate, key = folder / "made.pem", folder / "key.pem"
    subject = ["-subj", "/CN=kiosk", "-addext", "subjectAltName=IP:127.0.0.1", "-days", "2"]
    curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]
    try:
        subprocess.run(
            ["openssl", "req", "-x509", *curve, *subject, "-keyout", key, "-out", certificate],
            check=True,
            capture_output=True,
        )
    except (OSError, subprocess.CalledProcessError) as error:
        raise UserError(f"openssl, which makes the endpoints' certificate: {error}") from error
    return certificate, key


def _closed_port() -> str:
    """Return the URL of a port at which nothing listens."""
    with socket.create_server(("127.0.0.1", 0)) as closed:
        return f"http://127.0.0.1:{closed.getsockname()[1]}"


def _open_silent_port(stack: ExitStack) -> str:
    """Return a URL at which the kernel accepts connections, but no program ever answers."""
    silent = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
    return f"http://127.0.0.1:{silent.getsockname()[1]}"


def _kiosks_yaml(url_of: dict[str, str]) -> str:
    rows = [f"  {name}: {{url: {url}, token_file: runtime/token}}" for name, url in url_of.items()]
    return "\n".join(["kiosks:", *rows, "...", ""])


def _run_on_all(
    command: str, kiosks_yaml: Path, good_names: Sequence[str] | dict[str, str]
) -> tuple[float, dict[str, dict[str, Any]], int]:
    """Run `lipservo status` or `lipservo stop` on all faces of a kiosks file; wait until it ends.

    Returns seconds until the last of `good_names` was printed, each face's JSON by name, and of
    how many other faces (`dead-...`, `hung-...`) the error says correctly that they are so.
    """
    began_s = time.monotonic()
    last_s = 0.0
    output = kiosks_yaml.with_name(f"{command}.json")
    with (
        output.open("w") as out,
        started(
            [*_LIPSERVO, command, "--on", str(kiosks_yaml), "--json"],
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
        ) as process,
        _kill_after(process, _COMMAND_S),
    ):
        assert process.stderr is not None
        for line in process.stderr:
            if re.split(r"[ :]", line)[0] in good_names:
                last_s = time.monotonic() - began_s
    faces = {each["name"]: each for each in json.loads(output.read_text())["faces"]}
    # What the error of a dead and of a hung face has to contain.
    words = {"dead": "no server answers", "hung": "hangs"}
    named = [
        words[name.partition("-")[0]] in face.get("error", "")
        for name, face in faces.items()
        if name not in good_names
    ]
    return last_s, faces, sum(named)


@contextlib.contextmanager
def _kill_after(process: "subprocess.Popen[str]", seconds: float) -> Iterator[None]:
    timer = threading.Timer(seconds, process.kill)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
