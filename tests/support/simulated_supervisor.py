"""A supervisor whose processes and clock are simulated, for the tests of what it decides."""

import signal
import socket

from dynamixel_chain import BAUD_RATE, MemoryFace
from hobby_bus import PulsePort

from firmware_bridge.dynamixel.control_table import CAPABILITIES
from firmware_bridge.dynamixel.torque import LineRelease
from firmware_bridge.errors import PortError
from firmware_bridge.process.child import HeartbeatMonitor, HeartbeatTimeouts
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.operating_system import ServiceNotice
from firmware_bridge.process.supervisor import SupervisedServos, Supervisor
from firmware_bridge.process.torque_release import FaceRelease, TorqueRelease

NAMES = {1: "jaw", 2: "left", 3: "right"}
#: A round of the loop, as long as it waits at most.
ROUND_S = 0.05


class SimulatedChild:
    """A process as a supervisor sees it; `alive` ones beat whenever the clock is asked."""

    def __init__(self, name, clock, timeouts):
        self.name, self._clock = name, clock
        self._silence = HeartbeatMonitor(timeouts)
        self.pid, self.status, self.said = None, None, []
        self.starts, self.signals = [], []
        self.beats, self.beat_s = True, None

    @property
    def has_beaten(self):
        return self.beat_s is not None

    def filenos(self):
        return []

    def start(self, arguments, now_s):
        self.starts.append(list(arguments))
        self.pid, self.status, self.beat_s = 1000 + len(self.starts), None, None
        self._silence.begin(now_s)

    def read(self):
        if self.pid is not None and self.beats:
            self.beat_s = self._clock.now()
        said, self.said = self.said, []
        return said

    def hung_at_s(self, now_s):
        return self._silence.look(now_s, self.beat_s)

    def ended(self):
        if self.pid is None or self.status is None:
            return None
        self.pid = None
        return self.status

    def send(self, number):
        if self.pid is not None:
            self.signals.append(number)
            if number == signal.SIGKILL:
                self.status = -9

    def end(self, _timeout_s):
        self.pid = None


class SupervisedFace:
    """A supervisor with both children simulated, and three servos in memory with torque on."""

    def __init__(self, path, record=None, capabilities=CAPABILITIES):
        self.servos = MemoryFace(3)
        self.clock = self.servos.clock
        self.bridge = SimulatedChild("bridge", self.clock, HeartbeatTimeouts(30.0, 1.0))
        self.speech = SimulatedChild("speech", self.clock, HeartbeatTimeouts(60.0, 3.0))
        self.control = ControlSocket(path)
        self.path = path
        self.unplugged, self.capabilities, self.told_kept = False, capabilities, []
        self.supervisor = Supervisor(
            self.bridge,
            self.speech,
            self.control,
            SupervisedServos(dict.fromkeys(NAMES.values(), capabilities), self._release),
            notice=ServiceNotice(self.clock.now),
            record=record,
            tell_kept=self.told_kept.append,
        )
        self.n_signals = 0
        self.hold()

    def _release(self, timeout_s):
        now_s = self.clock.now
        return FaceRelease(
            [(TorqueRelease(self._open, list(NAMES), timeout_s=timeout_s, now_s=now_s), NAMES)]
        )

    def _open(self):
        if self.unplugged:
            raise PortError("/dev/x: no such port")
        if not self.capabilities.confirmed_limp:
            return PulsePort()
        return LineRelease(self.servos.open(), [BAUD_RATE])

    def hold(self):
        for servo in self.servos.chain.servos:
            servo["torque_enable"] = 1

    @property
    def torque(self):
        return [servo["torque_enable"] for servo in self.servos.chain.servos]

    def play(self, seconds=3 * ROUND_S):
        """Let the loop go round for so long, or to the end of the face; its report."""
        end_s = self.clock.now() + seconds
        while self.clock.now() < end_s:
            self.clock.advance(ROUND_S)
            report = self.supervisor.step(self.clock.now(), self.n_signals, "SIGTERM")
            if report is not None:
                return report
        return None

    @property
    def exit_status(self):
        """Of a face that has ended."""
        assert self.supervisor.report is not None
        return self.supervisor.exit_status

    def connect(self):
        client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        client.settimeout(10.0)
        client.connect(str(self.path))
        return client

    def ask_to_stop(self, word):
        client = self.connect()
        client.send(word.encode())
        return client
