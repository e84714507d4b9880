"""pytest fixtures `simulated_face` and `shared_simulated_face`: a running face without servos.

For tests of its clients; pytest finds them by itself wherever lipservo is installed.
docs/simulator.md has a recipe for CI.
"""

import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest

if TYPE_CHECKING:
    from lipservo_client.blocking_face import Face

_POLL_S: Final = 0.05

#: Time to start and to end. A runner of tests may be very busy.
_PATIENCE_S: Final = 120.0


class SimulatedFace:
    """A `lipservo daemon` with simulated servos and a silent loudspeaker, running for tests.

    Attributes
    ----------
    url : str
        Address at which it listens for voice agents.
    token : str
        Token that clients must send.
    """

    def __init__(self, process: "subprocess.Popen[str]", folder: Path) -> None:
        """Wait until the face in `process` drives its servos; it is killed after 120 s.

        folder: of its control socket, `token` and `trace.jsonl`. Raises RuntimeError if the process
        ends.
        """
        assert process.stderr is not None
        self._process = process
        self._messages = process.stderr
        self._lines: list[str] = []
        self._folder, self._trace = folder, folder / "trace.jsonl"
        self._reader = threading.Thread(target=self._read_messages, daemon=True)
        self.url = ""
        self._has_ended = threading.Event()
        giving_up = threading.Timer(_PATIENCE_S, process.kill)
        giving_up.start()
        self._reader.start()
        try:
            self._wait_until_driven(folder / "token")
        finally:
            giving_up.cancel()

    @property
    def messages(self) -> str:
        """The newest 1000 lines that the face has printed on stderr until now."""
        return "".join(self._lines)

    def connect(self) -> "Face":
        """Return a client of this face: `with simulated_face.connect() as face:`."""
        from lipservo_client import connect

        return connect(self.url, self.token)

    def clip(self, duration_s: float | None = None) -> tuple[bytes, int]:
        """Return recorded speech, at most `duration_s` of it, and its rate: arguments of `play`."""
        import soundfile

        with (resources.files("lipservo.clips") / "welcome.flac").open("rb") as file:
            samples, rate_hz = soundfile.read(file, dtype="int16")
        n = None if duration_s is None else round(duration_s * rate_hz)
        return samples[:n].astype("<i2").tobytes(), rate_hz

    def play(self, samples: bytes, rate_hz: int) -> None:
        """Let the face speak a sound, and return when it was played.

        Parameters
        ----------
        samples : bytes
            Sound, 16 bit, little endian, one channel.
        rate_hz : int
            Samples per second, 8,000 to 96,000.
        """
        with self.connect() as face, face.stream(rate_hz) as speech:
            speech.write(samples)
            speech.wait()

    def encoders_deg(self) -> dict[str, float]:
        """Return each servo's measured position by its name, in degrees of its joint.

        NaN where a servo has not answered or cannot report its position.
        """
        from firmware_bridge.process.control_client import watch
        from lipservo.runtime.status.live_board import LiveBoard

        (path,) = self._folder.glob("*.sock")  # another fixture may have set LIPSERVO_RUNTIME
        with LiveBoard.watch(watch(path)) as board:
            _, newest = board.servos_since(0)[-1]
            return dict(zip(board.layout.servos, newest["encoder_deg"].tolist(), strict=True))

    def stop(self) -> dict[str, Any]:
        """Switch all torque off at once (a limp stop), and return the stop report.

        `confirmed` has the names of the servos that confirmed torque off, `unconfirmed` a reason
        for each other one. Blocks until the report; RuntimeError after 120 s. The daemon goes on
        and waits for a start.
        """
        give_up_s = time.monotonic() + _PATIENCE_S
        with self.connect() as face:
            face.stop("limp")
            while time.monotonic() < give_up_s:
                report: dict[str, Any] | None = face.status()["stop_report"]
                if report is not None:
                    return report
                time.sleep(_POLL_S)
        raise RuntimeError("the simulated face did not report its stop")

    def end(self) -> list[dict[str, Any]]:
        """End the daemon, wait for its end, and return the trace of its run.

        Returns
        -------
        list of dict
            One for each tick of the motion loop, as `--trace` writes them: `sound_s`, `phoneme`,
            `coefficients`, `sent_deg` (one a servo) and more; docs/traces.md.

        Raises
        ------
        RuntimeError
            The daemon did not end in time, or ended with an error, which is the message.
        """
        self._process.terminate()
        try:
            status = self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        self._reader.join(_PATIENCE_S)
        self._messages.close()
        if status != 0:
            raise RuntimeError(f"the simulated face ended with {status}: {self.messages.strip()}")
        rows = [json.loads(line) for line in self._trace.read_text().splitlines()]
        return [row for row in rows if "tick" in row]

    def _wait_until_driven(self, token: Path) -> None:
        """Wait until the face drives its servos; set `token` from the file at path `token`.

        Raises RuntimeError if the process ends before it listens for voice agents.
        """
        while not self.url:
            if self._has_ended.wait(_POLL_S):
                raise RuntimeError(f"the simulated face did not start: {self.messages.strip()}")
        self.token = token.read_text().strip()
        with self.connect() as face:
            while face.status()["state"] != "driven":
                time.sleep(_POLL_S)

    def _read_messages(self) -> None:
        """Store the lines that the face prints on stderr, and the URL announced in one of them.

        Runs in a thread until the face ends: a full pipe would block the face.
        """
        for line in self._messages:
            self._lines.append(line)
            del self._lines[:-1000]
            _, announced, url = line.partition("voice agents: ")
            if announced:
                self.url = url.strip()
        self._has_ended.set()


@pytest.fixture(scope="session")
def simulated_face_config() -> str:
    """Return the face of `simulated_face`, a shipped name or a YAML file; can be overridden."""
    return "face_sim"


@pytest.fixture
def simulated_face(simulated_face_config: str) -> Iterator[SimulatedFace]:
    """Yield a running face that only this test finds, whichever other faces run beside it.

    Servos that its YAML has at a port are simulated behind pseudo-terminals: none moves.
    """
    with _running_face(simulated_face_config) as face:
        yield face


@pytest.fixture(scope="session")
def shared_simulated_face(simulated_face_config: str) -> Iterator[SimulatedFace]:
    """Yield one running face for all tests of a session, which connect to it and never end it."""
    with _running_face(simulated_face_config) as face:
        yield face


@contextmanager
def _running_face(config: str) -> Iterator[SimulatedFace]:
    """Yield a running simulated face, with files in a temporary folder; end the face afterwards."""
    # Imported here, since pytest loads this module for every test of every project.
    from lipservo.runtime.servos.assembly import load_settings
    from lipservo.runtime.servos.sim_process import servo_port

    # Servos that the YAML has in memory need no port; others are simulated at a pseudo-terminal.
    in_memory = load_settings(config)[0].capabilities.in_memory
    folder = Path(tempfile.mkdtemp(prefix="lipservo-"))  # short: a socket's address has 107 bytes
    try:
        with (
            pytest.MonkeyPatch.context() as environment,
            servo_port(None, None if in_memory else "pty", config) as port,
        ):
            environment.setenv("LIPSERVO_RUNTIME", str(folder))
            environment.setenv("LIPSERVO_STATE", str(folder / "state"))
            arguments = ["--config", config, "--listen", "127.0.0.1:0", "--play", "silent"]
            arguments += [] if port is None else ["--port", port]
            with _daemon_process([*arguments, "--trace", str(folder / "trace.jsonl")]) as process:
                face = SimulatedFace(process, folder)
                yield face
                if process.poll() is None:
                    face.end()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _daemon_process(arguments: list[str]) -> "Iterator[subprocess.Popen[str]]":
    """Yield the process `lipservo daemon` with these arguments; kill it when the block ends."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "lipservo", "daemon", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
