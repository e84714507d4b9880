"""The guard of a port: a process that lets its servos go once all processes of the face are dead.

While the face lives the guard is a shell, blocked in a read, which costs 2 MB and no time. It reads
from a pipe, of which the face's processes hold the other end: a line says that the face ends in
order. Where the pipe ends without it, all of them are dead, and this module runs in its place.

It never holds the port while the face lives. A port that another face has taken is left alone.
"""

import contextlib
import errno
import json
import logging
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

from firmware_bridge.bus_kinds import PortRelease, Wiring, bus_kind
from firmware_bridge.errors import PortError
from firmware_bridge.process.logs import face_logs
from firmware_bridge.process.operating_system import run_on_time
from firmware_bridge.process.torque_release import FaceRelease, TorqueRelease
from firmware_bridge.stopping import PORT_WAIT_S, let_go_report

if TYPE_CHECKING:
    from firmware_bridge.bus_settings import BusSettings

_LOG: Final = logging.getLogger(__name__)
#: The guard's shell, started with the face: it ignores the signals that a terminal or systemd sends
#: to all processes, waits for a line or the pipe's end, and in the latter case runs the guard.
_WAIT: Final = 'trap "" HUP INT QUIT TERM; read -r _ || exec "$@"'
#: Silent servos are asked again for so long.
_SILENT_S: Final = 1.0
#: Errors of a port that another program has: of a tty, and of a URL.
_TAKEN: Final = (errno.EAGAIN, errno.EBUSY, errno.EADDRINUSE)
#: A dead holder's port may stay taken for so long; after that it is another program that has it.
_DYING_S: Final = 2.0
_END_S: Final = 1.0


@contextlib.contextmanager
def port_guard(face: str, settings: "BusSettings", servos: Mapping[int, str]) -> Iterator[int]:
    """Start the guard process of a face's port; end it with the `with` block.

    Yields the descriptor of a pipe that each process of the face that drives or supervises its
    servos must hold: the guard acts once all are closed. face: its name. settings: of the bus, with
    its port. servos: the servos' names, by address.
    """
    waits, alive = os.pipe()
    job = json.dumps({"face": face, "bus": settings.model_dump(), "servos": dict(servos)})
    guard = None
    with contextlib.suppress(OSError):
        guard = subprocess.Popen(
            ["/bin/sh", "-c", _WAIT, "lipservo-guard", sys.executable, "-P", "-m", __name__, job],
            stdin=waits,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )
    if guard is None:
        _LOG.warning("%s: no guard runs: if all its processes die, its servos hold", face)
    os.close(waits)
    try:
        yield alive
    finally:
        # The line tells the guard that the face ends in order: it ends without doing anything.
        with contextlib.suppress(BrokenPipeError):
            os.write(alive, b"\n")
        os.close(alive)
        if guard is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                guard.wait(_END_S)


def let_go(face: str, settings: "BusSettings", servos: Mapping[int, str]) -> None:
    """Switch torque off at the port of a dead face, and log what its servos confirm; blocks.

    A port that is gone is waited for up to 30 s. If another program still has the port 2 s after
    this call, nothing is sent. face: its name. settings: of the bus, with its port. servos: the
    servos' names, by address.
    """
    kind = bus_kind(settings.kind)
    opener = kind.port_release(str(settings.port), Wiring(settings, (), (), 1.0))

    is_taken = False

    def open_free() -> PortRelease:
        """Open the port; note in `is_taken` whether another program has it. Raises PortError."""
        nonlocal is_taken
        try:
            port, is_taken = opener(), False
        except PortError as error:
            is_taken = getattr(error.__cause__, "errno", 0) in _TAKEN
            raise
        return port

    at_port = TorqueRelease(open_free, list(servos), timeout_s=_SILENT_S)
    release = FaceRelease([(at_port, servos)])
    dead_s = time.monotonic()
    while not release.step():
        longest_s = _DYING_S if is_taken else PORT_WAIT_S
        if release.port_error and time.monotonic() - dead_s > longest_s:
            break
        time.sleep(max(0.0, release.next_s - time.monotonic()))
    release.close()
    if not is_taken:
        can = kind.capabilities(settings)
        let_go = dict.fromkeys(release.let_go, can)
        report = let_go_report(let_go, release.unconfirmed, confirms=can.confirmed_limp)
        what = f"its processes have died; its guard at {settings.port}"
        _LOG.warning("%s: %s: %s", face, what, report.line())


def main() -> None:
    """Run the guard of a face that is dead: argv has what `let_go` needs, as JSON."""
    run_on_time()  # before what takes longest, the loading of the bus
    job: dict[str, Any] = json.loads(sys.argv[1])
    settings = bus_kind(job["bus"]["kind"]).settings.model_validate(job["bus"])
    with face_logs(job["face"], "guard"):
        let_go(job["face"], settings, {int(at): name for at, name in job["servos"].items()})


if __name__ == "__main__":
    main()
