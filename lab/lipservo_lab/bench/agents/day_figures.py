"""`lipservo bench day`: an agent and a face on real processes, and all that a day brings.

A daemon with the shipped face plays into a PulseAudio sink without hardware; an agent
(`day_agent.py`) takes turns through a cable that can be pulled. Meanwhile the computer is loaded,
both are restarted, and the face is stopped and started.
"""

import contextlib
import json
import os
import random
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from firmware_bridge.process.control_client import ask, start_face
from lipservo_lab.bench.agents.cable import Cable
from lipservo_lab.own_processes import end, started, started_alone
from lipsync.errors import UserError

_PERIOD_S: Final = 12.0
#: So often in twelve minutes: what happens to whom.
EVENTS: Final = {
    "load": 6,
    "daemon restart": 4,
    "cable pulled": 4,
    "stop and start": 3,
    "agent restart": 2,
}
_LOAD_S, _PULLED_S, _STOPPED_S, _GONE_S = 10.0, 15.0, 5.0, 3.0
#: A face that is back has this long until every turn must move its lips.
_GRACE_S: Final = 10.0
#: Memory and threads are counted from so long after a process began.
_WARM_S: Final = 45.0
_LOOK_S: Final = 0.25
_PATIENCE_S: Final = 90.0
_ALSA: Final = (
    "</usr/share/alsa/alsa.conf>\npcm.!default { type pulse }\nctl.!default { type pulse }\n"
)


@dataclass(slots=True)
class _ProcessLife:
    """Memory and threads of a process, sampled while it lives.

    seen: (seconds since the process began, resident MB, number of threads).
    """

    pid: int
    began_s: float = field(default_factory=time.monotonic)
    seen: list[tuple[float, float, int]] = field(default_factory=list)

    def look(self) -> None:
        with contextlib.suppress(OSError, IndexError, ValueError):
            pages = int(Path(f"/proc/{self.pid}/statm").read_text().split()[1])
            n_threads = len(os.listdir(f"/proc/{self.pid}/task"))
            rss_mb = 1e-6 * pages * os.sysconf("SC_PAGE_SIZE")
            self.seen.append((time.monotonic() - self.began_s, rss_mb, n_threads))

    def growth(self) -> tuple[float, float, int]:
        """Return seconds from first to last sample, and how memory (MB) and threads grew meanwhile.

        Only samples from `_WARM_S` after the process's start on count; zeros if there are none.
        """
        warm = [each for each in self.seen if each[0] >= _WARM_S]
        if not warm:
            return 0.0, 0.0, 0
        return warm[-1][0] - warm[0][0], warm[-1][1] - warm[0][1], warm[-1][2] - warm[0][2]


def day_figures(
    minutes: float, events: Mapping[str, int], progress: Callable[[int, int], None]
) -> dict[str, Any]:
    """Run an agent and a face for `minutes`; return figures of what went wrong.

    `mute_turns`: turns that did not move the mouth, though no event excuses that; `rss_growth_mb`,
    `threads_growth`: of the process that grew most; `gone_noticed_s`: the longest time until the
    agent noticed a pulled cable, None if none was pulled or one went unnoticed.

    events: how often each of `EVENTS` happens. progress: called with events begun and all events.
    Raises UserError where PulseAudio is missing or does not start.
    """
    with (
        tempfile.TemporaryDirectory(prefix="lipservo-day-") as folder,
        _pulseaudio_sink(Path(folder)) as environment,
        _Day(Path(folder), environment) as day,
    ):
        return day.run(minutes, events, progress)


class _Day:
    """The daemon and the agent of a day, the cable between them, and what was observed of them."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self._folder = folder
        self._environment = environment
        self._control = folder / "face.sock"
        self._token = folder / "token"
        self._token.write_text(secrets.token_hex(16) + "\n")
        self._token.chmod(0o600)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = probe.getsockname()[1]
        self._cable = Cable(self._port)
        self._turns: list[dict[str, float]] = []
        #: Monotonic seconds at which the agent told an error, and at which its cable was pulled.
        self._errors: list[float] = []
        self._pulled: list[float] = []
        #: (monotonic seconds, phonemes that moved the mouth, state) of the face that runs then.
        self._statuses: list[tuple[float, int, str]] = []
        #: From when to when a turn may be mute.
        self._excused: list[tuple[float, float]] = []
        self._lives: dict[str, list[_ProcessLife]] = {"daemon": [], "agent": []}
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._is_over = threading.Event()
        self._watcher = threading.Thread(target=self._sample_until_over, daemon=True)

    def __enter__(self) -> "_Day":
        self._cable.__enter__()
        self._start_process("daemon")
        self._start_process("agent")
        self._watcher.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._is_over.set()
        self._watcher.join()
        for name in ("agent", "daemon"):
            self._end_process(name)
        self._cable.__exit__()

    def run(
        self, minutes: float, events: Mapping[str, int], progress: Callable[[int, int], None]
    ) -> dict[str, Any]:
        """Play all events in a fixed random order, spread evenly over `minutes`; return figures."""
        self._wait_for_face()
        began_s = time.monotonic()
        self._excused.append((0.0, began_s + _GRACE_S))
        event_order = [name for name, n in events.items() for _ in range(n)]
        random.Random(1).shuffle(event_order)
        gap_s = 60.0 * minutes / (len(event_order) + 1)
        for number, name in enumerate(event_order, 1):
            progress(number, len(event_order))
            time.sleep(max(0.0, began_s + number * gap_s - time.monotonic()))
            self._play_event(name)
        time.sleep(max(0.0, began_s + 60.0 * minutes - time.monotonic()))
        self._is_over.set()
        self._watcher.join()
        lives = [each for every in self._lives.values() for each in every]
        growth = {name: max(each.growth() for each in of) for name, of in self._lives.items()}
        return {
            "turns": len(self._turns),
            "mute_turns": sum(self._is_mute(turn) for turn in self._turns),
            "hung_turns": sum("hung" in turn for turn in self._turns),
            "rss_growth_mb": round(max(each[1] for each in growth.values()), 2),
            "threads_growth": max(each[2] for each in growth.values()),
            "watched_s": {name: round(each[0], 1) for name, each in growth.items()},
            "processes": len(lives),
            "gone_noticed_s": self._gone_noticed_s(),
            **{name.replace(" ", "_"): n for name, n in events.items()},
        }

    def _is_mute(self, turn: dict[str, float]) -> bool:
        """Return whether a turn did not move the lips, though no event excuses that.

        Mute is also a turn whose sound bypassed the face, or during which no status was received.
        """
        began_s, ended_s = turn["began_s"], turn["ended_s"]
        if any(from_s <= ended_s and began_s <= to_s for from_s, to_s in self._excused):
            return False
        # How many phonemes had moved the mouth, in each status received during the turn.
        counts = [n for at_s, n, _ in self._statuses if began_s <= at_s <= ended_s + 1.0]
        return turn["transport_s"] > 0.0 or not counts or counts[-1] <= counts[0]

    def _gone_noticed_s(self) -> float | None:
        """Return the longest time from a pulled cable to the agent's next error, s.

        None: no cable was pulled, or one was plugged in again before the agent reported an error.
        """
        delays_s = []
        for pulled_s in self._pulled:
            errors_after_s = [at_s - pulled_s for at_s in self._errors if at_s >= pulled_s]
            if not errors_after_s or min(errors_after_s) > _PULLED_S:
                return None
            delays_s.append(min(errors_after_s))
        return round(max(delays_s), 2) if delays_s else None

    def _play_event(self, name: str) -> None:
        """Do one of `EVENTS`, wait for the face, and note in which time turns may have been mute.

        Blocks for the event's whole duration.
        """
        from_s = time.monotonic()
        if name == "load":
            with ExitStack() as burning:
                for _ in "four":
                    burning.enter_context(started([sys.executable, "-c", "while True: pass"]))
                time.sleep(_LOAD_S)
        elif name == "cable pulled":
            self._cable.pull()
            self._pulled.append(from_s)
            time.sleep(_PULLED_S)
            self._cable.plug()
        elif name == "stop and start":
            ask(self._control, "soft", _PATIENCE_S)
            time.sleep(_STOPPED_S)
            start_face(self._control, _PATIENCE_S)
        else:
            process_name = name.split(" ", 1)[0]
            self._end_process(process_name)
            time.sleep(_GONE_S)
            self._start_process(process_name)
        self._wait_for_face()
        self._excused.append((from_s, time.monotonic() + _GRACE_S))

    def _wait_for_face(self) -> None:
        """Wait until the daemon listens and its face is driven or silent; UserError after 90 s."""
        give_up_s = time.monotonic() + _PATIENCE_S
        while time.monotonic() < give_up_s:
            with contextlib.suppress(OSError):
                status = ask(self._control, "status", _PATIENCE_S)
                if status.get("listens_on") and status.get("state") in ("driven", "silent"):
                    return
            time.sleep(_LOOK_S)
        raise UserError("bench day: the face does not drive its servos again")

    def _start_process(self, name: str) -> None:
        """Start the process "daemon" or "agent"; a thread of its own reads its standard output.

        The daemon listens behind the cable; the agent connects to the cable. Standard error is
        appended to NAME.log.
        """
        log = (self._folder / f"{name}.log").open("a")
        if name == "daemon":
            arguments = ["-m", "lipservo", "daemon", "--config", "face_sim", "--play", "--quiet"]
            arguments += ["--listen", f"127.0.0.1:{self._port}", "--token-file", str(self._token)]
            arguments += ["--control", str(self._control)]
        else:
            url = f"ws://127.0.0.1:{self._cable.port}"
            token = self._token.read_text().strip()
            arguments = ["-m", "lipservo_lab.bench.agents.day_agent", url, token, str(_PERIOD_S)]
        process = started_alone(
            [sys.executable, "-P", *arguments],
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
        log.close()
        self._processes[name] = process
        self._lives[name].append(_ProcessLife(process.pid))
        threading.Thread(target=self._collect_lines, args=(process,), daemon=True).start()

    def _end_process(self, name: str) -> None:
        end(self._processes[name], _PATIENCE_S)

    def _collect_lines(self, process: "subprocess.Popen[str]") -> None:
        """Collect the JSON lines that a process prints, errors and turns, until its output ends.

        Lines that are no JSON are dropped.
        """
        assert process.stdout is not None
        with process.stdout:
            for line in process.stdout:
                with contextlib.suppress(ValueError):
                    row = json.loads(line)
                    if "error_s" in row:
                        self._errors.append(row["error_s"])
                    else:
                        self._turns.append(row)

    def _sample_until_over(self) -> None:
        """Sample memory and threads of both processes and the face's status until the day ends."""
        while not self._is_over.wait(_LOOK_S):
            for lives in self._lives.values():
                lives[-1].look()
            with contextlib.suppress(OSError):
                status = ask(self._control, "status", _LOOK_S)
                seen = int(status.get("n_phonemes") or 0), str(status.get("state"))
                self._statuses.append((time.monotonic(), *seen))


@contextlib.contextmanager
def _pulseaudio_sink(folder: Path) -> Iterator[dict[str, str]]:
    """Run a PulseAudio server whose only sink has no sound card; yield the environment to use it.

    Raises UserError where PulseAudio is not installed or does not start.
    """
    (folder / "asound.conf").write_text(_ALSA)
    address = folder / "native"
    (folder / "server.pa").write_text(
        f"load-module module-native-protocol-unix socket={address} auth-anonymous=1\n"
        "load-module module-null-sink sink_name=speaker rate=48000\nset-default-sink speaker\n"
    )
    environment = {
        **os.environ,
        "XDG_RUNTIME_DIR": str(folder),
        "PULSE_SERVER": f"unix:{address}",
        "PULSE_COOKIE": str(folder / "cookie"),
        "ALSA_CONFIG_PATH": str(folder / "asound.conf"),
        "LIPSERVO_STATE": str(folder / "state"),
    }
    command = ["pulseaudio", "-n", "-F", str(folder / "server.pa"), "--daemonize=no"]
    command += ["--exit-idle-time=-1", "--disable-shm=yes", "--use-pid-file=no", "--realtime=no"]
    if shutil.which(command[0]) is None:
        raise UserError("bench day needs pulseaudio: apt install pulseaudio")
    # The server itself must not look for another server, nor read the user's settings.
    quiet, own = subprocess.DEVNULL, {**environment, "PULSE_SERVER": "", "HOME": str(folder)}
    with started(command, env=own, stdout=quiet, stderr=quiet) as server:
        give_up_s = time.monotonic() + _PATIENCE_S
        while not address.exists():
            if server.poll() is not None or time.monotonic() > give_up_s:
                raise UserError("bench day: pulseaudio does not start")
            time.sleep(_LOOK_S)
        yield environment
