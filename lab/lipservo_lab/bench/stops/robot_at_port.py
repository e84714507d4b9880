"""Simulated servos at a serial port, and real `lipservo` processes that drive them.

For the campaigns: the servos live in this process, so that torque and shafts are seen as they are,
whatever anybody says of them.
"""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import lipservo
from firmware_bridge.dynamixel.mounting import MountedServo, mounted_servos
from firmware_bridge.simulator.ports import PtyHost
from lipservo.settings.settings import FaceSettings, load_face, load_shipped_face
from lipservo_lab.bench.stops.faces_on_buses import face_yaml, logged_servos
from lipservo_lab.bench.stops.logged_device import LoggedDevice
from lipservo_lab.own_processes import started_alone
from lipservo_lab.seen_processes import children_of

FACE: Final = "face_four"
CLIP: Final = Path(lipservo.__file__).parent / "clips" / "welcome.flac"

_LOOK_S: Final = 0.005
_N_LAST_CHARACTERS: Final = 2000
#: Of first-in-first-out scheduling; above everything ordinary.
_PRIORITY: Final = 50


@dataclass(frozen=True, slots=True)
class Look:
    """The state of the servos at one monotonic time: torque (n,), and shafts (n,) in degrees."""

    time_s: float
    torque: NDArray[np.bool_]
    shafts_deg: NDArray[np.float64]


@dataclass(slots=True)
class RobotAtPort:
    """Simulated servos, their serial port, and processes started at it; see `robot_at_port`.

    device: the servos and their log. config: the face, as processes get it with `--config`. folder:
    of all files of this robot. session: in which its processes look for running faces.
    environment: further variables that its processes get. seen: what `look` has recorded.
    """

    device: LoggedDevice
    config: str
    settings: FaceSettings
    folder: Path
    session: Path
    environment: dict[str, str] = field(default_factory=dict)
    seen: list[Look] = field(default_factory=list)
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def port(self) -> Path:
        """The path of the servos' port."""
        return self.folder / "port"

    @property
    def log(self) -> Path:
        """The file of the output of all processes."""
        return self.folder / "log"

    @property
    def output(self) -> str:
        """The output of all processes as text."""
        return self.log.read_text(errors="replace")

    @property
    def last_output(self) -> str:
        """The last characters of the output, for a message."""
        return self.output[-_N_LAST_CHARACTERS:]

    @property
    def chain(self) -> Any:
        """The simulator of the servos: of Dynamixels a `SimulatedChain`."""
        return self.device.device

    @property
    def servos(self) -> list[MountedServo]:
        """The Dynamixels of the face, as they are mounted."""
        return mounted_servos(self.settings.wiring)

    @property
    def torque(self) -> NDArray[np.bool_]:
        """Which servos hold now; of hobby servos: get pulses.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,).
        """
        return np.array(self.device.truth.on)

    @property
    def controls(self) -> list[Path]:
        """The control sockets of the faces that were started here."""
        return list(self.runtime.glob("*.sock"))

    @property
    def runtime(self) -> Path:
        """The folder of the control sockets."""
        return self.session / "lipservo"

    def look(self, seconds: float) -> None:
        """Record torque and shafts in `seen` every `_LOOK_S` for so many seconds."""
        until_s = time.monotonic() + seconds
        while (now_s := time.monotonic()) < until_s:
            self.seen.append(Look(now_s, self.torque, self.device.truth.shafts_deg()))
            time.sleep(_LOOK_S)

    def look_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Record as `look` until `condition` holds; return False if it does not in `timeout_s`."""
        give_up_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > give_up_s:
                return False
            self.look(_LOOK_S)
        return True

    def stiff_until_s(self, since_s: float) -> float:
        """Return how long after monotonic `since_s` a servo was last seen with torque, s."""
        stiff_s = [each.time_s for each in self.seen if each.torque.any()]
        return max(0.0, stiff_s[-1] - since_s) if stiff_s else 0.0

    def switched_on(self, since_s: float) -> int:
        """Return how many times a servo got torque after `since_s` (monotonic), by `seen`."""
        successive_looks = zip(self.seen, self.seen[1:], strict=False)
        return sum(
            int((later.torque & ~earlier.torque).sum())
            for earlier, later in successive_looks
            if earlier.time_s > since_s
        )

    def moved_deg(self, since_s: float) -> NDArray[np.float64]:
        """Return how far apart the extremes of each shaft are, in what was seen since a time.

        Parameters
        ----------
        since_s : float
            Monotonic seconds.

        Returns
        -------
        NDArray[np.float64]
            (n_servos,) degrees.
        """
        angles_deg = np.array([each.shafts_deg for each in self.seen if each.time_s >= since_s])
        return np.asarray(np.ptp(angles_deg, axis=0))

    def start(
        self, *arguments: str, stdin: int = subprocess.DEVNULL, output: int | None = None
    ) -> subprocess.Popen[bytes]:
        """Start a `lipservo` process, whose faces are found only by programs of this session."""
        return self.start_python("-m", "lipservo", *arguments, stdin=stdin, output=output)

    def start_python(
        self, *arguments: str, stdin: int = subprocess.DEVNULL, output: int | None = None
    ) -> subprocess.Popen[bytes]:
        """Start a Python process in this robot's environment; the kernel ends it with this process.

        output: file descriptor for its output; None: the log.
        """
        with self.log.open("ab") as file:
            process = started_alone(
                [sys.executable, "-P", *arguments],
                signal.SIGKILL,
                stdin=stdin,
                stdout=file if output is None else output,
                stderr=file if output is None else output,
                env=self._environment(),
            )
        self.processes.append(process)
        return process

    def _environment(self) -> dict[str, str]:
        """Return the environment of processes: this robot's folders, and none of the user's."""
        left_out = ("NOTIFY_SOCKET", "RUNTIME_DIRECTORY", "STATE_DIRECTORY")
        environment = {key: value for key, value in os.environ.items() if key not in left_out}
        environment["XDG_RUNTIME_DIR"] = str(self.session)
        environment["XDG_STATE_HOME"] = str(self.folder / "state")
        environment["LIPSERVO_RUNTIME"] = str(self.runtime)
        environment["LIPSERVO_STATE"] = str(self.folder / "state" / "lipservo")
        environment["XDG_DATA_HOME"] = str(self.folder / "data")
        environment["TMPDIR"] = str(self.folder / "tmp")
        return environment | self.environment


def kill_all(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and its children at once, as `killall -9` does; ignore an ended one."""
    if process.poll() is None:
        children = children_of(process.pid)
        process.kill()
        for pid in children:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        process.wait()


@contextlib.contextmanager
def robot_at_port(
    bus: str = "dynamixel",
    session: Path | None = None,
    *,
    critical: bool = False,
    face: str = FACE,
) -> Iterator[RobotAtPort]:
    """Serve the simulated servos of a shipped face at a port; yield them, limp in neutral.

    Processes started at the robot are killed afterwards. bus: kind of bus. session: folder of
    another robot, whose processes then see the same running faces; None: a new one. critical: the
    first servo is critical. face: name of the shipped face.
    """
    with tempfile.TemporaryDirectory(prefix="lipservo-robot-") as temporary:
        folder = Path(temporary)
        (folder / "tmp").mkdir()
        if session is None:
            session = folder / "session"
            session.mkdir(mode=0o700)
        config, settings = face, load_shipped_face(face)
        if bus != "dynamixel" or critical:
            file = folder / "face.yaml"
            file.write_text(face_yaml(settings, bus, critical=critical))
            config, settings = str(file), load_face(file)
        robot = RobotAtPort(logged_servos(settings.wiring), config, settings, folder, session)
        robot.log.touch()
        host = PtyHost(robot.device, robot.port)
        is_over = threading.Event()
        server = threading.Thread(target=_serve_port, args=(host, is_over), daemon=True)
        server.start()
        try:
            with _on_time():
                yield robot
        finally:
            for process in robot.processes:
                kill_all(process)
                if process.stdin is not None:
                    process.stdin.close()
            is_over.set()
            server.join()
            host.close()


def _serve_port(host: PtyHost, is_over: threading.Event) -> None:
    with _on_time():
        host.serve(is_over.is_set)


@contextlib.contextmanager
def _on_time() -> Iterator[None]:
    """Let a thread run before all others, where permitted, but not the processes it starts.

    Servos do not wait for a busy computer; and reading their state holds Python's lock meanwhile.
    """
    previous = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(OSError):
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(_PRIORITY))
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, *previous)
