"""Every state of a supervisor x every event, by what was asked for: processes and servos then.

The grid is the machine, told a second time by hand. In a cell: the new state, and what is done:
start (a bridge), kill (it), off (torque goes off), held (who has torque keeps it), told (whoever
asked is told the end), why (it waits, and says why), ready, up (systemd knows). A dot: the event
means nothing; x: nothing can cause it. Behind an event stands what had been asked for when it came,
or that it comes at the very first start. A face that is let go once more says `stopped` meanwhile.
"""

import contextlib
import signal
import socket

import pytest
from simulated_supervisor import SupervisedFace
from state_grid import CANNOT_COME, NOTHING, differences, grid

from firmware_bridge.process.lifeline import Ready, Stopped
from firmware_bridge.process.stop_record import StopRecord
from firmware_bridge.process.supervisor_table import SUPERVISOR_TABLE, Phase, SupervisorEvent
from firmware_bridge.stopping import StopLevel, StopRequest

GRID = grid("""
                        | waiting         | starting          | returning       | running         | releasing        | giving up      | stopped          | over
due                     | starting, start | x                 | x               | x               | x                | x              | x                | .
due, frozen             | starting, start | x                 | x               | x               | x                | x              | x                | x
due, stopped            | releasing, off  | x                 | x               | x               | x                | x              | x                | x
ready                   | .               | running, ready    | running         | running         | .                | .              | .                | .
bridge ended            | x               | over              | over            | over            | x                | x              | x                | x
bridge ended, stopped   | x               | stopped, told, up | stopped, told   | stopped, told   | x                | x              | x                | x
bridge ended, ending    | x               | over              | over            | over            | x                | x              | x                | x
bridge died             | x               | releasing, off    | releasing, off  | releasing, off  | x                | x              | x                | x
bridge died, frozen     | x               | waiting, held     | waiting, held   | waiting, held   | x                | x              | x                | x
bridge died, stopped    | x               | releasing, off    | releasing, off  | releasing, off  | x                | x              | x                | x
bridge failed           | x               | giving up, off    | releasing, off, why | releasing, off  | x                | x              | x                | x
bridge failed, later    | x               | releasing, off    | x               | x               | x                | x              | x                | x
bridge failed, frozen   | x               | waiting, held     | releasing, off, why | waiting, held   | x                | x              | x                | x
bridge failed, stopped  | x               | releasing, off    | releasing, off  | releasing, off  | x                | x              | x                | x
bridge gave up          | x               | giving up, off    | releasing, off, why | giving up, off  | x                | x              | x                | x
bridge gave up, frozen  | x               | giving up, off    | releasing, off, why | giving up, off  | x                | x              | x                | x
bridge gave up, stopped | x               | releasing, off    | releasing, off  | releasing, off  | x                | x              | x                | x
released                | x               | x                 | x               | x               | waiting          | over           | x                | x
released, stopped       | x               | x                 | x               | x               | stopped, told    | x              | x                | x
released, ending        | x               | x                 | x               | x               | over             | over           | x                | x
port stuck              | x               | x                 | x               | x               | .                | over           | x                | x
port stuck, first       | x               | x                 | x               | x               | over             | x              | x                | x
port stuck, unready     | x               | x                 | x               | x               | stopped, told, up| x              | x                | x
port stuck, stopped     | x               | x                 | x               | x               | .                | x              | x                | x
port stuck, ending      | x               | x                 | x               | x               | over             | over           | x                | x
freeze                  | .               | starting, kill    | returning, kill | running, kill   | waiting, held    | .              | .                | x
freeze, stopped         | x               | starting, kill    | returning, kill | running, kill   | .                | x              | .                | x
stop                    | releasing, off  | starting, kill    | returning, kill | running, kill   | .                | releasing, off | stopped, off, told | x
stop, frozen            | releasing, off  | starting, kill    | returning, kill | running, kill   | x                | releasing, off | x                | x
stop and end            | releasing, off  | starting, kill    | returning, kill | running, kill   | .                | releasing, off | over             | x
signal                  | releasing, off  | .                 | .               | .               | .                | .              | over             | .
signal, frozen          | releasing, off  | .                 | .               | .               | x                | .              | x                | x
start                   | .               | .                 | .               | .               | .                | .              | returning, start | x
start, kept             | x               | x                 | x               | x               | returning, start | x              | returning, start | x
again, unconfirmed      | x               | x                 | x               | x               | x                | x              | stopped, off, told | x
""")  # noqa: E501 - a table
#: What a bridge that heard of it had told.
ASKED = {
    "": (),
    "frozen": (Stopped(StopLevel.FREEZE),),
    "stopped": (Stopped(StopLevel.SOFT),),
    "ending": (Stopped(StopLevel.SOFT, ends=True),),
    "later": (),
    "kept": (),
    "first": (),
    "unready": (Stopped(StopLevel.SOFT),),
    "unconfirmed": (),
}
DEATHS = {"bridge ended": 0, "bridge died": -11, "bridge failed": 1, "bridge gave up": 4}
WORDS = {"freeze": "freeze", "stop": "soft", "stop and end": "limp end", "start": "start"}


def word(phase):
    return phase.name.lower().replace("_", " ")


class Watched(SupervisedFace):
    """A face whose phase, children and servos are looked at before and after an event."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.clients, self.ends = (), []
        self.control.report_end = self.ends.append

    @property
    def phase(self):
        words = self.supervisor.status()["state"]
        if self.supervisor.report is not None:
            return "over" if words in ("ended", "stopped") else f"over, but {words}"
        if words == "ended":
            return "over, and nobody knows"
        return next(word(each) for each in Phase if each.value == words)

    def until(self, phase):
        for _ in range(1000):
            if self.phase == phase:
                return
            self.step()
        raise AssertionError(f"{self.phase}, not {phase}")

    def step(self):
        self.play(0.04)

    def say(self, *messages):
        self.bridge.said += messages
        self.step()

    def ask(self, word):
        self.clients = (*self.clients, self.ask_to_stop(word))

    def while_in(self, phase):
        for _ in range(1000):
            self.step()
            if self.phase != phase:
                return

    def close(self):
        for each in self.clients:
            each.close()

    def hear_nobody(self):
        """A bridge that serves no requests: it has just begun, or hangs."""
        self.bridge.beats, self.bridge.beat_s = False, None
        self.bridge.send = self.bridge.signals.append  # killed, it takes a while to be gone


def stop_and_confirm(face):
    face.say(Stopped(StopLevel.SOFT))
    for servo in face.servos.chain.servos:
        servo["torque_enable"] = 0
    face.bridge.status = 0
    face.until("stopped")


def bring(face, phase, asked):
    """Into a phase, as it is come to."""
    said = ASKED[asked]
    if phase == "waiting" and asked == "stopped":
        return  # by an earlier process
    face.step()
    if asked == "later" or not (phase == "starting" or asked in ("first", "unready")):
        face.say(Ready())
    if asked == "later":
        face.bridge.status = -9
        face.until("releasing")
        face.until("starting")
    if phase == "waiting":
        for n in range(5):  # so often that it waits for a while
            face.say(*said)
            face.bridge.status = -9
            face.step()
            face.until("waiting")
            if n < 4:
                face.until("starting")
        return
    if phase in ("returning", "stopped", "over") and asked != "unconfirmed":
        stop_and_confirm(face)
        if phase == "returning":
            face.ask("start")
        elif phase == "over":
            face.n_signals = 1
        face.until(phase)
    if asked == "unconfirmed" or (phase, asked) == ("releasing", "kept"):
        deaf_s = 6.0 if asked == "unconfirmed" else 12.0
        face.servos.chain.servos[1].ignore_until(face.clock.now() + deaf_s)
        face.say(Stopped(StopLevel.LIMP))
        face.bridge.status = -9
        face.play(5.0 if phase == "stopped" else 11.0)
        return
    is_last = phase == "giving up" and asked == "ending"  # then a signal comes
    if said and not is_last:
        face.say(*said)
    if phase in ("releasing", "giving up"):
        face.bridge.status = 4 if phase == "giving up" else -9
        face.until(phase)
    if is_last:
        face.n_signals = 1


def cause(face, phase, event, asked):
    """Let an event come, as it comes; the last round is the one in which it has."""
    if event in DEATHS:
        face.bridge.status = DEATHS[event]
    elif event == "ready":
        face.bridge.said.append(Ready())
    elif event == "signal":
        face.n_signals += 1
    elif event in WORDS:
        if phase in ("starting", "returning", "running"):
            face.hear_nobody()
        face.ask(WORDS[event])
    elif event == "port stuck":
        face.unplugged = True
        face.n_signals = int(asked == "ending" or face.n_signals)
    if event == "again":
        face.play(20.0)
    elif event in ("due", "released", "port stuck"):
        face.while_in(phase)
    else:
        face.step()


@pytest.fixture
def systemd(tmp_path, monkeypatch):
    """What it was told since it was asked last."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notices:
        notices.bind(str(tmp_path / "notify"))
        notices.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))

        def told():
            lines = []
            with contextlib.suppress(BlockingIOError):
                while True:
                    lines.append(notices.recv(100).decode())
            return lines

        yield told


def test_the_grid_and_the_table_have_the_same_cells():
    by_event = {}
    for (phase, event), cell in GRID.items():
        key = phase, event.partition(", ")[0].replace("stop and end", "stop")
        by_event.setdefault(key, []).append(cell)
    merged = {
        key: next((each for each in cells if each not in (NOTHING, CANNOT_COME)), NOTHING)
        for key, cells in by_event.items()
    }
    assert differences(SUPERVISOR_TABLE, merged, Phase, SupervisorEvent, word) == []


@pytest.mark.parametrize(("state", "event"), GRID)
def test_in_every_phase_an_event_does_what_the_grid_says_and_no_more(
    state, event, tmp_path, systemd
):
    cell = GRID[state, event]
    if cell == CANNOT_COME:
        return
    name, _, asked = event.partition(", ")
    record = None
    if (state, asked) == ("waiting", "stopped"):
        record = StopRecord(tmp_path / "stop.json")
        record.stopped = StopRequest(StopLevel.LIMP, "a test")
    face = Watched(tmp_path / "face.sock", record)
    with face.control:
        bring(face, state, asked)
        assert face.phase == state or asked == "kept"
        if state != "over":
            face.hold()
        systemd()
        n_starts, face.bridge.signals[:] = len(face.bridge.starts), []
        face.ends.clear()
        cause(face, state, name, asked)
        then, *does = (
            [face.phase if asked == "kept" else state] if cell == NOTHING else cell.split(", ")
        )

        assert face.phase == then
        assert len(face.bridge.starts) - n_starts == does.count("start")
        assert face.bridge.signals.count(signal.SIGKILL) == does.count("kill")
        if "off" not in does:
            assert len(face.ends) == does.count("told")
        assert ("READY=1" in systemd()) == bool({"ready", "up"} & set(does))
        if "held" in does or "start" in does:
            assert face.torque == [1, 1, 1]
        if "off" in does:
            face.play(1.0)
            assert face.torque == [0, 0, 0]
        if "told" in does:
            assert len(face.ends) == 1
        if "why" in does:
            assert face.phase == "stopped"
            assert "could not be started" in face.supervisor.status()["troubles"][0]
        if then == "waiting" and state != then:  # a bridge comes again
            face.play(6.0)
            assert len(face.bridge.starts) == n_starts + 1
    face.close()
