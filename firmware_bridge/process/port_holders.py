"""Find the processes that hold a serial port or a face's socket, from /proc; end hung ones.

Holding a port is to have its file open and locked, as every kind of bus does; a simulator at the
other end does not.
"""

import contextlib
import os
import signal
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

_PROC: Final = Path("/proc")
#: Ends what hangs: nobody here handles it, and the unit tells systemd that it is a person's stop,
#: after which nothing is started again.
END_OF_HUNG: Final = getattr(signal, "SIGUSR2", signal.SIGTERM)  # Windows has no SIGUSR2
#: A process dies in some milliseconds, unless a driver holds it.
_DEATH_S: Final = 0.5
_LOOK_S: Final = 0.01
#: In the command line of the guard of an OE pin.
_PIN_GUARD: Final = b"firmware_bridge.pca9685.oe_guard"


def ports_held_by(pid: int) -> list[str]:
    """Return the device files under /dev that a process has locked; empty if access is denied."""
    return [to for to, info in _links(pid) if to.startswith("/dev/") and _is_locked(info)]


def holders_of(port: str) -> list[int]:
    """Return the ids of processes that have locked a port, among those that we may inspect."""
    real = os.path.realpath(port)
    return [pid for pid in _processes() if real in ports_held_by(pid)]


def holders_of_socket(path: Path) -> list[int]:
    """Return the ids of processes that have the Unix socket at `path` open, if we may inspect."""
    lines = (_PROC / "net" / "unix").read_text().splitlines()
    rows = [line.split(maxsplit=7) for line in lines]
    wanted = {f"socket:[{row[6]}]" for row in rows if len(row) == 8 and row[7] == str(path)}
    return [pid for pid in _processes() if any(target in wanted for target, _ in _links(pid))]


def is_ours(pid: int) -> bool:
    """Return whether a process is another lipservo that we may end: our user's, or any for root.

    False for this process itself, and for one that has ended.
    """
    if pid == os.getpid():
        return False
    try:
        owner = (_PROC / str(pid)).stat().st_uid
    except OSError:
        return False
    return os.geteuid() in (0, owner) and b"lipservo" in _command_line(pid)


def _command_line(pid: int) -> bytes:
    try:
        return (_PROC / str(pid) / "cmdline").read_bytes()
    except OSError:
        return b""


def supervisor_of(pid: int) -> int | None:
    """Return the id of the supervisor that would restart the bridge process `pid`; None: none.

    Proven by what no shell, terminal or script has: a bridge process, which drives servos, is given
    the listening control socket of its face as `--control FD`, and its supervisor has the same
    socket open.
    """
    parent = _parent(pid)
    if parent is None or not is_ours(parent):
        return None
    words = _command_line(pid).decode("utf-8", "replace").split("\0")
    try:
        # As `lipservo daemon` starts the process that owns the port.
        fd = words[words.index("--control") + 1] if "bridge-process" in words else ""
        control = os.readlink(_PROC / str(pid) / "fd" / fd) if fd.isdigit() else ""
    except (OSError, ValueError, IndexError):
        return None
    is_shared = control.startswith("socket:") and any(to == control for to, _ in _links(parent))
    return parent if is_shared else None


def with_children(pids: Iterable[int]) -> list[int]:
    """Return the ids in `pids` and those of the processes' children, without duplicates."""
    parents = dict.fromkeys(pids)
    return [*parents, *(each for each in _processes() if _parent(each) in parents)]


def end_hung(pids: list[int]) -> list[int]:
    """End hung processes by SIGUSR2, then SIGKILL; return the ids of those that still run.

    Guards of OE pins are left: once their face is dead they hold the pin, until the board is off.
    """
    pids = [pid for pid in pids if _PIN_GUARD not in _command_line(pid)]
    for number in (END_OF_HUNG, signal.SIGKILL):
        for pid in pids:
            with contextlib.suppress(OSError):
                os.kill(pid, number)
                os.kill(pid, signal.SIGCONT)  # a suspended process acts on it when it continues
        give_up_s = time.monotonic() + _DEATH_S
        while pids and time.monotonic() < give_up_s:
            pids = [pid for pid in pids if _is_running(pid)]
            time.sleep(_LOOK_S)
    return pids


def _processes() -> Iterator[int]:
    for entry in _PROC.iterdir():
        if entry.name.isdigit():
            yield int(entry.name)


def _links(pid: int) -> Iterator[tuple[str, Path]]:
    """Yield, for every descriptor of a process, the target of its link and its path in fdinfo."""
    folder = _PROC / str(pid)
    try:
        numbers = os.listdir(folder / "fd")
    except OSError:
        return
    for number in numbers:
        with contextlib.suppress(OSError):
            yield os.readlink(folder / "fd" / number), folder / "fdinfo" / number


def _is_locked(fdinfo: Path) -> bool:
    try:
        return "FLOCK" in fdinfo.read_text()
    except OSError:
        return False


def _stat(pid: int) -> list[str]:
    """Return the fields of /proc/PID/stat from the state on; [] without such a process.

    The name before them, in brackets, may contain any character.
    """
    try:
        return (_PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def _parent(pid: int) -> int | None:
    fields = _stat(pid)
    return int(fields[1]) if fields else None


def _is_running(pid: int) -> bool:
    fields = _stat(pid)
    return bool(fields) and fields[0] != "Z"
