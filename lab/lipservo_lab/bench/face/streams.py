"""What watching costs: processor time of the dashboard, by how many clients watch.

This process is the face: a bridge at 100 Hz with ten simulated servos behind a pseudo-terminal,
which writes its live board and answers at a control socket. The dashboard is the real one in a
process of its own, and so are its clients.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.operating_system import on_time
from firmware_bridge.serial_servos.serial_transport import open_port
from firmware_bridge.stopping import StopLevel
from lipservo.agents.listener import bind_listener
from lipservo.dashboard.child import address_of, dashboard_child
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.runtime.status.live_board import (
    FACE_STATES,
    BoardLayout,
    LiveBoard,
    ServoBoard,
    expression_values,
)
from lipservo_lab.seen_processes import child_of, processor_s
from lipsync.phonemes import PHONEMES

RATE_HZ: Final = 100.0
_N_SERVOS, _BAUD_RATE, _N_COMPONENTS = 10, 1_000_000, 8
MANY: Final = 20
_START_S, _SETTLE_S = 180.0, 1.0
#: Of a core, of a dashboard that nobody watches; it is waited for so many seconds at most.
_SHARE_AT_REST, _MOST_SETTLING = 0.08, 60


class BenchedFace:
    """The servo loop of a face at 100 Hz, with simulated speech, run for a given time."""

    def __init__(
        self,
        bridge: Bridge,
        channel: MemoryTargetChannel,
        board: LiveBoard,
        control: ControlSocket,
    ) -> None:
        self._bridge = bridge
        self._servo_board = ServoBoard(board, bridge)
        self._board = board
        self._control = control
        self._channel = channel
        self._clock = MonotonicClock()

    def run(self, seconds: float, *, until: Callable[[], bool] = lambda: False) -> None:
        """Run the loop for some seconds, scheduled as the bridge's process is.

        until: ends it earlier once it returns True; called every ten ticks.
        """
        with on_time():
            end_s = self._clock.now() + seconds
            for n, (time_s, late) in enumerate(ticks(self._clock, RATE_HZ)):
                if self._clock.now() > end_s or (n % 10 == 0 and until()):
                    return
                self._tick(time_s, late)

    def _tick(self, time_s: float, late: int) -> None:
        """Run one tick: publish a swinging target, write the live board, answer control requests.

        time_s: monotonic. late: ticks missed before this one.
        """
        swing = float(np.sin(2.0 * np.pi * time_s))
        self._channel.publish(ServoTargets(time_s, np.full(_N_SERVOS, 20.0 * swing)))
        self._servo_board.tell(self._bridge.tick(time_s, late))
        self._board.write_speech(
            [abs(swing)],
            time_s=time_s,
            sound_s=time_s,
            phoneme=int(10.0 * time_s) % len(PHONEMES),
            is_speech=1,
            arousal=swing,
            coefficients=np.full(_N_COMPONENTS, swing),
            expression=expression_values(),
        )
        self._control.poll()
        self._control.answer(self._bridge.as_dict)


def stream_figures(seconds: float) -> dict[str, float]:
    """Return the dashboard's share of a core with one client and with twenty.

    seconds: for how long each is measured.
    """
    figures: dict[str, float] = {}
    with watched_face() as (face, address, dashboard):
        _wait_until_at_rest(face, dashboard())
        for n in (1, MANY):
            with clients(address, n, "/api/twin"):
                face.run(_SETTLE_S)
                began_s, spent_s = time.monotonic(), processor_s(dashboard())
                face.run(seconds)
                figures[f"dashboard_core_share_{n}"] = _core_share(dashboard(), spent_s, began_s)
    return figures


@contextmanager
def watched_face() -> Iterator[tuple[BenchedFace, str, Callable[[], int]]]:
    """Run a simulated face with a dashboard; yield the face, the dashboard's URL, and its process.

    The third value returns the process id. Raises RuntimeError where the dashboard does not start.
    """
    model = servo_models()["XL330-M288"]
    joints = [Joint(f"joint_{n}", n, -40.0, 40.0, 300.0) for n in range(1, _N_SERVOS + 1)]
    servos = [MountedServo(joint, model) for joint in joints]
    names = tuple(joint.name for joint in joints)
    layout = BoardLayout("bench", "bench", names, FACE_STATES, PHONEMES, _N_COMPONENTS, RATE_HZ)
    options = ["--servos", str(_N_SERVOS), "--baud-rate", str(_BAUD_RATE), "--on-time"]
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        port = stack.enter_context(simulated_port(options))
        bus = stack.enter_context(DynamixelBus(servos, lambda: open_port(port, _BAUD_RATE)))
        board = stack.enter_context(LiveBoard.create(layout))
        face_facts = {"name": "bench", "port": port}
        control = ControlSocket(folder / "bench.sock", face_facts, watched_fd=board.fileno())
        stack.enter_context(control)
        channel = MemoryTargetChannel()
        bridge = Bridge(bus, joints, channel, BridgeSettings(RATE_HZ, tolerant=True))
        bridge.start()
        stack.callback(lambda: bridge.stop(StopLevel.LIMP))
        listener = stack.enter_context(bind_listener("127.0.0.1:0", None))
        stack.enter_context(dashboard_child(control.path, listener))
        face = BenchedFace(bridge, channel, board, control)
        address = address_of(listener)
        asking = subprocess.Popen([sys.executable, "-c", _WAIT_FOR_HEALTH, f"{address}/api/health"])
        face.run(_START_S, until=lambda: asking.poll() is not None)
        if asking.wait() != 0:
            raise RuntimeError("the dashboard did not start")
        yield face, address, _dashboard


def _dashboard() -> int:
    """Return the process id of the dashboard. Raises RuntimeError where it has ended."""
    if (pid := child_of(os.getpid(), "dashboard")) is None:
        raise RuntimeError("the dashboard has ended")
    return pid


#: Waits until the dashboard says that its face ticks.
_WAIT_FOR_HEALTH: Final = """
import json, sys, time, urllib.request
end_s = time.monotonic() + 170
while time.monotonic() < end_s:
    try:
        with urllib.request.urlopen(sys.argv[1], timeout=50) as answer:
            if json.load(answer)["up"]:
                sys.exit(0)
    except OSError:
        pass
    time.sleep(0.2)
sys.exit(1)
"""


@contextmanager
def clients(address: str, n: int, path: str) -> Iterator[None]:
    """Run `n` clients of a stream, in a process of their own, until the block ends."""
    module = "lipservo_lab.bench.face.stream_clients"
    command = [sys.executable, "-P", "-m", module, address, path, str(n)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.readline()  # they are connected
        try:
            yield
        finally:
            process.stdin.close()


def _wait_until_at_rest(face: BenchedFace, pid: int) -> None:
    """Run the face until its dashboard, just started, uses little processor time.

    pid: of the dashboard. At most `_MOST_SETTLING` seconds.
    """
    for _ in range(_MOST_SETTLING):
        began_s, spent_s = time.monotonic(), processor_s(pid)
        face.run(_SETTLE_S)
        if _core_share(pid, spent_s, began_s) < _SHARE_AT_REST:
            return


def _core_share(pid: int, spent_s: float, began_s: float) -> float:
    """Return a process's share of a core since `began_s`, when it had used `spent_s`."""
    return (processor_s(pid) - spent_s) / (time.monotonic() - began_s)
