"""What the supervisor decides, step by step: processes and clock are played, servos simulated."""

import json
import signal
import socket

import pytest
from dynamixel_chain import MemoryFace

from firmware_bridge.bus import PortError
from firmware_bridge.process.child import HeartbeatMonitor, HeartbeatTimeouts
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.lifeline import Began, Failed, Ready, Stopped
from firmware_bridge.process.restarted_child import RestartDelay
from firmware_bridge.process.service_notice import ServiceNotice
from firmware_bridge.process.supervisor import Supervisor
from firmware_bridge.process.torque_release import TorqueRelease
from firmware_bridge.stopping import StopLevel

#: A round of the loop, as long as it waits at most.
ROUND_S = 0.05


class PlayedChild:
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


class Rehearsal:
    """A supervisor with both children played, and three servos in memory with torque on."""

    def __init__(self, path):
        self.servos = MemoryFace(3)
        self.clock = self.servos.clock
        self.bridge = PlayedChild("bridge", self.clock, HeartbeatTimeouts(30.0, 1.0))
        self.speech = PlayedChild("speech", self.clock, HeartbeatTimeouts(60.0, 3.0))
        self.control = ControlSocket.bind(path)
        self.path, self.said = path, []
        self.unplugged = False
        self.supervisor = Supervisor(
            self.bridge,
            self.speech,
            self.control,
            lambda timeout_s: TorqueRelease(
                self._open, [1, 2, 3], timeout_s=timeout_s, now_s=self.clock.now
            ),
            servo_names={1: "jaw", 2: "left", 3: "right"},
            say=self.said.append,
            notice=ServiceNotice(self.said.append, self.clock.now),
        )
        self.n_signals = 0
        self.hold()

    def _open(self):
        if self.unplugged:
            raise PortError("/dev/x: no such port")
        return self.servos.open()

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

    def ask_to_stop(self, word):
        client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        client.connect(str(self.path))
        client.send(word.encode())
        return client


@pytest.fixture
def starting_face(tmp_path):
    """Nothing was heard of its bridge yet."""
    rehearsal = Rehearsal(tmp_path / "face.sock")
    with rehearsal.control:
        yield rehearsal


@pytest.fixture
def face(starting_face):
    """A face that runs well."""
    starting_face.play()
    starting_face.bridge.said.append(Ready())
    starting_face.play()
    return starting_face


def test_a_bridge_that_gives_signs_of_life_is_left_alone(face):
    face.play(20.0)

    assert face.bridge.signals == []
    assert face.torque == [1, 1, 1]


def test_a_hung_bridge_is_killed_after_a_second_its_servos_let_go_and_a_new_one_started(face):
    face.bridge.beats = False
    face.play(0.9)
    assert face.bridge.signals == []
    face.play(0.3)
    assert face.bridge.signals == [signal.SIGKILL]
    face.bridge.beats = True
    face.play(1.0)

    assert face.torque == [0, 0, 0]
    assert len(face.bridge.starts) == 2
    assert any("hangs" in line for line in face.said)


def test_a_starting_bridge_may_be_silent_for_half_a_minute(starting_face):
    face = starting_face
    face.bridge.beats = False
    face.play(29.8)
    assert face.bridge.signals == []
    face.play(0.4)
    assert face.bridge.signals == [signal.SIGKILL]


def test_a_supervisor_that_was_stopped_itself_blames_nobody(face):
    """Both were stopped for a minute, as by `kill -STOP`; the bridge beats again a moment later."""
    face.bridge.beats = False
    face.clock.advance(60.0)
    face.play(0.9)
    face.bridge.beats = True
    face.play(2.0)

    assert face.bridge.signals == []


def test_a_dead_bridge_is_limp_within_a_round_and_restarts_wait_longer_each_time(face):
    face.bridge.status = -11
    face.play(ROUND_S)
    for _ in range(30):  # steps without time: nothing here waits
        face.supervisor.step(face.clock.now())
    assert face.torque == [0, 0, 0]

    delay = RestartDelay()
    assert [round(delay.after(1.0), 1) for _ in range(6)] == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0]
    assert delay.after(11.0) == 0.2  # it had started well


@pytest.mark.parametrize("level", [StopLevel.SOFT, StopLevel.LIMP])
def test_a_stop_outlives_the_bridge_that_heard_it_and_the_plug(face, level):
    """Issue: stopped while unplugged, the bridge died, was started, and held torque again."""
    face.unplugged = True
    face.bridge.said.append(Stopped(level))
    face.bridge.status = 1
    assert face.play(600.0) is None
    assert ask_waits(face)["stopped"] == level.value
    face.unplugged = False
    report = face.play(1.0)

    assert report.as_dict() == {
        "exit_status": 0,
        "confirmed": ["jaw", "left", "right"],
        "unconfirmed": {},
    }
    assert face.torque == [0, 0, 0]
    assert len(face.bridge.starts) == 1


def ask_waits(face):
    """What is answered while no bridge runs."""
    client = face.ask_to_stop("status")
    face.play()
    answer = client.recv(10_000)
    client.close()
    return json.loads(answer)


def test_a_stop_while_no_bridge_runs_is_answered_held_and_reported(face):
    face.unplugged = True
    face.bridge.status = -9
    face.play(5.0)
    client = face.ask_to_stop("soft")
    face.play(30.0)
    face.unplugged = False
    report = face.play(1.0)
    face.control.report_end(report.as_dict())

    assert b'"accepted": "soft"' in client.recv(10_000)
    assert b'"confirmed": ["jaw", "left", "right"]' in client.recv(10_000)
    assert report.status == 0
    assert len(face.bridge.starts) == 1
    client.close()


def test_a_stop_while_the_bridge_starts_kills_it_before_it_arms(starting_face):
    face = starting_face
    face.bridge.beats = False
    face.play()
    client = face.ask_to_stop("limp")
    report = face.play(2.0)

    assert face.bridge.signals == [signal.SIGKILL]
    assert report.status == 0
    assert face.torque == [0, 0, 0]
    client.close()


def test_a_frozen_face_stays_held_when_its_bridge_dies_and_the_next_one_knows(face):
    face.bridge.said.append(Stopped(StopLevel.FREEZE))
    face.bridge.status = -9
    face.play(1.0)

    assert face.torque == [1, 1, 1]
    assert face.bridge.starts == [[], ["--stopped", "freeze"]]


def test_freezing_while_no_bridge_runs_starts_one_that_holds(face):
    face.unplugged = True
    face.bridge.status = -9
    face.play(1.0)
    face.ask_to_stop("freeze").close()
    face.play(1.0)

    assert face.torque == [1, 1, 1]
    assert face.bridge.starts[-1] == ["--stopped", "freeze"]


def test_servos_given_up_for_good_are_told_to_the_next_bridge(face):
    face.bridge.said.append(Failed(2, "does not follow: jammed = stuck"))
    face.bridge.status = -9
    face.play(1.0)

    assert face.bridge.starts[-1] == ["--failed", "2=does not follow: jammed = stuck"]


def test_speech_that_dies_goes_on_where_its_sound_is_and_one_that_hangs_is_killed(face):
    face.speech.said.append(Began(12.25))
    face.speech.status = -9
    face.play(1.0)
    assert face.speech.starts == [[], ["--zero-s", "12.25"]]
    face.speech.beats = False
    face.play(2.9)
    assert face.speech.signals == []
    face.play(1.0)

    assert face.speech.signals == [signal.SIGKILL]
    assert face.bridge.signals == []


def test_a_failed_critical_servo_ends_the_face_limp_with_status_4(face):
    face.bridge.status = 4
    report = face.play(1.0)

    assert report.status == 4
    assert face.torque == [0, 0, 0]
    assert len(face.bridge.starts) == 1


@pytest.mark.parametrize(
    ("status", "unplugged"), [(1, False), (1, True), (-9, True)], ids=["YAML", "port", "killed"]
)
def test_a_bridge_that_fails_at_its_first_start_ends_the_face(starting_face, status, unplugged):
    face = starting_face
    face.unplugged = unplugged
    face.play()
    face.bridge.status = status
    report = face.play(5.0)

    assert report.status == 1
    assert bool(report.unconfirmed) == unplugged


def test_a_bridge_that_took_long_to_load_and_then_failed_has_not_run_well(starting_face):
    face = starting_face
    face.unplugged = True
    face.bridge.beats = False
    face.play(20.0)
    face.bridge.status = 1

    assert face.play(5.0).status == 1


def test_a_bridge_that_beat_for_long_but_never_drove_its_servos_has_not_run_well(starting_face):
    """On a busy machine refusing servos may take longer than any start should."""
    face = starting_face
    face.play(20.0)
    face.bridge.status = 1

    assert face.play(5.0).status == 1
    assert len(face.bridge.starts) == 1


def test_the_first_signal_asks_both_the_second_again(face):
    face.n_signals = 1
    face.play()
    assert face.bridge.signals == [signal.SIGTERM]
    assert face.speech.signals == [signal.SIGTERM]
    face.n_signals = 2
    face.play()
    assert face.bridge.signals == [signal.SIGTERM, signal.SIGTERM]
    face.bridge.status = 0

    assert face.play(1.0).status == 0


def test_a_bridge_that_does_not_end_is_killed_after_five_seconds_and_let_go_by_force(face):
    face.n_signals = 1
    face.play(4.9)
    assert signal.SIGKILL not in face.bridge.signals
    report = face.play(2.0)

    assert signal.SIGKILL in face.bridge.signals
    assert report.status == 0
    assert face.torque == [0, 0, 0]


@pytest.mark.parametrize(("n_signals", "seconds"), [(1, 31.0), (2, 1.0)])
def test_the_end_by_signal_waits_for_a_lost_port_but_not_for_ever(face, n_signals, seconds):
    face.unplugged = True
    face.n_signals = 1
    face.bridge.status = 3
    assert face.play(0.5) is None
    face.n_signals = n_signals
    report = face.play(seconds)

    assert report.status == 3
    assert report.unconfirmed == dict.fromkeys(["jaw", "left", "right"], "/dev/x: no such port")


def test_a_silent_servo_is_named_and_the_status_says_it(face):
    face.servos.chain.servos[1].deaf_until_s = float("inf")
    face.bridge.said.append(Stopped(StopLevel.LIMP))
    face.bridge.status = -9
    report = face.play(20.0)

    assert report.status == 3
    assert report.confirmed == ("jaw", "right")
    assert report.unconfirmed == {"left": "did not answer"}


@pytest.fixture
def systemd(tmp_path, monkeypatch):
    """What systemd hears."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield listener


def heard_in(seconds, systemd, face):
    """What systemd hears in so many seconds, second by second: few messages may wait."""
    said = []
    for _ in range(seconds):
        face.play(1.0)
        try:
            while True:
                said.append(systemd.recv(100).decode())
        except BlockingIOError:
            pass
    return said


def test_systemd_hears_that_the_face_is_ready_and_lives(systemd, face):
    assert heard_in(4, systemd, face)[:3] == ["READY=1", "WATCHDOG=1", "WATCHDOG=1"]


def test_systemd_hears_nothing_of_a_bridge_that_can_neither_be_killed_nor_replaced(systemd, face):
    """But a recovery has a minute, and a lost port all the time in the world."""
    face.bridge.beats, face.bridge.send = False, lambda _number: None
    assert len(heard_in(65, systemd, face)) > 50
    assert heard_in(20, systemd, face) == []
    face.unplugged, face.bridge.status = True, -9

    assert len(heard_in(100, systemd, face)) > 80


@pytest.mark.parametrize("address", ["/nonexistent/notify", "@gone", "x" * 200])
def test_a_stale_notify_socket_is_said_once_and_kills_nobody(monkeypatch, address):
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    said, now_s = [], [0.0]
    notice = ServiceNotice(said.append, lambda: now_s[0])
    notice.ready()
    for _ in range(5):
        now_s[0] += 2.0
        notice.alive()

    assert len(said) == 1
    assert address in said[0]
