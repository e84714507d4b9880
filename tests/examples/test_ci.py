"""The recipes of examples/ci do what they say: the shell steps of the workflow, and the image's."""

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
import urllib.request
import venv

import pytest
import yaml
from places import ROOT

CI = ROOT / "examples" / "ci"
WORKFLOW = yaml.safe_load((CI / "github.yml").read_text())
STEPS = [step for step in WORKFLOW["jobs"]["face"]["steps"] if "run" in step]
DOCKERFILE = [line.split(" ", 1) for line in (CI / "Dockerfile").read_text().splitlines()]
#: As GitHub starts it.
BASH = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c"]
PATIENCE_S = 120.0


def test_the_workflow_is_one_of_github_and_each_step_runs_or_uses_something():
    assert set(WORKFLOW) >= {"name", "jobs"}
    assert all(("run" in step) != ("uses" in step) for step in WORKFLOW["jobs"]["face"]["steps"])


@pytest.mark.parametrize("place", ["docs/simulator.md", "examples/ci/Dockerfile"])
def test_a_container_is_started_so_that_its_token_is_printed(place):
    """The token is printed only on a terminal."""
    (line,) = re.findall(r"docker run [^`\n]*", (ROOT / place).read_text())
    assert "-it" in line.split()


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """An empty environment with the wheels of this checkout, and where they lie."""
    folder = tmp_path_factory.mktemp("ci")
    for source in (ROOT, ROOT / "client"):
        command = [sys.executable, "-m", "build", "--wheel", "--outdir", str(folder / "dist")]
        subprocess.run([*command, str(source)], check=True, capture_output=True)
    venv.create(folder / "venv", with_pip=True)
    return folder


def environment(folder):
    """As on a runner: our wheels are found where an index would have them, and nothing else is."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("LIPSERVO")}
    path = f"{folder / 'venv' / 'bin'}:{kept['PATH']}"
    return kept | {"PATH": path, "PIP_FIND_LINKS": str(folder / "dist"), "PYTHONPATH": ""}


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


@pytest.mark.packaging
def test_the_shell_steps_of_the_workflow_pass(installed, tmp_path):
    port = free_port()
    for name in ("test_face.py", "speak.py"):
        (tmp_path / name).write_text((CI / name).read_text())
    for step in STEPS:
        own = {
            name: value.replace("${{ runner.temp }}", str(tmp_path))
            for name, value in step.get("env", {}).items()
        }
        done = subprocess.run(
            [*BASH, step["run"].replace("8765", port)],
            cwd=tmp_path, env=environment(installed) | own,
            capture_output=True, text=True, check=False, timeout=5 * PATIENCE_S,
        )  # fmt: skip
        assert done.returncode == 0, (step["name"], done.stdout[-2000:], done.stderr[-2000:])


@pytest.mark.packaging
def test_what_the_image_installs_and_starts_serves_page_and_port(installed, tmp_path):
    """No container is started: its RUN, ENV and CMD lines are, with folders of this machine."""
    (install,) = (words for word, words in DOCKERFILE if word == "RUN" and "pip install" in words)
    (settings,) = (words for word, words in DOCKERFILE if word == "ENV")
    (command,) = (words for word, words in DOCKERFILE if word == "CMD")
    variables = environment(installed)
    wheels = install.replace("/src[dashboard]", "lipservo[dashboard]")
    line = shlex.split(wheels.replace("/src/client", "lipservo-client"))
    subprocess.run(line, check=True, env=variables, capture_output=True)
    page, agents = free_port(), free_port()
    line = yaml.safe_load(command.replace("8080", page).replace("8765", agents))
    name, value = settings.split("=")
    variables |= {name: value.replace("/home/face", str(tmp_path)), "HOME": str(tmp_path)}
    with subprocess.Popen(
        line, env=variables, cwd=tmp_path, stderr=subprocess.PIPE, text=True
    ) as face:
        try:
            address = re.search(rf"http://\S+:{page}\S*", wait_for(face, f":{page}"))
            assert address is not None
            token = (tmp_path / "run" / "token").read_text().strip()
            request = urllib.request.Request(
                f"http://127.0.0.1:{page}/api/status", headers={"Authorization": f"Bearer {token}"}
            )
            give_up_s = time.monotonic() + PATIENCE_S
            status = {}
            while status.get("state") != "driven" and time.monotonic() < give_up_s:
                with urllib.request.urlopen(request, timeout=PATIENCE_S) as reply:
                    status = json.load(reply)
                time.sleep(0.1)
            assert status["state"] == "driven"
            socket.create_connection(("127.0.0.1", int(agents)), PATIENCE_S).close()
        finally:
            face.send_signal(signal.SIGTERM)
    assert face.returncode == 0


def wait_for(process, text):
    give_up_s = time.monotonic() + PATIENCE_S
    for line in process.stderr:
        if text in line or time.monotonic() > give_up_s:
            return line
    return ""
