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
    """The answers of a face, and the seconds until each, by path of the request."""

    of: dict[str, tuple[dict[str, Any], float]]


def fleet_figures(n_daemons: int, n_endpoints: int, advance: Advance) -> dict[str, Any]:
    """Return the figures of `lipservo bench fleet`.

    status_s, stop_s: from the start of the command until the last of the good faces is printed.
    confirmed: share of the good faces whose servos all confirmed. named: of the dead and hung ones,
    how many are named correctly. advance: as `progress_bar` yields it. Raises UserError
    where a daemon does not start.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="lipservo-fleet-")))
        daemons = _daemons(n_daemons + 1, folder, stack)
        advance("fleet", 1, 4)
        # One more daemon is stopped first, and says what the endpoints answer.
        certificate = _certificate(folder)
        recorded = _recorded(daemons.pop(), folder)
        endpoints = [_endpoint(recorded, certificate, stack) for _ in range(n_endpoints)]
        dead = [_closed_port() for _ in range(N_DEAD)]
        hung = [_silent_port(stack) for _ in range(N_HUNG)]
        listed = folder / "kiosks.yaml"
        good = {
            **{f"daemon-{n}": f'"{url}"' for n, url in enumerate(daemons)},
            **{
                f"endpoint-{n}": f'"{url}", certificate: "{certificate[0]}"'
                for n, url in enumerate(endpoints)
            },
        }
        bad = {f"dead-{n}": f'"{url}"' for n, url in enumerate(dead)}
        bad |= {f"hung-{n}": f'"{url}"' for n, url in enumerate(hung)}
        listed.write_text(_yaml({**bad, **good}), "utf-8")
        advance("fleet", 2, 4)
        status_s, _, status_named = _run_on_all("status", listed, good)
        advance("fleet", 3, 4)
        stop_s, faces, stop_named = _run_on_all("stop", listed, good)
        advance("fleet", 4, 4)
    confirmed = [
        name in good and not (face.get("error") or face["problem"] or face["unconfirmed"])
        for name, face in faces.items()
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


def _daemons(n: int, folder: Path, stack: ExitStack) -> list[str]:
    """Start daemons with dashboards; return the URLs of these once all are driven."""
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
        answers = ask_kiosks(kiosks, KioskRequest("GET", "/api/status", 5.0))
        if all(isinstance(a, dict) and a.get("state") == "driven" for _, a, _ in answers):
            return urls
        time.sleep(_LOOK_S)
    raise UserError(f"not all daemons were driven within {_START_S:g} s")


def _recorded(url: str, folder: Path) -> _Answers:
    """Request a real face's status and a stop; return its answers, with seconds until each."""
    kiosk = {"it": Kiosk(url=url, token_file=str(folder / "runtime" / "token"))}
    stop = {"level": "soft", "wait_s": 10.0, "end": False}
    requests = (
        KioskRequest("GET", "/api/status", 5.0),
        KioskRequest("POST", "/api/stop", 15.0, stop),
    )
    found = {}
    for each in requests:
        ((_, answer, seconds),) = ask_kiosks(kiosk, each)
        if isinstance(answer, KioskError):
            raise answer
        found[each.path] = answer, seconds
    return _Answers(found)


def _endpoint(answers: _Answers, certificate: tuple[Path, Path], stack: ExitStack) -> str:
    """Serve recorded answers over TLS until the stack ends; return the URL."""

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
            pass  # a client that has gone is counted where it was told

    server = stack.enter_context(Server(("127.0.0.1", 0), Handler))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*certificate)
    server.socket = context.wrap_socket(
        server.socket, server_side=True, do_handshake_on_connect=False
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    stack.callback(server.shutdown)
    return f"https://127.0.0.1:{server.server_port}"


def _certificate(folder: Path) -> tuple[Path, Path]:
    """Make a certificate for 127.0.0.1 that signs itself, and its key, by the program openssl."""
    made, key = folder / "made.pem", folder / "key.pem"
    subject = ["-subj", "/CN=kiosk", "-addext", "subjectAltName=IP:127.0.0.1", "-days", "2"]
    kind = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]
    try:
        subprocess.run(
            ["openssl", "req", "-x509", *kind, *subject, "-keyout", key, "-out", made],
            check=True,
            capture_output=True,
        )
    except (OSError, subprocess.CalledProcessError) as error:
        raise UserError(f"openssl, which makes the endpoints' certificate: {error}") from error
    return made, key


def _closed_port() -> str:
    with socket.create_server(("127.0.0.1", 0)) as closed:
        return f"http://127.0.0.1:{closed.getsockname()[1]}"


def _silent_port(stack: ExitStack) -> str:
    """Return a URL at which the kernel accepts connections, without an answer."""
    silent = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
    return f"http://127.0.0.1:{silent.getsockname()[1]}"


def _yaml(faces: dict[str, str]) -> str:
    rows = [f"  {name}: {{url: {url}, token_file: runtime/token}}" for name, url in faces.items()]
    return "\n".join(["kiosks:", *rows, "...", ""])


def _run_on_all(
    command: str, listed: Path, good: Sequence[str] | dict[str, str]
) -> tuple[float, dict[str, dict[str, Any]], int]:
    """Run `lipservo status` or `stop` on all faces.

    Returns seconds until the last of the good ones was printed, the JSON by name, and how many of
    the others were named correctly.
    """
    began_s = time.monotonic()
    last_s = 0.0
    output = listed.with_name(f"{command}.json")
    with (
        output.open("w") as out,
        started(
            [*_LIPSERVO, command, "--on", str(listed), "--json"],
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
        ) as process,
        _killed_after(process, _COMMAND_S),
    ):
        assert process.stderr is not None
        for line in process.stderr:
            if re.split(r"[ :]", line)[0] in good:
                last_s = time.monotonic() - began_s
    faces = {each["name"]: each for each in json.loads(output.read_text())["faces"]}
    words = {"dead": "no server answers", "hung": "hangs"}
    named = [
        words[name.partition("-")[0]] in face.get("error", "")
        for name, face in faces.items()
        if name not in good
    ]
    return last_s, faces, sum(named)


@contextlib.contextmanager
def _killed_after(process: "subprocess.Popen[str]", seconds: float) -> Iterator[None]:
    timer = threading.Timer(seconds, process.kill)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
